"""What the tests of the command line share: a command that must fail."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lieednn_sim.cli import main


@pytest.fixture
def fails(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must fail, and return its one line on stderr."""

    def fails(*words: object) -> str:
        capsys.readouterr()
        assert main([str(word) for word in words]) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
        assert line.startswith("lieednn-sim: error: ")
        return line

    return fails
