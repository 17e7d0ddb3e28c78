"""Everything that is chosen by name: one row for each planner, policy, controller, arm, scene, format and model.

A row says where a thing is, what it does in one line, which class its options have, and which optional library it
needs. Help texts, menus and the tables of the documentation come from the rows; nothing is imported for them, and this
module imports nothing slow. A thing itself is imported when it is loaded. Decorators and the entry points of installed
packages add further planners, policies and controllers.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from lieednn_sim.errors import InputError, LieEDNNError

TYPICAL, SLOW = 0.6, 1.0  # CPU time of a case of most planners, and that above which a planner is slow [s]

_Given = TypeVar("_Given")
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_IN_FILE = re.compile(r"(?s)(.+\.py):([^:/\\]*)")


class Library(NamedTuple):
    """An optional library."""

    extra: str  # of this package, which installs it
    purpose: str = ""  # what it is for, besides the rows that name it
    distribution: str = ""  # its name on the package index, if that is another one


#: Optional libraries by the name of their module.
LIBRARIES: Mapping[str, Library] = {
    "ompl": Library("rivals"),
    "mjpl": Library("cbirrt"),
    "sscbirrt": Library("cbirrt"),
    "toppra": Library("timing", "the planned path in the least time, --fastest"),
    "viser": Library("view", "motions in a browser"),
    "mjviser": Library("view", "motions in a browser"),
    "gymnasium": Library("gymnasium", "Gymnasium environments"),
    "onnx": Library("onnx", "a network as a graph, network.to_onnx"),
    "rosbags": Library("ros2"),
    "pyarrow": Library("lerobot"),
    "rerun": Library("rerun", distribution="rerun-sdk"),
}


@dataclass(frozen=True)
class Entry:
    """A row of a registry."""

    place: Any = ""  # where the thing is, ``module:name`` within this package; or what another package has registered
    help: str = ""  # what it is or does, in one line
    takes: Any = ""  # class of its options, by name in the same module or itself; empty or None for no options
    library: str = ""  # module of `LIBRARIES` that it needs; empty if it needs none

    @property
    def own(self) -> bool:
        """Whether it is this package's, not added by another one."""
        return isinstance(self.place, str)

    def load(self) -> Any:
        """The thing itself, which is imported at the first call."""
        return self._within(self.place.partition(":")[2]) if self.own else self.place

    @property
    def options(self) -> Any:
        """Class of its options; None for a thing without options."""
        return self._within(self.takes) if self.takes and isinstance(self.takes, str) else self.takes or None

    @property
    def install(self) -> str:
        """The command that installs the library that it needs; empty if it is there, or if it needs none."""
        return "" if not self.library or importlib.util.find_spec(self.library) else install_command(self.library)

    def _within(self, name: str) -> Any:
        return attrgetter(name)(importlib.import_module(f"lieednn_sim.{self.place.partition(':')[0]}"))


@dataclass(frozen=True)
class PlannerEntry(Entry):
    """A planner: a function of a `PlanningProblem`, and of its options if there are any.

    It returns a plan, or a motion if there is no network, or raises. The motion is sampled at the model's time step and
    passes `motion.check_motion`; its velocities are the derivatives of its positions, and its accelerations are
    continuous.
    """

    # CPU time of a case of a comparison [s], planning and both default controllers, in the mean over its arms,
    # free and behind the window. Declared, not measured, so that which cases there are depends on no machine.
    cost: float = TYPICAL
    network: bool = False  # whether its plans have a certifiable network, which a run stores
    path_constraints: bool = False  # whether it takes the argument `path_constraint` of `planning.plan`


@dataclass(frozen=True)
class PolicyEntry(Entry):
    """A policy: a function of a `PolicyTask`, and of its options if there are any, which makes a `Policy`.

    A reset lets it begin anew to the bit, and it can be copied and pickled at any time. Its message is "moves", or "has
    ended" at the end of a motion; anything else says what keeps it from moving on.
    """


@dataclass(frozen=True)
class FormatEntry(Entry):
    """A format of another tool: a function of sources by name, a folder, and options, which writes files into it.

    That of rollouts takes the option ``rate`` [Hz], see `exports.formats.samples`; None is for its default.
    """

    of_comparison: bool = False  # whether it holds the table of a comparison; otherwise it holds rollouts


_Entry = TypeVar("_Entry", bound=Entry)


class Registry(Mapping[str, _Entry], Generic[_Entry]):
    """All things of one kind by name, those of installed packages included, which are looked for once.

    An entry point that cannot be loaded is left out, with a warning that names its package. Where others may add to a
    kind, `find` also takes ``file.py:thing``, and runs that file.

    The attribute ``entries`` holds this package's own rows, and those that decorators have added, without looking for
    others. Where others may add to the kind, ``make(place, takes=...)`` is the row of an added thing and its options;
    ``wanted`` says what such a thing must be, ``group`` is that of packages' entry points, ``further`` for messages.
    """

    def __init__(
        self,
        kind: str,
        entries: dict[str, _Entry],
        *,
        make: Callable[..., _Entry] | None = None,
        wanted: str = "",
        group: str = "",
        further: str = "",
    ) -> None:
        self.kind, self.entries = kind, entries
        self._further = further if make is None else "or one of your own as file.py:name"
        self._make, self._wanted, self._group = make, wanted, group
        self._searched = make is None

    def __getitem__(self, name: str) -> _Entry:
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def find(self, name: str) -> _Entry:
        """The row of that name; `InputError` that lists the names if there is none, or says what a file lacks."""
        from lieednn_sim.validation import as_choice  # NumPy is slow to import

        if self._make and isinstance(name, str) and name not in self.entries and (parts := _IN_FILE.fullmatch(name)):
            given = _of_file(f"{self.kind} {name!r}", *parts.groups())
            registered = (entry for entry in self.entries.values() if entry.place is given)
            self.entries[name] = next(registered, None) or self._row(name, given)
        return self[as_choice(self.kind, name, self, self._further)]

    def register(self, name: str, options: type | None = None) -> Callable[[_Given], _Given]:
        """Decorator that adds a thing; `InputError` if its name is taken or malformed, or it is not callable."""

        def decorate(given: _Given) -> _Given:
            if not _NAME.fullmatch(name):
                raise InputError(f"a {self.kind}'s name must be of a to z, digits and hyphens, got {name[:80]!r}")
            if name in self.entries:
                raise InputError(f"{self.kind} {name!r} is already registered; choose another name")
            self.entries[name] = self._row(name, given, options)
            return given

        return decorate

    def _row(self, name: str, given: Any, options: type | None = None) -> _Entry:
        assert self._make is not None, f"others add no {self.kind}"
        if not callable(given):
            raise InputError(f"{self.kind} {name!r} must be {self._wanted}, got {type(given).__name__}")
        return self._make(given, takes=options)

    def missing(self) -> dict[str, str]:
        """Names of those whose library is not installed, with the commands that install them."""
        return {name: entry.install for name, entry in self.entries.items() if entry.install}

    def require(self, name: str) -> _Entry:
        """As `find`; `LieEDNNError` if the library that it needs is not installed, which says what to do.

        No other one is taken instead, since results must not depend on what is installed.
        """
        entry = self.find(name)
        if command := entry.install:
            others = ", ".join(other for other, row in self.entries.items() if not row.library)
            raise LieEDNNError(f"{self.kind} {name!r} is not installed: {command}; or name one without extra: {others}")
        return entry

    def origins(self, names: Iterable[str]) -> list[str]:
        """Where those that others have added come from, a line for each."""
        added = [(name, self[name].place) for name in names if name in self and not self[name].own]
        return [f"{self.kind} {name}: {it.__module__}.{getattr(it, '__qualname__', name)}" for name, it in added]

    def _all(self) -> dict[str, _Entry]:
        if self._searched:
            return self.entries
        self._searched = True
        from importlib import metadata  # slow to import

        for point in metadata.entry_points(group=self._group):
            package = "unknown" if point.dist is None else point.dist.name
            try:
                given = point.load()
                # A decorated object has registered itself on loading.
                if point.name not in self.entries or self.entries[point.name].place is not given:
                    self.register(point.name)(given)
            except Exception as error:
                text = f"{self.kind} {point.name!r} of package {package!r} ({point.value}) is left out: {error}"
                warnings.warn(text, RuntimeWarning, stacklevel=4)
        return self.entries


def _of_file(what: str, path: str, name: str) -> Any:
    """A thing of a Python file, whose folder is searched last for what it imports."""
    file = Path(path).resolve()
    folder, module = str(file.parent), file.stem
    if not file.is_file():
        raise InputError(f"{what}: there is no file {path}")
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        importlib.invalidate_caches()
        found = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(f"{what}: running {path} fails: {type(error).__name__}: {error}") from error
    if Path(getattr(found, "__file__", None) or "").resolve() != file:
        raise InputError(f"{what}: there is another module named {module!r}: give the file another name")
    if not hasattr(found, name):
        own = [each for each, value in vars(found).items() if getattr(value, "__module__", None) == module]
        raise InputError(f"{what}: {path} has no {name!r}; it has {', '.join(own) or 'nothing of its own'}")
    return getattr(found, name)


def install_command(library: str) -> str:
    """The command that installs an optional library, with others of its extra."""
    return f"pip install 'lieednn_sim[{LIBRARIES[library].extra}]'"


def purpose(library: str) -> str:
    """What an optional library is for."""
    users = []
    for registry in (PLANNERS, FORMATS):
        names = [name for name, entry in registry.entries.items() if entry.library == library]
        users += [f"{registry.kind}{'s' * (len(names) > 1)} {', '.join(names)}"] * bool(names)
    return ", ".join(filter(None, (*users, LIBRARIES[library].purpose)))


def optional_module(name: str) -> Any:
    """Import a module of an optional library; `LieEDNNError`, which names the extra, if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        library = name.partition(".")[0]
        raise LieEDNNError(f"{library} is not installed (for {purpose(library)}): {install_command(library)}") from None


_PLANNERS = {
    "minimum-jerk": PlannerEntry("planning.baselines.interpolation:minimum_jerk", "straight in joint space"),
    "se3-geodesic": PlannerEntry("planning.baselines.interpolation:se3_geodesic", "compound joints on SE(3) geodesics"),
    "dmp": PlannerEntry("planning.baselines.interpolation:dmp", "a dynamic movement primitive"),
    "rrt-connect": PlannerEntry(
        "planning.baselines.sampling:rrt_connect", "OMPL's RRT-Connect", "RrtConnectOptions", "ompl"
    ),
    "rrt-star": PlannerEntry("planning.baselines.sampling:rrt_star", "OMPL's RRT*", "RrtStarOptions", "ompl", cost=1.3),
    "informed-rrt-star": PlannerEntry(
        "planning.baselines.sampling:informed_rrt_star", "OMPL's Informed RRT*", "InformedRrtStarOptions", "ompl"
    ),
    "bit-star": PlannerEntry("planning.baselines.sampling:bit_star", "OMPL's BIT*", "BitStarOptions", "ompl"),
    "aorrtc": PlannerEntry("planning.baselines.sampling:aorrtc", "OMPL's AORRTC", "RrtStarOptions", "ompl"),
    "mjpl": PlannerEntry("planning.baselines.cbirrt:mjpl", "the bidirectional RRT of mjpl", "PathOptions", "mjpl"),
    "sscbirrt": PlannerEntry(
        "planning.baselines.cbirrt:sscbirrt", "the bidirectional RRT of sscbirrt", "PathOptions", "sscbirrt"
    ),
    "trajectory-optimisation": PlannerEntry(
        "planning.baselines.optimisation:trajectory_optimisation",
        "a spline of least jerk",
        "OptimisationOptions",
        cost=1.6,
    ),
    "stomp": PlannerEntry("planning.baselines.stomp:stomp", "stochastic trajectory optimisation", "StompOptions"),
    "qshnn": PlannerEntry(
        "planning.baselines.qshnn:qshnn", "the quaternion Hopfield network that the paper starts from", "QshnnOptions"
    ),
    "linear-attractor": PlannerEntry(
        "planning.network_planners:linear_attractor", "a network without weights", network=True
    ),
    "lieednn-certified": PlannerEntry(
        "planning.certified:certified", "a certified network for the target", "CertifiedOptions", network=True
    ),
    "lieednn-retargeted": PlannerEntry(
        "planning.network_planners:retargeted",
        "one certified network for all targets, retargeted by its bias",
        "RetargetedOptions",
        network=True,
    ),
    "lieednn-trained": PlannerEntry(
        "planning.network_planners:trained", "a learned network", "TrainedOptions", cost=2.7, network=True
    ),
    "lieednn-shaped": PlannerEntry(
        "planning.shaped:shaped",
        "a certified network along the motion of a guide, around obstacles",
        "ShapedOptions",
        network=True,
        path_constraints=True,
    ),
}
#: All planners by name; a comparison's table is in this order.
PLANNERS = Registry(
    "planner",
    _PLANNERS,
    make=partial(PlannerEntry, path_constraints=True),
    wanted="a function of a PlanningProblem",
    group="lieednn_sim.planners",
)

_POLICIES = {
    "lieednn-shaped": PolicyEntry(
        "policies.network_policy:shaped", "a certified network shaped for the path of a guide", "ShapedOptions"
    ),
    "lieednn-certified": PolicyEntry(
        "policies.network_policy:certified", "a certified network, made in milliseconds", "CertifiedPolicyOptions"
    ),
    "lieednn-replanning": PolicyEntry(
        "policies.replanning:ReplanningPolicy.of",
        "a certified network that takes new targets and new paths, among obstacles that move",
        "ReplanningOptions",
    ),
    "lieednn-chunks": PolicyEntry(
        "policies.chunks:ChunkPolicy.of",
        "a certified network that follows chunks of targets, as learned policies emit them, within the limits",
        "ChunkOptions",
    ),
    "linear-attractor": PolicyEntry("policies.network_policy:linear", "the network without weights: straight in se(3)"),
    "dmp": PolicyEntry("policies.planned:primitive", "a movement primitive that imitates a motion", "PrimitiveOptions"),
    "fabric": PolicyEntry("policies.fabric:fabric", "an attractor, and obstacles that repel", "FabricOptions"),
    "mppi": PolicyEntry(
        "policies.path_integral:path_integral",
        "model-predictive path integral control, with a model of its own",
        "PathIntegralOptions",
    ),
    "tracker": PolicyEntry("policies.planned:tracker", "a planned motion, whatever the arm does"),
}
#: All policies by name.
POLICIES = Registry(
    "policy", _POLICIES, make=PolicyEntry, wanted="a function of a PolicyTask", group="lieednn_sim.policies"
)

_CONTROLLERS = {
    "position-servo": Entry(
        "simulation.controllers.base:PositionServo", "sends positions and velocities to the arm's position servos"
    ),
    "inverse-dynamics": Entry(
        "simulation.controllers.base:InverseDynamicsServo",
        "adds the forces that the motion needs according to the model",
    ),
    "computed-torque": Entry(
        "simulation.controllers.base:ComputedTorque",
        "feedback from the measured state through the model, instead of servos",
    ),
    "feedback-linearisation": Entry(
        "simulation.controllers.linearisation:feedback_linearisation",
        "computed torques through whatever actuators a model has; the default for views",
    ),
    "mocap": Entry(
        "simulation.controllers.mocap:MocapWelds",
        "leads the link frames by bodies that are welded to them; no actuators, hence no noise",
    ),
    "mocap-deadbeat": Entry(
        "simulation.controllers.mocap:DeadbeatWelds",
        "the same with welds that close the error in one step; needs a reference at every time step",
    ),
}
#: All controllers by name: functions or classes that take an arm and a `Reference`.
CONTROLLERS = Registry(
    "controller",
    _CONTROLLERS,
    make=Entry,
    wanted="a Controller, or a function that makes one",
    group="lieednn_sim.controllers",
)

_ARMS = {
    "telescopic_compound": Entry(help="four compound joints of six degrees of freedom each"),
    "telescopic_crane": Entry(help="a truck crane whose boom a cylinder lifts, with a hook that swings"),
    "telescopic_pr": Entry(help="four sliding and turning links"),
    "telescopic_rrp": Entry(help="three links that turn twice and slide"),
}
#: The arms of the package; each is a folder of that name with a scene.xml in ``assets/mjcf``.
ARMS = Registry("arm", _ARMS, further="or the path of an MJCF or URDF file")
#: The arms that studies take by default, which are similar.
DEFAULT_ARMS = ("telescopic_compound", "telescopic_pr", "telescopic_rrp")

_SCENES = {
    "free": Entry(help="no obstacles"),
    "window": Entry("arm.scenes:window", "a wall with an opening"),
    "shelf": Entry("arm.scenes:shelf", "a shelf of two columns and two rows"),
    "poles": Entry("arm.scenes:poles", "a field of vertical poles"),
}
#: Obstacles around an arm, functions of `arm.scenes`. The index of a name is part of the seed of its obstacles.
SCENES = Registry("scene", _SCENES)

_FORMATS = {
    "csv": FormatEntry(
        "exports.formats:write_csv", "a table of time, joints and end effector, for a spreadsheet, MATLAB, R or pandas"
    ),
    "ros2": FormatEntry(
        "exports.ros2:write",
        "a JointTrajectory as YAML, and a bag in MCAP, for a robot's controller or a replay in ROS 2",
        library="rosbags",
    ),
    "plannerarena": FormatEntry(
        "exports.planner_arena:write",
        "OMPL's benchmark logs of a comparison, for tools such as Planner Arena",
        of_comparison=True,
    ),
    "lerobot": FormatEntry(
        "exports.lerobot:write",
        "a data set of one episode for each run, to train policies by imitation with LeRobot",
        library="pyarrow",
    ),
    "rerun": FormatEntry(
        "exports.rerun_recording:write",
        "a recording of the moving arm and of curves over time, for Rerun's viewer",
        library="rerun",
    ),
}
#: File formats of other tools.
FORMATS = Registry("format", _FORMATS, further="and of a network ONNX and C, by plan.network.to_onnx and to_c")

_ALGORITHMS = {
    "literal": Entry("learning.options:TrainingOptions.literal", "as printed in the paper"),
    "repaired": Entry("learning.options:TrainingOptions", "its equations, repaired"),
    "tracked": Entry("learning.options:TrainingOptions.tracked", "the same, with the equilibrium tracked"),
    "riemannian": Entry("learning.options:RiemannianOptions", "on the manifold of scaled adjoints"),
    "stability-aware": Entry("learning.options:RiemannianOptions.stability_aware", "the same, certified all along"),
}
#: Algorithms that learn a network for a target: functions of their options' values, which make these options.
ALGORITHMS = Registry("algorithm", _ALGORITHMS)

_BIAS_RULES = {
    "uniform": Entry(help="every entry the same, as in the paper"),
    "sign-matched": Entry(help="with the sign of the target"),
    "solved": Entry(help="what makes the target the equilibrium of weights drawn without regard to it"),
}
#: Rules that choose a network's bias, see `synthesis.bias_for`.
BIAS_RULES = Registry("bias rule", _BIAS_RULES)

_RIVALS = {
    "dmp": Entry("learning.demonstrations.primitives:DynamicPrimitive.fit", "a dynamic movement primitive"),
    "promp": Entry(
        "learning.demonstrations.primitives:ProbabilisticPrimitive.fit", "a probabilistic movement primitive"
    ),
    "lpv-ds": Entry("learning.demonstrations.models:StableMixture.fit", "a stable mixture of linear ones"),
    "linear-attractor": Entry("learning.demonstrations.models:LinearAttractor.fit", "the same rate everywhere"),
}
#: Models of demonstrations with which a shaped network is compared: functions of demonstrations and of the number of
#: parameters to have.
RIVALS = Registry("rival", _RIVALS)
