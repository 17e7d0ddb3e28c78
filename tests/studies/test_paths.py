"""Errors of paths by hand."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim.studies.demonstrations.models import path_errors


def test_errors_of_parallel_lines_do_not_depend_on_pace():
    shown = np.zeros((5, 6))
    shown[:, 3] = [1.0, 0.9, 0.5, 0.1, 0.0]
    found = np.zeros((3, 6))
    found[:, 3] = [1.0, 0.2, 0.0]
    found[:, 5] = 0.003
    errors = path_errors(found, shown)
    for value in (errors.rms_mm, errors.frechet_mm, errors.goal_mm, errors.dtwd_mm / 1000.0):
        assert value == pytest.approx(3.0)
    assert errors.rms_deg == errors.goal_deg == 0.0


def test_errors_of_turns():
    # In place, from 90 and from 60 degrees: the first third has no better partner than the other's start.
    one, other = np.zeros((2, 2, 6))
    one[0, 2], other[0, 2] = np.pi / 2.0, np.pi / 3.0
    errors = path_errors(one, other, lever=3.0)
    assert errors.frechet_mm == pytest.approx(3e3 * np.pi / 6.0)
    assert errors.rms_mm == errors.goal_mm == errors.goal_deg == 0.0
    # 30 degrees down to none over a quarter of the pairs: 333 of the one's samples alone, and 1000 of the other's.
    assert errors.rms_deg == pytest.approx(30.0 / np.sqrt(3.0 * 4.0), rel=0.01)
    # Half a turn about z takes v = (pi/2, 0, 0) to the position (0, 1, 0).
    one[0] = [0.0, 0.0, np.pi, np.pi / 2.0, 0.0, 0.0]
    still = np.zeros((2, 6))
    assert path_errors(one, still).frechet_mm == pytest.approx(np.hypot(1e3, 200.0 * np.pi))
