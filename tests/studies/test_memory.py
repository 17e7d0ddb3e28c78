"""Workers give memory back."""

from __future__ import annotations

import gc
import math
import weakref

import pytest

from lieednn_sim.studies import workers
from lieednn_sim.studies.comparison.rows import Case
from lieednn_sim.studies.comparison.study import Settings, run_case


@pytest.fixture
def collector_off():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def test_memory_is_given_back_after_tasks_even_failed_ones_every_five_seconds(monkeypatch):
    given, clock = [], iter([10.0, 10.5, 15.0, 16.0, 16.0])
    monkeypatch.setattr(workers, "_trim", lambda: given.append)
    monkeypatch.setattr(workers, "_last_released", 4.0)
    monkeypatch.setattr(workers, "monotonic", lambda: next(clock))
    assert workers.released(lambda a, b: a + b, 1, 2) == 3
    assert given == [0]
    workers.released(lambda: None)
    assert given == [0]
    try:
        workers.released(lambda: 1 / 0)
    except ZeroDivisionError:
        given.append("failed")
    assert given == [0, 0, "failed"]


def test_cycles_are_collected_after_a_task(collector_off, monkeypatch):
    monkeypatch.setattr(workers, "_last_released", -math.inf)

    class Ring:
        pass

    def task():
        ring = Ring()
        ring.itself = ring
        return weakref.ref(ring)

    assert task()() is not None
    assert workers.released(task)() is None


def test_neither_search_nor_controllers_leave_reference_cycles_that_hold_native_memory(collector_off):
    settings, case = Settings(duration=2.0, hold=0.0), Case("telescopic_pr", "poles", "rrt-connect", 0)
    names = ["inverse-dynamics", "computed-torque", "mocap"]
    run_case(case, names, settings)  # what is made once
    gc.collect()
    rows = run_case(case, names, settings)
    gc.set_debug(gc.DEBUG_SAVEALL)
    gc.collect()
    gc.set_debug(0)
    left = {type(thing).__module__ for thing in gc.garbage}
    gc.garbage.clear()
    assert [row.success for row in rows] == [True] * len(names)
    # Cycles through a caught exception are Python's own, and short-lived.
    native = ("lieednn_sim.simulation.controllers", "lieednn_sim.planning.baselines.search_space", "nanobind", "mujoco")
    assert not {name for name in left if name.startswith(native)}
