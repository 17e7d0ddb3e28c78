"""A clock for control loops that stands still unless it is moved, and no search for garbage before each loop."""

import pytest

from lieednn_sim.policies import loop


@pytest.fixture(autouse=True)
def no_search(monkeypatch):
    """In a process with all that other tests have imported, the search takes ten times as long as most loops here."""
    monkeypatch.setattr(loop.gc, "collect", lambda: 0)


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
