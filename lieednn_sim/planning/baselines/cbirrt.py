"""CBiRRT (Berenson, Srinivasa, Ferguson and Kuffner, ICRA 2009), as implemented by the libraries mjpl and sscbirrt.

It was made for constrained motions; here only limits and contact constrain it, so it is a bidirectional RRT. Like
OMPL's planners, both search in the coordinates of `search_space.EdgeTest` and ask it whether an edge is clear. Each
library shortens its paths by a method of its own. They need the extra `cbirrt`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from lieednn_sim._mujoco import mujoco
from lieednn_sim.budget import check_time
from lieednn_sim.planning.baselines.sampling import PathOptions
from lieednn_sim.planning.baselines.search_space import EdgeTest
from lieednn_sim.planning.baselines.smoothing import motion_along_first
from lieednn_sim.planning.joint_space import ProblemClearance
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.registry import optional_module
from lieednn_sim.values import Floats

# From start to target in the test's coordinates, with a longest edge and a seed; returns corners, or None.
_Search = Callable[[EdgeTest, Floats, Floats, float, PathOptions, int], "list[Floats] | None"]


def mjpl(problem: PlanningProblem, options: PathOptions) -> Motion:
    """The motion along a path of mjpl's bidirectional RRT.

    `LieEDNNError` if mjpl is not installed, `PlanError` if no path is found in the tests allowed, or followed in time.
    """
    return _plan(problem, options, "mjpl", _mjpl_path)


def sscbirrt(problem: PlanningProblem, options: PathOptions) -> Motion:
    """As `mjpl`, with sscbirrt's planner: its Python backend, since the compiled one accepts no custom edge test."""
    return _plan(problem, options, "sscbirrt", _sscbirrt_path)


def _plan(problem: PlanningProblem, options: PathOptions, name: str, search: _Search) -> Motion:
    optional_module(name)
    clear = ProblemClearance(problem, options.margin)

    @cache
    def corners(attempt: int) -> Floats | None:
        edges = EdgeTest(problem.arm, clear, options.spacings[attempt])
        clear.tests = 0
        longest_edge = options.longest_edge * float(np.linalg.norm(np.ptp(edges.bounds, axis=1)))
        seed = int(np.random.SeedSequence([problem.seed, attempt]).generate_state(1)[0])
        ends = (problem.start / edges.scale, problem.target / edges.scale)
        waypoints = search(edges, *ends, longest_edge, options, seed)
        check_time()
        if waypoints is None:
            return None
        path = edges.scale * np.array(waypoints)
        path[0], path[-1] = problem.start, problem.target
        return path

    return motion_along_first(problem, corners, len(options.spacings), options, name)


class _SpentError(Exception):
    """The search has used up its tests."""


def _mjpl_path(
    edges: EdgeTest, start: Floats, target: Floats, longest_edge: float, options: PathOptions, seed: int
) -> list[Floats] | None:
    if edges.passable(start, target):
        return [start, target]
    planning = optional_module("mjpl.planning")

    def step(q_old: Floats, q: Floats) -> Floats | None:
        return q if edges.passable(q_old, q) else None

    def step_of_search(q_old: Floats, q: Floats) -> Floats | None:
        check_time()
        if edges.over(max(options.max_collision_checks)):
            raise _SpentError
        return step(q_old, q)

    searched, shortened = (SimpleNamespace(valid_config=edges.free, apply=item) for item in (step_of_search, step))
    model = _box(edges.bounds)
    names = [model.joint(k).name for k in range(model.njnt)]
    # It takes points closer than the longest edge for connected, without a test.
    longest_edge = min(longest_edge, 0.5 * float(np.linalg.norm(target - start)))
    # Work is limited by the number of tests, not by its wall-clock time.
    planner = planning.RRT(model, names, [searched], max_planning_time=math.inf, epsilon=longest_edge, seed=seed)
    try:
        result = planner.plan_to_config(start, target)
    except _SpentError:
        return None
    if len(result) > 2:
        result = planning.smooth_path(result, [shortened], longest_edge, options.shortcuts, seed, sparse=True)
    return list(result)


def _box(limits: Floats) -> mujoco.MjModel:
    """A model of slide joints with limits ``(n, 2)``, from whose ranges mjpl draws its samples."""
    spec = mujoco.MjSpec()
    for k, (low, high) in enumerate(limits):
        body = spec.worldbody.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), explicitinertial=True)
        body.add_joint(name=f"coordinate {k}", type=mujoco.mjtJoint.mjJNT_SLIDE, range=(low, high), limited=True)
    return spec.compile()


def _sscbirrt_path(
    edges: EdgeTest, start: Floats, target: Floats, longest_edge: float, options: PathOptions, seed: int
) -> list[Floats] | None:
    library, motions = optional_module("sscbirrt"), optional_module("sscbirrt.motion")
    lower, upper = edges.bounds.T

    def validate(q_from: Floats, q_to: Floats) -> Any:
        clear = edges.passable(np.asarray(q_from), np.asarray(q_to))
        return motions.LocalMotion([q_to] if clear else [], clear)

    config = library.CBiRRTConfig(
        timeout=1e9,
        max_iterations=2**31 - 1,
        abort_fn=lambda: edges.over(max(options.max_collision_checks)),
        step_size=longest_edge,
        edge_resolution=None,
        smoothing_iterations=options.shortcuts,
    )
    # A search between joint positions does not use poses.
    robot = SimpleNamespace(dof=len(lower), joint_limits=(lower, upper), forward_kinematics=lambda _: np.eye(4))
    planner = library.CBiRRT(robot, None, SimpleNamespace(is_valid=edges.free), config, backend="python")
    result = planner.solve(
        library.PlanningProblem(
            space=planner.space,
            start=library.FiniteSet([start]),
            goal=library.FiniteSet([target]),
            validator=SimpleNamespace(is_valid=edges.free),
            motion_validator=SimpleNamespace(validate=validate),
        ),
        seed=seed,
    )
    return result.path if result.success else None
