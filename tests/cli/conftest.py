"""What the tests of the commands share: plots without ink."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure


@pytest.fixture
def no_ink(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plots are composed, and their files written, but not drawn: that takes longer than all else of a run.

    For tests in which plots are by the way; `test_cli.test_the_demo_without_video_meets_its_bounds` draws them.
    """
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: Path(path).write_bytes(b"a picture"))
