"""Command line ``lieednn-sim``; the commands import what they need when they run, so that ``--help`` is quick."""

from __future__ import annotations

import argparse
import re
import signal
import sys
import threading
from collections.abc import Sequence

from lieednn_sim.cli import options
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
    options.add_planning(demo, output="results/demo", goal=False)
    # The paper's bias: the planner's own choice is often stronger, and leaves the weights less to do.
    demo.set_defaults(usual_bias_magnitude=0.125)
    options.add_simulation(demo)
    options.add_video(demo)
    demo.add_argument("--no-video", action="store_true", help="skip rendering")

    synthesize = commands.add_parser("synthesize", help="make a certified network for a target, into a run directory")
    options.add_planning(synthesize, output="results/run")

    train = commands.add_parser("train", help="learn a network for a target by the paper's algorithm, or a better one")
    options.add_training(train)

    simulate = commands.add_parser("simulate", help="simulate a run's motion, disturbed if wanted")
    options.add_run(simulate)
    options.add_simulation(simulate)

    render = commands.add_parser("render", help="render a run's simulation")
    options.add_run(render)
    options.add_video(render)
    render.add_argument("--output", metavar="FILE", help=".mp4 or .gif (default: video.mp4 in the run directory)")

    evaluate = commands.add_parser("evaluate", help="metrics and plots of a run's simulation")
    options.add_run(evaluate)

    compare = commands.add_parser("compare", help="planners x arms x scenes x controllers x seeds: table and page")
    options.add_comparison(compare)

    arms = commands.add_parser("arms", help="the arms there are, or what an MJCF file gives as an arm")
    arms.add_argument("arm", nargs="?", metavar="NAME", help="name of an arm, or an MJCF file, to describe in full")
    options.add_frames(arms)

    doctor = commands.add_parser("doctor", help="versions, headless OpenGL, and what is missing")
    doctor.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return parser
