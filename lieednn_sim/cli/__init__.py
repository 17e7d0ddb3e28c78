"""Command line ``lieednn-sim``; the commands import what they need when they run, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
import re
import signal
import sys
import threading
from collections.abc import Sequence

from lieednn_sim.errors import LieEDNNError

_DESCRIPTION = (
    "Plan the motion of a telescopic manipulator with LieEDNN networks that carry a proof of global stability, "
    "simulate it in MuJoCo, render and evaluate it."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit code.

    0 well, 1 doctor found a problem, 2 an error, 130 interrupted or terminated, 141 the reader of the output went away.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser().parse_args(_join_negative_numbers(words))
    arguments.words = words
    # A terminated run cleans up like an interrupted one; handlers belong to the main thread alone.
    restore = None
    if threading.current_thread() is threading.main_thread():
        restore = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        from lieednn_sim.cli import commands

        return int(getattr(commands, arguments.command)(arguments) or 0)
    except LieEDNNError as error:
        print(f"lieednn-sim: error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("lieednn-sim: interrupted; files already reported are complete", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output went away, as in `lieednn-sim demo | head`.
        sys.stderr.close()
        return 141
    finally:
        if restore is not None:
            signal.signal(signal.SIGTERM, restore)


def _join_negative_numbers(argv: Sequence[str]) -> list[str]:
    """Write ``--target -1,2`` as ``--target=-1,2``, for argparse takes a leading minus for another option."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and re.match(r"-\.?\d", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="lieednn-sim", description=_DESCRIPTION)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="the whole road: target, network, motion, simulation, video, report")
    _add_planning(demo, output="results/demo", target="extended")
    # The paper's bias: the planner's own choice is often stronger, and leaves the weights less to do.
    demo.set_defaults(bias_magnitude=0.125)
    _add_simulation(demo)
    _add_video(demo)
    demo.add_argument("--no-video", action="store_true", help="skip rendering")

    synthesize = commands.add_parser("synthesize", help="make a certified network for a target, into a run directory")
    _add_planning(synthesize, output="results/run", target=None)

    train = commands.add_parser("train", help="learn a network for a target by the paper's algorithm, or a better one")
    _add_training(train)

    simulate = commands.add_parser("simulate", help="plan the motion of a run's network and simulate it")
    _add_run(simulate)
    _add_simulation(simulate)

    render = commands.add_parser("render", help="render a run's simulation")
    _add_run(render)
    _add_video(render)
    render.add_argument("--output", metavar="FILE", help=".mp4 or .gif (default: video.mp4 in the run directory)")

    evaluate = commands.add_parser("evaluate", help="metrics and plots of a run's simulation")
    _add_run(evaluate)

    compare = commands.add_parser("compare", help="planners x arms x scenes x controllers x seeds: table and page")
    _add_comparison(compare)

    doctor = commands.add_parser("doctor", help="versions, headless OpenGL, and what is missing")
    doctor.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return parser


def _add_task(parser: argparse.ArgumentParser, output: str, target: str | None) -> argparse._MutuallyExclusiveGroup:
    parser.add_argument("--arm", default="telescopic_pr", help="name of the arm (default: %(default)s)")
    goal = parser.add_mutually_exclusive_group(required=target is None)
    goal.add_argument(
        "--target",
        default=target,
        metavar="Q",
        help="joint target: a keyframe's name or comma-separated joint positions [rad, m]"
        + (f" (default: {target})" if target else ""),
    )
    goal.add_argument("--position", metavar="X,Y,Z", help="end effector target in the world [m] instead")
    parser.add_argument("--start", default="home", metavar="Q", help="start, as for --target (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=4.0, metavar="S", help="of the motion (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the random draws (default: %(default)s)")
    parser.add_argument("--output", default=output, metavar="DIR", help="run directory (default: %(default)s)")
    return goal


def _add_planning(parser: argparse.ArgumentParser, output: str, target: str | None) -> None:
    _add_task(parser, output, target)
    parser.add_argument(
        "--bias", default="sign-matched", metavar="RULE", help="uniform, sign-matched or solved (default: %(default)s)"
    )
    parser.add_argument("--bias-magnitude", type=float, metavar="B", help="of the rule (default: several are tried)")
    parser.add_argument(
        "--candidates", type=int, default=24, metavar="N", help="networks to choose from (default: %(default)s)"
    )


def _add_training(parser: argparse.ArgumentParser) -> None:
    goal = _add_task(parser, output="results/run", target=None)
    goal.add_argument("--resume", metavar="DIR", help="go on with an interrupted training, options as they were")
    parser.add_argument(
        "--algorithm",
        default="tracked",
        metavar="NAME",
        help="literal, repaired, tracked, riemannian or stability-aware (default: %(default)s)",
    )
    parser.add_argument(
        "--candidates",
        type=int,
        default=4,
        metavar="N",
        help="seeds to try until a network's motion keeps the limits (default: %(default)s)",
    )
    parser.add_argument("--period", type=int, metavar="P", help="epochs between projections (default: the algorithm's)")
    parser.add_argument("--epochs", type=int, metavar="K", help="at most (default: 25000)")
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-5,
        metavar="TAU",
        help="of the equilibrium [rad, length units] (default: %(default)s)",
    )
    parser.add_argument(
        "--bias", default="sign-matched", metavar="RULE", help="uniform or sign-matched (default: %(default)s)"
    )
    parser.add_argument(
        "--bias-magnitude", type=float, default=0.125, metavar="B", help="of the rule (default: %(default)s)"
    )


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("run", metavar="DIR", help="run directory, made by 'synthesize', 'train' or 'demo'")


def _add_comparison(parser: argparse.ArgumentParser) -> None:
    for name, default in (
        ("planners", "all"),
        ("arms", "all"),
        ("scenes", "free,window"),
        ("controllers", "position-servo,inverse-dynamics"),
    ):
        parser.add_argument(f"--{name}", metavar="A,B,...", help=f"names, comma-separated (default: {default})")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="from seed 0 on (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=4.0, metavar="S", help="of motions (default: %(default)s)")
    _add_conditions(parser)
    parser.add_argument("--output", default="results/comparison", metavar="DIR", help="(default: %(default)s)")
    parser.add_argument("--jobs", type=int, metavar="N", help="worker processes (default: all cores)")
    parser.add_argument("--videos", type=int, default=0, metavar="N", help="cases to show (default: %(default)s)")
    parser.add_argument(
        "--video",
        action="append",
        default=[],
        metavar="CASE",
        help="a case to show, planner:arm:scene:seed; may be given more than once",
    )
    parser.add_argument("--date", default="", metavar="TEXT", help="to put into the page's head (default: none)")


def _add_simulation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--controller",
        default="position-servo",
        metavar="NAME",
        help="position-servo, inverse-dynamics, computed-torque or mocap (default: %(default)s)",
    )
    _add_conditions(parser)


def _add_conditions(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--mass-scale",
        type=float,
        default=1.0,
        metavar="X",
        help="true masses in units of those that the controller knows (default: %(default)s)",
    )
    parser.add_argument(
        "--hold", type=float, default=1.0, metavar="S", help="time simulated after the motion (default: %(default)s)"
    )


def _add_video(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--preset", default="nice", help="draft or nice (default: %(default)s)")
    parser.add_argument("--size", default="1280x720", metavar="WxH", help="pixels (default: %(default)s)")
    parser.add_argument("--fps", type=int, default=30, help="frames a second (default: %(default)s)")
    parser.add_argument("--camera", default="overview", help="a camera of the scene (default: %(default)s)")
