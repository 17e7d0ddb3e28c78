"""A clock for control loops that stands still unless it is moved."""

import pytest

from lieednn_sim.policies import loop


@pytest.fixture
def clock(monkeypatch):
    """A clock that only goes on in `sleep`, or when it is told to."""

    class Clock:
        now = 0.0

        def perf_counter(self):
            return self.now

        def sleep(self, seconds):
            self.now += seconds

    made = Clock()
    monkeypatch.setattr(loop, "time", made)
    return made
