"""Worker processes: none outlives the block that started it, and no other child is touched."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal

import pytest

from lieednn_sim.evaluation.workers import worker_pool


@pytest.mark.parametrize("reason", [KeyboardInterrupt, ValueError])
def test_a_block_that_fails_leaves_no_worker_and_no_other_child_is_stopped(reason):
    """A worker that waits for ever is ended with the block; the child beside it is not."""
    other = multiprocessing.get_context("spawn").Process(target=signal.pause)
    other.start()
    try:
        with contextlib.suppress(reason), worker_pool(1) as pool:
            worker = pool.submit(os.getpid).result()
            pool.submit(signal.pause)
            raise reason
        with pytest.raises(ProcessLookupError):
            os.kill(worker, 0)
        assert multiprocessing.active_children() == [other]
    finally:
        other.kill()
        other.join()
        other.close()


def test_a_block_that_ends_well_finishes_its_work_and_leaves_no_worker():
    with worker_pool(1) as pool:
        results = [pool.submit(abs, -value) for value in range(3)]
    assert [future.result() for future in results] == [0, 1, 2]
    assert multiprocessing.active_children() == []
