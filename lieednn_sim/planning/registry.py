"""One way to plan: planners by name, all asked alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.budget import DEFAULT_TIME_BUDGET, cpu_time, time_limit
from lieednn_sim.errors import InputError, LieEDNNError, PlanError
from lieednn_sim.planning import filtered, network_planners
from lieednn_sim.planning.baselines import cbirrt, interpolation, optimisation, primitives, qshnn, sampling, stomp
from lieednn_sim.planning.certified import CertifiedOptions, certified
from lieednn_sim.planning.extras import optional_module
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.planning.retiming import retime
from lieednn_sim.planning.shaped import ShapedOptions, shaped
from lieednn_sim.registration import Registry
from lieednn_sim.validation import as_choice

# How far a motion may begin and end from where it was asked to, in joint coordinates [rad, m].
_MISSED = 1e-3
_Solve = TypeVar("_Solve", bound=Callable[..., Plan | Motion])


class Planner(NamedTuple):
    """A function of a problem, and of options where it has any.

    Attributes:
        solve: returns a plan, or where there is no network the motion alone, or raises; the motion is sampled at the
            model's time step, and `motion.check_motion` passes it.
        options: class of its options, its second argument; None where it has none.
    """

    solve: Callable[..., Plan | Motion]
    options: type[PlannerOptions] | None = None


PLANNERS: dict[str, Planner] = {
    "minimum-jerk": Planner(partial(in_time, interpolation.minimum_jerk)),
    "se3-geodesic": Planner(partial(in_time, interpolation.se3_geodesic)),
    "dmp": Planner(partial(in_time, primitives.dmp), primitives.DmpOptions),
    "rrt-connect": Planner(sampling.rrt_connect, sampling.RrtConnectOptions),
    "rrt-star": Planner(sampling.sampling_planner("rrt-star"), sampling.RrtStarOptions),
    "informed-rrt-star": Planner(sampling.sampling_planner("informed-rrt-star"), sampling.InformedRrtStarOptions),
    "bit-star": Planner(sampling.sampling_planner("bit-star"), sampling.BitStarOptions),
    "aorrtc": Planner(sampling.sampling_planner("aorrtc"), sampling.RrtStarOptions),
    "mjpl": Planner(cbirrt.mjpl, cbirrt.CbirrtOptions),
    "sscbirrt": Planner(cbirrt.sscbirrt, cbirrt.CbirrtOptions),
    "trajectory-optimisation": Planner(
        partial(in_time, optimisation.trajectory_optimisation), optimisation.OptimisationOptions
    ),
    "stomp": Planner(stomp.stomp, stomp.StompOptions),
    "qshnn": Planner(qshnn.qshnn, qshnn.QshnnOptions),
    "linear-attractor": Planner(network_planners.linear_attractor),
    "lieednn-certified": Planner(certified, CertifiedOptions),
    "lieednn-retargeted": Planner(network_planners.retargeted, network_planners.RetargetedOptions),
    "lieednn-trained": Planner(network_planners.trained, network_planners.TrainedOptions),
    "lieednn-unprojected": Planner(network_planners.unprojected, network_planners.UnprojectedOptions),
    "lieednn-shaped": Planner(shaped, ShapedOptions),
    "lieednn-filtered": Planner(filtered.filtered, filtered.FilteredOptions),
    "lieednn-guided": Planner(filtered.guided, filtered.GuidedOptions),
}


def register_planner(name: str, options: type[PlannerOptions] | None = None) -> Callable[[_Solve], _Solve]:
    """Decorate a function of a `PlanningProblem` to be known as a planner, to `plan`, `compare` and the command line.

    It returns a `Motion` (see `planning.joint_motion`) or a `Plan` with its network, and raises `PlanError` where it
    finds none. Every motion is checked: limits, clearance, start and target; one that is too fast is asked for again
    with the duration that it needs. Worker processes and the command line know
    what an installed package names in its entry points:

        [project.entry-points."lieednn_sim.planners"]
        my-planner = "my_package.my_module:my_function"

    There the function needs no decorator, unless it takes options.

    Args:
        name: of the planner, in small letters, digits and hyphens.
        options: class of its options, which are its second argument.

    Raises:
        InputError: the name is malformed or taken, or the options are none.
    """
    if not isinstance(options, type | None) or (options is not None and not issubclass(options, PlannerOptions)):
        raise InputError(f"options of planner {name!r} must be a subclass of PlannerOptions, got {options!r}")

    def register(solve: _Solve) -> _Solve:
        REGISTRY.add(name, solve, options)
        return solve

    return register


def planners() -> Mapping[str, Planner]:
    """All planners by name: `PLANNERS`, with those of the entry points of installed packages.

    Of one that cannot be loaded a warning names the package, and it is left out.
    """
    return REGISTRY.all()


def _planner(name: str, solve: Callable[..., Plan | Motion], options: type[PlannerOptions] | None = None) -> Planner:
    if not callable(solve):
        raise InputError(f"planner {name!r} must be a function of a PlanningProblem, got {type(solve).__name__}")
    return Planner(partial(in_time, partial(_checked, solve)), options)


REGISTRY = Registry("planner", PLANNERS, _planner)


def _checked(solve: Callable[..., Plan | Motion], problem: PlanningProblem, *options: PlannerOptions) -> Plan | Motion:
    """What somebody's planner makes, held against what every planner promises."""
    try:
        made = solve(problem, *options)
    except LieEDNNError:
        raise
    except Exception as error:
        raise PlanError(f"the planner failed: {type(error).__name__}: {error}") from error
    if not isinstance(made, Plan | Motion):
        raise PlanError(f"the planner returned {type(made).__name__}, neither a Motion nor a Plan")
    motion = made if isinstance(made, Motion) else made.motion
    given, wanted = (motion.q.shape[1], motion.timestep), (problem.arm.n_joints, problem.timestep)
    if not np.allclose(given, wanted, rtol=1e-6):
        raise PlanError(
            "the planner's motion has {} joints and a time step of {:g} s, ".format(*given)
            + "the arm has {} joints and its model steps of {:g} s".format(*wanted)
        )
    for which, there, asked in (("begins", motion.q[0], problem.start), ("ends", motion.q[-1], problem.target)):
        missed = float(np.abs(there - asked).max())
        if missed > _MISSED:
            raise PlanError(f"the planner's motion {which} {missed:.2g} (rad or m) from where it was asked to")
    check_motion(problem.arm, motion)
    return made


# The LieEDNN planner that gets furthest among obstacles, and most smoothly, whether OMPL is installed or not.
OBSTACLE_PLANNER = "lieednn-shaped"
_MANY = 3  # hinges that move one link


def default_planner(arm: Arm) -> tuple[str, str]:
    """The planner for an arm in its scene when none is asked for, and why.

    Where three or more hinges move one link a network's own way soon leaves what they can do, and the posture nearest
    to it turns abruptly: there as among obstacles a teacher's motion is followed.
    """
    if arm.scene != "free":
        return OBSTACLE_PLANNER, "the default among obstacles"
    hinges = ({i for f in joint.factors if f.kind == "hinge" for i in f.indices} for joint in arm.joints.joints)
    if any(len(turning) >= _MANY for turning in hinges):
        return OBSTACLE_PLANNER, "the default where three or more hinges move a link"
    return "lieednn-certified", "the default without obstacles"


def plan(
    arm: Arm,
    target: ArrayLike,
    *,
    planner: str | None = None,
    start: ArrayLike | None = None,
    duration: float = 4.0,
    longest: float = 3.0,
    seed: int = 0,
    time_budget: float = DEFAULT_TIME_BUDGET,
    options: PlannerOptions | None = None,
    fastest: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Plan:
    """Plan a motion from rest to rest within the arm's limits and free of contact.

    Args:
        arm: the arm, in its scene.
        target: joint target ``(n,)`` [rad, m].
        planner: a name of `PLANNERS`; by default the `default_planner`.
        start: joint position at rest ``(n,)`` [rad, m], the keyframe ``home`` by default.
        duration: of the motion [s], rounded to a whole number of the model's time steps.
        longest: durations that the motion may take at most, where the arm's limits need more time; with 1 one that is
            too fast is refused, with the time that would do. Learned networks are never given more than one; motions
            through the filter need a little more than one, even where nothing is in their way.
        seed: of planners that draw; the same seed gives the same plan.
        time_budget: CPU time that planning may take [s]; infinity for no limit. A planner that needs less makes the
            same motion whatever the budget and the machine, one that needs more makes none.
        options: of the planner, an object of its class in `PLANNERS`; by default that class's defaults.
        fastest: run through the path that was planned as fast as the arm's limits allow, see `retime`; the duration is
            then only what is planned with.
        progress: called with (done, total) after every candidate, by planners that draw a number of them.

    Raises:
        InputError: a value is malformed, an unknown planner or options of another one, or start or target are out of
            the arm's reach.
        NotCertifiedError: no network could be certified.
        PlanError: the motion breaks a limit of the arm, or does not arrive; `TooFastError` where more time would do.
        OutOfTimeError: the time budget is spent.
        LieEDNNError: a library that the planner needs is not installed; see `missing_planners`.
    """
    if planner is None:
        planner = default_planner(arm)[0] if isinstance(arm, Arm) else "lieednn-certified"
    known = planners()
    solve, kind = known[as_choice("planner", planner, known)]
    if options is not None and (kind is None or not isinstance(options, kind)):
        wanted = "has no options" if kind is None else f"takes options of class {kind.__name__}"
        raise InputError(f"the planner {planner!r} {wanted}, got {type(options).__name__}")
    given = () if kind is None else (kind() if options is None else options,)
    # All is checked, and start and target are made arrays, by the problem.
    origin = arm.keyframe("home") if start is None and isinstance(arm, Arm) else start
    problem = PlanningProblem(arm, origin, target, duration, seed, time_budget, longest, progress)  # type: ignore[arg-type]
    if fastest:
        optional_module("toppra")  # before the work
    begun = cpu_time()
    with time_limit(problem.time_budget):
        made = solve(problem, *given)
        found = Plan(made) if isinstance(made, Motion) else made
        if fastest:
            found = replace(found, motion=retime(problem.arm, found.motion))
    return replace(found, target=problem.target, planner=planner, cpu_time=cpu_time() - begun)
