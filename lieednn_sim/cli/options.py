"""The options of each command; this module imports nothing slow."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable, Sequence

from lieednn_sim import registry
from lieednn_sim.registry import SLOW

# Without looking for those of installed packages, which takes time.
PLANNERS = registry.PLANNERS.entries
ARMS, SCENES, CONTROLLERS, POLICIES, ALGORITHMS, BIAS_RULES, FORMATS, RIVALS = (
    tuple(kind.entries)
    for kind in (
        registry.ARMS,
        registry.SCENES,
        registry.CONTROLLERS,
        registry.POLICIES,
        registry.ALGORITHMS,
        registry.BIAS_RULES,
        registry.FORMATS,
        registry.RIVALS,
    )
)
# Those that make a network.
NETWORK_PLANNERS = tuple(name for name, entry in PLANNERS.items() if entry.network)
# Numbers on the command line: plain ASCII decimals, a subset of what Python accepts.
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")


def whole(text: str) -> int:
    """A whole number, or `argparse.ArgumentTypeError`."""
    if not _WHOLE.fullmatch(text):
        raise argparse.ArgumentTypeError(f"must be a whole number, such as 12, got {text!r}")
    return int(text)


def decimal(text: str) -> float:
    """A finite number, or `argparse.ArgumentTypeError`."""
    value = float(text) if _DECIMAL.fullmatch(text) else math.inf
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be a finite decimal number, such as 0.25 or 1e-3, got {text!r}")
    return value


def decimal_or_inf(text: str) -> float:
    """As `decimal`, or infinity for ``inf``."""
    return math.inf if text == "inf" else decimal(text)


def add_task(parser: argparse.ArgumentParser, output: str, *, goal: bool = True) -> None:
    """Add arm, scene, start and target; where ``goal`` is false the target is optional."""
    _add_arm(parser)
    group = parser.add_mutually_exclusive_group(required=goal)
    group.add_argument(
        "--target",
        metavar="Q",
        help="joint target: the name of a keyframe, random:SEED, or joint coordinates separated by commas [rad, m]"
        + ("" if goal else " (default: extended; among obstacles, or without such a keyframe, random:SEED)"),
    )
    group.add_argument("--position", metavar="X,Y,Z", help="target position of the end effector in the world [m]")
    group.add_argument(
        "--pose",
        metavar="X,Y,Z,RX,RY,RZ",
        action="append",
        help="target pose of the end effector in the world: position [m] and rotation vector [rad]; given several "
        "times, the one that is reached soonest",
    )
    parser.add_argument("--start", default="home", metavar="Q", help="joints at the start, given as for --target")
    _add_duration(parser)
    parser.add_argument("--seed", type=whole, default=0, help="seed of random draws")
    parser.add_argument("--output", default=output, metavar="DIR", help="directory for the files of the run")


def _add_arm(parser: argparse.ArgumentParser) -> None:
    _add_arm_name(parser)
    add_frames(parser)
    _add_scene(parser)


def _add_arm_name(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--arm", default="telescopic_pr", metavar="NAME", help=f"{_one_of(ARMS)}, or an MJCF, URDF or YAML file"
    )


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scene", default="free", metavar="NAME", help=f"obstacles: {_one_of(SCENES)}, or an MJCF or YAML file"
    )
    parser.add_argument("--scene-seed", type=whole, default=0, metavar="N", help="seed of the obstacles' positions")


def _add_duration(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--duration", type=decimal, default=4.0, metavar="S", help="duration of the motion [s]")


def add_frames(parser: argparse.ArgumentParser) -> None:
    """Options for importing a model file."""
    parser.add_argument(
        "--links",
        metavar="A,B,...",
        help="bodies or sites of a model file as link frames, from the base outwards (default: chosen automatically)",
    )
    parser.add_argument(
        "--joints", metavar="A,B,...", help="joints of a model file that are the arm, instead of its links"
    )
    parser.add_argument(
        "--tip", metavar="NAME", help="body or site of a model file that is the end effector, if no links are named"
    )
    parser.add_argument(
        "--base", metavar="NAME", help="body or site that is the base frame (default: chosen automatically)"
    )
    parser.add_argument(
        "--keyframe",
        metavar="NAME",
        help="keyframe of an MJCF file with the home position and those of locked joints (default: home, or the first)",
    )
    parser.add_argument(
        "--home", metavar="J=X,...", help="home positions of single joints of a model file, by name [rad, m]"
    )
    parser.add_argument(
        "--servos",
        default="keep",
        metavar="RULE",
        help="keep: use the position servos of an MJCF file; design: replace them by new ones",
    )
    parser.add_argument(
        "--floor",
        default="auto",
        metavar="HEIGHT",
        help="height of the floor below an imported arm [m], or none (default: the file's own floor, else at its base)",
    )


def add_planning(
    parser: argparse.ArgumentParser,
    output: str,
    *,
    goal: bool = True,
    bias_magnitude: float | None = None,
    planners: Iterable[str] = PLANNERS,
) -> None:
    """Options of ``plan``, ``synthesize`` and ``demo``; by default the planner tries several bias magnitudes."""
    add_task(parser, output, goal=goal)
    parser.add_argument(
        "--planner",
        metavar="NAME",
        help="one of these (default: lieednn-certified, among obstacles lieednn-shaped):\n"
        + "\n".join(f"{name}: {PLANNERS[name].help}" for name in planners),
    )
    parser.add_argument(
        "--bias",
        metavar="RULE",
        help=f"rule that chooses the network's bias: {_one_of(BIAS_RULES)} (default: sign-matched)",
    )
    usual = "several are tried" if bias_magnitude is None else f"{bias_magnitude:g}"
    parser.add_argument("--bias-magnitude", type=decimal, metavar="B", help=f"magnitude of the bias (default: {usual})")
    parser.add_argument(
        "--n-networks",
        type=whole,
        metavar="N",
        help="number of networks to draw, of which the best is chosen (default: 24)",
    )
    parser.add_argument(
        "--keep",
        choices=("line", "orientation"),
        help="let the end effector go on a straight line, or keep its orientation, on the way",
    )
    parser.add_argument(
        "--fastest", action="store_true", help="follow the planned path as fast as the arm's limits allow"
    )
    _add_time_budget(parser, "; 'inf' for no limit")
    parser.set_defaults(usual_bias_magnitude=bias_magnitude)


def add_training(parser: argparse.ArgumentParser) -> None:
    """Options of ``train``."""
    add_task(parser, output="results/run")
    parser.add_argument(
        "--algorithm", default="tracked", metavar="NAME", help=f"learning algorithm: {_one_of(ALGORITHMS)}"
    )
    parser.add_argument(
        "--candidates",
        type=whole,
        default=4,
        metavar="N",
        help="largest number of seeds to try until the motion of a network is within the arm's limits",
    )
    parser.add_argument(
        "--period",
        type=whole,
        metavar="P",
        help="number of epochs between two projections onto scaled adjoints (default: that of the algorithm)",
    )
    parser.add_argument("--epochs", type=whole, metavar="K", help="largest number of epochs (default: 25000)")
    parser.add_argument(
        "--tolerance",
        type=decimal,
        default=1e-5,
        metavar="TAU",
        help="largest allowed error of the equilibrium [rad, units of length of the arm]",
    )
    parser.add_argument(
        "--bias",
        default="sign-matched",
        metavar="RULE",
        help="rule that chooses the network's bias: uniform or sign-matched",
    )
    parser.add_argument("--bias-magnitude", type=decimal, default=0.125, metavar="B", help="magnitude of the bias")


def add_run(parser: argparse.ArgumentParser) -> None:
    """The run directory of a command that reads one."""
    parser.add_argument("run", metavar="DIR", help="run directory, made by 'plan', 'synthesize', 'train' or 'demo'")


def add_sequence(parser: argparse.ArgumentParser) -> None:
    """The file of ``sequence``, and what is made of it."""
    parser.add_argument("file", metavar="FILE", help="the description of the sequence, a YAML or JSON file")
    parser.add_argument("--output", default="results/sequence", metavar="DIR", help="directory for the files")
    parser.add_argument("--hold", type=decimal, default=1.0, metavar="S", help="time simulated after the last step [s]")
    parser.add_argument("--no-page", action="store_true", help="do not make run.html, a page that plays in 3D")
    parser.add_argument("--no-video", action="store_true", help="do not make video.mp4")


def add_export(parser: argparse.ArgumentParser) -> None:
    """Options of ``export``."""
    parser.add_argument(
        "runs", nargs="+", metavar="RUN", help="run directories, or for plannerarena directories of 'compare'"
    )
    parser.add_argument("--format", required=True, metavar="NAME", help=_one_of(FORMATS))
    parser.add_argument(
        "--rate", type=decimal, metavar="HZ", help="samples per second (default: every step of the simulation)"
    )
    parser.add_argument("--output", default="results/export", metavar="DIR", help="directory of the files")


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Options of ``record``."""
    parser.add_argument("--episodes", type=whole, default=50, metavar="N", help="number of successful episodes")
    _add_arm_name(parser)
    _add_scene(parser)
    parser.add_argument(
        "--planner", metavar="NAME", help="planner of the expert (default: as for 'plan'); see lieednn-sim plan --help"
    )
    parser.add_argument("--seed", type=whole, default=0, help="seed of the first episode; each other has the next one")
    parser.add_argument("--output", default="results/episodes", metavar="DIR", help="directory of the data set")


def add_comparison(parser: argparse.ArgumentParser) -> None:
    """Options of ``compare``."""
    for name, known, more, default in (
        ("planners", PLANNERS, "", "all"),
        ("arms", ARMS, ", or MJCF, URDF or YAML files, with links as in robot.urdf:wrist,tool", "all"),
        ("scenes", SCENES, ", or MJCF or YAML files of obstacles", "free,window"),
        ("controllers", CONTROLLERS, "", "position-servo,inverse-dynamics"),
    ):
        parser.add_argument(
            f"--{name}", nargs="+", metavar="A,B,...", help=f"any of {', '.join(known)}{more} (default: {default})"
        )
    parser.add_argument(
        "--seeds", type=whole, default=3, metavar="N", help="number of seeds for each arm, scene and planner: 0, 1, ..."
    )
    parser.add_argument(
        "--slow-seeds",
        type=whole,
        metavar="N",
        help=f"number of seeds for planners whose cases take more than {SLOW:g} s of CPU time: "
        f"{', '.join(name for name, entry in PLANNERS.items() if entry.cost > SLOW)} (default: as for the others)",
    )
    parser.add_argument("--duration", type=decimal, default=4.0, metavar="S", help="duration of the motions [s]")
    _add_time_budget(parser)
    _add_conditions(parser)
    parser.add_argument("--output", default="results/comparison", metavar="DIR", help="directory of the table")
    parser.add_argument(
        "--jobs", type=whole, metavar="N", help="number of worker processes (default: one for each core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of the scheduler of a Dask cluster, whose workers run the cases instead of --jobs",
    )
    parser.add_argument("--shard", metavar="K/N", help="run only the K-th of N parts of the cases")
    parser.add_argument(
        "--merge",
        nargs="+",
        default=[],
        metavar="FOLDER",
        help="run nothing, but add the rows of the tables in other directories, such as those of --shard",
    )
    parser.add_argument(
        "--reactive",
        type=whole,
        default=0,
        metavar="N",
        help="number of seeds for a benchmark of policies that are pushed, loaded and given another target",
    )
    parser.add_argument(
        "--views",
        type=whole,
        default=1,
        metavar="N",
        help="number of problems that the page shows in 3D, with the motions of several planners",
    )
    parser.add_argument("--videos", type=whole, default=0, metavar="N", help="number of cases of which to make videos")
    parser.add_argument(
        "--video",
        action="append",
        default=[],
        metavar="CASE",
        help="a case of which to make a video, planner:arm:scene:seed; may be repeated",
    )
    parser.add_argument(
        "--date", default="", metavar="TEXT", help="date to print at the top of the page (default: none)"
    )


def add_simulation(parser: argparse.ArgumentParser) -> None:
    """Controller and disturbances."""
    parser.add_argument(
        "--controller", default="position-servo", metavar="NAME", help=f"controller: {_one_of(CONTROLLERS)}"
    )
    parser.add_argument(
        "--reference-rate",
        type=decimal,
        metavar="HZ",
        help="rate of the references that the controller gets, held in between [Hz] (default: every time step)",
    )
    _add_conditions(parser)
    parser.add_argument(
        "--payload",
        type=decimal,
        default=0.0,
        metavar="KG",
        help="mass at the end effector [kg], of which the controller does not know",
    )
    parser.add_argument(
        "--push",
        action="append",
        default=[],
        metavar="BODY,FX,FY,FZ,START,DURATION",
        help='force [N] on a body or link ("link 1", ..., "end effector") from START for DURATION [s]; may be repeated',
    )
    for what, unit in (("position", "rad, m"), ("velocity", "rad/s, m/s")):
        parser.add_argument(
            f"--{what}-noise",
            type=decimal,
            default=0.0,
            metavar="SD",
            help=f"standard deviation of the noise of each measured joint {what} [{unit}]",
        )
    parser.add_argument("--noise-seed", type=whole, default=0, metavar="N", help="seed of the noise")


def add_view(parser: argparse.ArgumentParser) -> None:
    """Options of ``view``."""
    parser.add_argument(
        "arm", nargs="?", default="telescopic_pr", metavar="ARM", help=f"{_one_of(ARMS)}, or an MJCF, URDF or YAML file"
    )
    add_frames(parser)
    _add_scene(parser)
    parser.add_argument("--policy", default="lieednn-shaped", metavar="NAME", help=f"policy: {_one_of(POLICIES)}")
    parser.add_argument(
        "--planner",
        metavar="NAME",
        help="planner of the motions that the policies tracker and dmp follow (default: as for 'plan')",
    )
    parser.add_argument(
        "--controller", default="inverse-dynamics", metavar="NAME", help=f"controller: {_one_of(CONTROLLERS)}"
    )
    parser.add_argument(
        "--payload",
        type=decimal,
        default=0.0,
        metavar="KG",
        help="mass at the end effector [kg], of which the controller does not know",
    )
    _add_mass_scale(parser)
    parser.add_argument(
        "--target",
        metavar="Q",
        help="first target, given as for 'plan' (default: extended, or random:SEED among obstacles or without it)",
    )
    parser.add_argument("--start", default="home", metavar="Q", help="joints at the start, given as for --target")
    parser.add_argument("--seed", type=whole, default=0, help="seed of random draws")
    parser.add_argument(
        "--port", type=whole, default=0, metavar="N", help="port at which the page is served (default: any free port)"
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="network address to listen at; 0.0.0.0 lets other machines connect",
    )
    parser.add_argument("--no-browser", action="store_true", help="print the page's address, but do not open a browser")


def add_demonstrations(parser: argparse.ArgumentParser) -> None:
    """Options of ``learn``: files of demonstrations, how they are read, and what is learned from them."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="files with demonstrations of one motion, each of which ends at its goal",
    )
    parser.add_argument(
        "--arm",
        metavar="NAME",
        help=f"learn the joints' motion of {_one_of(ARMS)}, or of an MJCF, URDF or YAML file; the columns of "
        "the demonstrations are its joints [rad, m]",
    )
    add_frames(parser)
    parser.add_argument("--unit", default="m", help="unit of the positions in the files: m, cm or mm")
    parser.add_argument(
        "--quaternion", default="wxyz", metavar="ORDER", help="order of the components of quaternions: wxyz or xyzw"
    )
    parser.add_argument(
        "--sample-rate", type=decimal, default=100.0, metavar="HZ", help="sampling rate of files without times [Hz]"
    )
    parser.add_argument(
        "--phase",
        default="length",
        help="average demonstrations at equal fractions of their path, 'length', or of their duration, 'time'",
    )
    parser.add_argument(
        "--goals",
        default="aligned",
        help="'aligned': express each path relative to its own goal; 'kept': learn how the path depends on its goal",
    )
    parser.add_argument(
        "--deviation",
        type=decimal,
        metavar="M",
        help="largest deviation of the network from the mean demonstration [m] (default: 0.002 of the extent of the "
        "demonstrations, or with --arm 0.001 of the length of their path)",
    )
    parser.add_argument(
        "--clock-rate",
        type=decimal,
        default=1.0,
        metavar="RHO",
        help="rate rho of the network's clock: at 1 the path moves along with the start; below 1 the motion returns to "
        "the learned path, 1/rho times as fast",
    )
    parser.add_argument(
        "--rivals", default=",".join(RIVALS), metavar="A,B,...", help="models to compare the network with, or none"
    )
    parser.add_argument(
        "--starts",
        type=whole,
        metavar="N",
        help="number of random starts from which to run each model (default: 1000; with --arm 20)",
    )
    parser.add_argument(
        "--no-family", action="store_true", help="learn the mean motion alone; the deviation of another start fades"
    )
    parser.add_argument(
        "--no-leave-one-out", action="store_true", help="do not fit the models again with each demonstration left out"
    )
    parser.add_argument("--seed", type=whole, default=0, help="seed of random draws")
    parser.add_argument("--output", default="results/learned-motion", metavar="DIR", help="directory for the results")


def _one_of(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} or {names[-1]}"


def _add_time_budget(parser: argparse.ArgumentParser, more: str = "") -> None:
    parser.add_argument(
        "--time-budget",
        type=decimal_or_inf,
        default=60.0,
        metavar="S",
        help=f"largest CPU time for planning one motion [s]{more}",
    )


def _add_mass_scale(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--mass-scale",
        type=decimal,
        default=1.0,
        metavar="X",
        help="true masses and inertias, relative to those that the controller knows",
    )


def _add_conditions(parser: argparse.ArgumentParser) -> None:
    _add_mass_scale(parser)
    parser.add_argument("--hold", type=decimal, default=1.0, metavar="S", help="time simulated after the motion [s]")


def add_plots(parser: argparse.ArgumentParser) -> None:
    """Format of the plots."""
    parser.add_argument("--plots", default="png", metavar="KIND", help="format of the plots: png, pdf or svg")


def add_video(parser: argparse.ArgumentParser) -> None:
    """Quality, size and view of a video."""
    parser.add_argument("--preset", default="nice", help="quality: draft, which is faster, or nice")
    parser.add_argument("--size", default="1280x720", metavar="WxH", help="width and height [pixels]")
    parser.add_argument("--fps", type=whole, default=30, help="frames per second of the video")
    parser.add_argument(
        "--camera",
        metavar="NAME",
        help="name of a camera of the model (default: overview, if there is one, else a view of the whole)",
    )
