"""Command line ``lieednn-sim``; commands import their dependencies when they run, so that ``--help`` is quick."""

from __future__ import annotations

# isort: off
from lieednn_sim.cli import starting  # noqa: F401, before all that takes its time
# isort: on

import argparse
import importlib
import io
import os
import re
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from lieednn_sim.cli import options
from lieednn_sim.cli.interruption import Interruption, say
from lieednn_sim.errors import FileError, LieEDNNError

_DESCRIPTION = (
    "Plan the motion of a telescopic manipulator with LieEDNN networks that carry a proof of global stability, "
    "simulate it in MuJoCo, render and evaluate it."
)
# Modules of the commands that are not in `commands`.
_MODULES = {
    "train": "training",
    "learn": "demonstrations",
    "compare": "comparison",
    "sequence": "sequences",
    "export": "exporting",
    "record": "exporting",
    "arms": "arms",
    "doctor": "doctor",
    "view": "live",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    0: success; 1: ``doctor`` found a problem, or ``train`` learned no network; 2: error;
    130: interrupted; 141: the reader of the output closed it; 143: terminated.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    # Paths and messages may hold characters that the output's encoding lacks.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    # Plots only go to files; a backend that the user chose for windows may not exist here.
    os.environ["MPLBACKEND"] = "agg"
    # A terminated run cleans up like an interrupted one.
    with Interruption(last=argv is None) as interruption:
        try:
            arguments = _parser().parse_args(_join_negative_numbers(words))
            arguments.words = words
            module = importlib.import_module(f"lieednn_sim.cli.{_MODULES.get(arguments.command, 'commands')}")
            interruption.importing = False
            code = int(getattr(module, arguments.command)(arguments) or 0)
            # An output that takes no more is noticed here, not at exit.
            print(end="", flush=True)
            # Libraries may swallow an interruption.
            return code if interruption.received is None else interruption.report()
        except KeyboardInterrupt:
            return interruption.report()
        except Exception as error:
            if interruption.received is not None:
                # Libraries may turn an interruption into other exceptions.
                return interruption.report()
            if isinstance(error, BrokenPipeError):
                # The output's reader closed it, as in `lieednn-sim demo | head`.
                _drop_output()
                return 141
            if isinstance(error, OSError) and not isinstance(error, LieEDNNError):
                # Of the system: no more open files, processes or space.
                failed = (
                    "cannot write to the standard output" if _output_failed() else "the system does not permit this"
                )
                error = FileError(f"{failed}: {error.strerror or error}")
            elif isinstance(error, MemoryError):
                error = LieEDNNError(f"out of memory ({error})" if str(error) else "out of memory")
            elif not isinstance(error, LieEDNNError):
                raise
            say(f"error: {error}")
            return 2


def _output_failed() -> bool:
    """Whether the standard output can no longer be written, as on a full disk; then it is discarded."""
    try:
        print(flush=True)  # flushing alone tells nothing of an output without a buffer
    except OSError:
        _drop_output()
        return True
    return False


def _drop_output() -> None:
    """Discard what is buffered for the standard output, since writing it would fail again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _join_negative_numbers(argv: Sequence[str]) -> list[str]:
    """Rewrite ``--target -1,2`` as ``--target=-1,2``, since argparse takes a leading minus for another option."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and re.match(r"-\.?\d", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


class _Help(argparse.HelpFormatter):
    """Keeps line breaks, adds none at hyphens, and adds defaults to help texts that do not mention them."""

    def _get_help_string(self, action: argparse.Action) -> str:
        text = action.help or ""
        said = "(default" in text or action.default is False or action.default in (None, "", [], argparse.SUPPRESS)
        return text if said else f"{text} (default: %(default)s)"

    def _split_lines(self, text: str, width: int) -> list[str]:
        return [part for line in text.splitlines() for part in textwrap.wrap(line, width, break_on_hyphens=False)]


class _Version(argparse.Action):
    """Looks up and prints the version."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        import lieednn_sim

        print(f"lieednn-sim {lieednn_sim.__version__}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="lieednn-sim", description=_DESCRIPTION)
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, summary: str, more: str) -> argparse.ArgumentParser:
        text = f"{summary[0].upper()}{summary[1:]}. {more}"
        return commands.add_parser(name, help=summary, description=text, formatter_class=_Help)

    demo = command(
        "demo",
        "run everything: plan a motion to a target, simulate it, evaluate it, make a page and a video",
        "Without a target, the arm goes to its keyframe 'extended', or to a random target among obstacles.",
    )
    # The paper's bias; the planner's own choice is often stronger, and leaves less to the weights.
    options.add_planning(demo, output="results/demo", goal=False, bias_magnitude=0.125)
    options.add_simulation(demo)
    options.add_video(demo)
    options.add_plots(demo)
    demo.add_argument(
        "--no-page", action="store_true", help="do not make motion.html, a page that plays the motion in 3D"
    )
    demo.add_argument("--no-video", action="store_true", help="do not make video.mp4")

    plan = command(
        "plan",
        "plan a motion to a target with any planner, in a run directory",
        "Continue with 'simulate', 'evaluate' and 'render'.",
    )
    options.add_planning(plan, output="results/run")

    synthesize = command(
        "synthesize",
        "make a certified network for a target, in a run directory",
        "This is 'plan' with only those planners that make a network. Continue with 'simulate'.",
    )
    options.add_planning(synthesize, output="results/run", planners=options.NETWORK_PLANNERS)

    train = command(
        "train",
        "learn a network for a target with the algorithm of the paper, or an improved one",
        "Continue with 'simulate', 'evaluate' and 'render'.",
    )
    options.add_training(train)
    options.add_plots(train)

    learn = command(
        "learn",
        "learn a certified network from recorded motions of an end effector or of an arm's joints",
        "The files are .npy, .npz, .csv or LASA's .mat. Each row is a position x y or x y z, or a pose with a unit"
        " quaternion, and the network is compared with other models. With --arm each row holds the joints of the arm;"
        " continue with 'simulate'.",
    )
    options.add_demonstrations(learn)
    options.add_plots(learn)

    simulate = command(
        "simulate",
        "simulate the motion of a run, with disturbances if asked for",
        "A new simulation replaces the previous one of the run.",
    )
    options.add_run(simulate)
    options.add_simulation(simulate)

    render = command(
        "render",
        "make a video, a picture or a page of the simulation of a run",
        "Videos and pictures need OpenGL (see 'lieednn-sim doctor'), but no display; pages need the extra 'view'.",
    )
    options.add_run(render)
    options.add_video(render)
    render.add_argument(
        "--output",
        metavar="FILE",
        help="an .mp4 or .gif file, or .html for a page that plays in 3D (default: video.mp4 in the run directory)",
    )
    render.add_argument("--still", metavar="FILE", help="make a .png picture that shows the arm at five instants")

    evaluate = command(
        "evaluate",
        "compute metrics and plots of the simulation of a run",
        "The metrics are printed; both are written into the run directory.",
    )
    options.add_run(evaluate)
    options.add_plots(evaluate)

    view = command(
        "view",
        "show an arm in the browser: drag its target, push it, change its policy and its load",
        "It needs the extra 'view' and runs until Ctrl-C. Only this machine can connect, unless --host is given.",
    )
    options.add_view(view)

    compare = command(
        "compare",
        "compare planners on arms, scenes, controllers and seeds, in a table and a page",
        "After an interruption, the same command continues. The defaults take a quarter of an hour of CPU time.",
    )
    options.add_comparison(compare)

    sequence = command(
        "sequence",
        "plan the moves and gripper steps of a file in its model, simulate them, and show them",
        "The file is YAML or JSON: a model, the joints of its arm, and the steps. Results of the same command in the"
        " directory are replaced.",
    )
    options.add_sequence(sequence)
    options.add_video(sequence)

    export = command(
        "export",
        "write runs or comparisons in the file formats of other tools",
        "Runs must have been simulated. The directory must be new, empty, or one of exports.",
    )
    options.add_export(export)

    record = command(
        "record",
        "record successful episodes of the expert as a data set for LeRobot",
        "They are of the learning environment TelescopicReach-v0; the data set needs the extra 'lerobot'.",
    )
    options.add_recording(record)

    arms = command(
        "arms",
        "list the arms of the package, or describe one of them or that of a file",
        "Without a name, the arms of the package are listed.",
    )
    arms.add_argument("arm", nargs="?", metavar="NAME", help="name of an arm, or an MJCF, URDF or YAML file")
    options.add_frames(arms)

    doctor = command(
        "doctor",
        "check the installation: versions, headless OpenGL, what is missing",
        "The exit code is 1 if physics or rendering does not work.",
    )
    doctor.add_argument("--json", action="store_true", help="print JSON instead of a table")
    return parser
