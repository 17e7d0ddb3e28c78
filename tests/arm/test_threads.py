"""Several threads use the same arm."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import lieednn_sim as ls


@pytest.mark.parametrize("name", ["telescopic_pr", "telescopic_crane"])
def test_an_arm_says_the_same_to_several_threads(name):
    """Of the first, 20 configurations are in contact; the second has a closed loop."""
    arm = ls.Arm.load(name, scene="window", seed=1)
    rows = np.random.default_rng(0).uniform(*arm.position_limits.T, (300, arm.n_joints))

    def asked(q):
        return arm.near_contacts(q), arm.contacts(q), arm.qpos(q, strict=False).tolist(), arm.tip(q).tolist()

    alone = list(map(asked, rows))
    with ThreadPoolExecutor(4) as threads:
        for _ in range(3):
            assert list(threads.map(asked, rows)) == alone


def test_what_one_thread_asks_changes_no_digit_for_another():
    """Solutions along a path are kept: those of another thread's path were taken, or replaced one's own."""
    arm = ls.Arm.load("telescopic_crane")
    low, high = arm.position_limits.T
    path, other = (np.linspace(low + 0.1 * (high - low), low + end * (high - low), 150) for end in (0.6, 0.8))

    def solved(asked_between):
        with ThreadPoolExecutor(1) as thread:
            thread.submit(arm.qpos, path).result()
            for rows in asked_between:
                arm.qpos(rows)
            return thread.submit(arm.qpos, path[1:]).result()

    np.testing.assert_array_equal(solved([]), solved([other]))
