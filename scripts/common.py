"""Code that the studies share: options, files that they write, and finished runs that they keep."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim.budget import one_blas_thread
from lieednn_sim.cli.console import progress
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.studies.study import run_each
from lieednn_sim.values import Floats

BATCH = 256  # rows of a step of `perceptron`


def options(
    words: Sequence[str] | None,
    about: str | None,
    output: str,
    folders: Sequence[str] = (),
    choices: Mapping[str, Iterable[str]] | None = None,
    **defaults: Any,
) -> argparse.Namespace:
    """Parse a command line with folders, ``--output``, and options with the types of their defaults.

    A folder's name ends in a plus if there may be several. Values of an option are separated by blanks or commas;
    ``choices`` lists the allowed ones.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in folders:
        parser.add_argument(name.rstrip("+"), type=Path, nargs="+" if name.endswith("+") else None)
    several = {name: default for name, default in defaults.items() if isinstance(default, list | tuple)}
    for name, default in defaults.items():
        if default is False:
            parser.add_argument(f"--{name}", action="store_true")
        else:
            kind = str if name in several else type(default)
            parser.add_argument(f"--{name}", type=kind, default=default, nargs="+" if name in several else None)
    if output:
        parser.add_argument("--output", type=Path, default=Path(output))
    given = parser.parse_args(words)
    for name, default in several.items():
        kind, value = type(default[0]), getattr(given, name)
        if value is not default:
            setattr(given, name, [kind(part) for word in value for part in word.split(",")])
        if wrong := [one for one in getattr(given, name) if one not in (choices or {}).get(name, [one])]:
            parser.error(f"--{name}: {wrong[0]!r} is none of {', '.join((choices or {})[name])}")
    if getattr(given, "jobs", 1) < 1:
        parser.error(f"argument --jobs: must be at least 1, got {given.jobs}")
    return given


def write(path: Path, lines: Iterable[str]) -> None:
    """Write lines of text, with the folder if it is not there, and show them."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join(lines) + "\n"
    io.save_text(path, text)
    print(text)


def spread(values: Sequence[float] | np.ndarray, *levels: float) -> list[str]:
    """Quantiles of values as cells of a table, of three digits; dashes where there is no value."""
    return [f"{value:.3g}" for value in np.quantile(values, levels)] if len(values) else ["-"] * len(levels)


def saved_runs(folder: Path, runs: Mapping[str, tuple[Any, ...]], work: Callable[..., Any], jobs: int) -> list[Any]:
    """The results of ``work`` for the arguments of each run; kept in JSON files, so that an interrupted study goes on.

    Several jobs are processes of one thread each, so that sums are always in the same order. Raises `FileError` if a
    kept run had other arguments; paths are not compared.
    """
    io.make_directory(folder)
    each = [(folder / f"{name}.json", work, given) for name, given in runs.items()]
    missing = [run for run in each if not run[0].is_file()]
    if missing:
        with progress(folder.name):
            run_each(_keep, missing, _ended, workers=jobs)
    return [_made(path, _compared(given)) for path, _, given in each]


def _keep(path: Path, work: Callable[..., Any], given: tuple[Any, ...]) -> None:
    with one_blas_thread():
        io.save_json(path, {"asked": _compared(given), "made": work(*given)})


def _ended(_run: tuple[Any, ...], _made: Any, error: Exception | None) -> None:
    if error is not None:
        raise error


def _compared(given: tuple[Any, ...]) -> str:
    return ", ".join(str(value) for value in given if not isinstance(value, Path))


def _made(path: Path, asked: str) -> Any:
    run = io.load_json(path, "a run")
    if run.get("asked") != asked:
        raise FileError(f"{path} was made with {run.get('asked')}, and {asked} is asked for; choose another --output")
    return run["made"]


def saved_rows(
    folder: Path, cases: Sequence[dict[str, Any]], measure: Callable[..., dict[str, Any]], jobs: int = 1
) -> list[dict[str, Any]]:
    """A row for each case, kept as by `saved_runs`: the case, what ``measure`` returns, or ``reason`` if it fails."""
    runs = {"-".join(map(str, case.values())): tuple(case.values()) for case in cases}
    made = saved_runs(folder, runs, partial(_row, measure), jobs)
    return [case | row for case, row in zip(cases, made, strict=True)]


def _row(measure: Callable[..., dict[str, Any]], *case: Any) -> dict[str, Any]:
    try:
        return {"reason": ""} | measure(*case)
    except LieEDNNError as error:
        return {"reason": str(error)}


def perceptron(x: Floats, y: Floats, rate: float, epochs: int, seed: int) -> Iterator[Any]:
    """Fit a network of torch, with two layers of 256, to rows by least squares; yields it after each step."""
    torch = import_module("torch")
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    x, y = (torch.as_tensor(rows, dtype=torch.float32) for rows in (x, y))
    sizes = (x.shape[1], 256, 256)
    layers = [part for size in pairwise(sizes) for part in (torch.nn.Linear(*size), torch.nn.ReLU())]
    network = torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], y.shape[1]))
    optimiser, batches = torch.optim.Adam(network.parameters()), len(x) // BATCH
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, epochs * batches)
    for _ in range(epochs):
        for rows in torch.randperm(len(x))[: batches * BATCH].view(-1, BATCH):
            optimiser.zero_grad()
            torch.nn.functional.mse_loss(network(x[rows]), y[rows]).backward()
            optimiser.step()
            schedule.step()
            yield network
