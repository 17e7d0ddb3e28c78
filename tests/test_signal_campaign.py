"""The campaign of signals notices what it is there for; it runs by hand, for it takes an hour."""

from __future__ import annotations

import signal
import subprocess
import sys

import numpy as np
import pytest
import signal_campaign

from lieednn_sim import storage


@pytest.mark.parametrize(
    ("code", "errors", "found"),
    [
        (0, "", []),
        (143, "lieednn-sim: interrupted", []),
        (1, "", ["exit code 1"]),
        (0, "Traceback of lieednn_sim", ["printed Traceback of lieednn_sim"]),
        (0, "Traceback of site", []),
    ],
)
def test_codes_and_words_at_the_end(code, errors, found):
    process = subprocess.Popen([sys.executable, "-c", f"raise SystemExit({code})"], start_new_session=True)
    process.wait()
    assert signal_campaign.faults("demo", signal.SIGTERM, process, "planner: one", errors) == found


def test_files_that_were_reported_and_are_damaged(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""], start_new_session=True)
    process.wait()
    path = tmp_path / "x.npz"
    storage.save_arrays(path, "thing", {"x": np.zeros(3)}, {})
    output = f"wrote {path}\nwrote {tmp_path / 'none.csv'}\n"
    wanted = [f"{tmp_path / 'none.csv'} was reported, and cannot be read"]
    assert signal_campaign.faults("demo", signal.SIGKILL, process, output, "") == wanted
    path.write_bytes(path.read_bytes()[:-9])
    wanted.insert(0, f"{path} was reported, and cannot be read")
    assert signal_campaign.faults("demo", signal.SIGKILL, process, output, "") == wanted
