"""The numbers of a live view in words: a table of HTML that is as readable on a dark page as on a white one."""

from __future__ import annotations

from html import escape

import numpy as np

from lieednn_sim.live.snapshot import Snapshot

_GOOD, _BAD, _IDLE = "#2f9e44", "#e03131", "#868e96"
# Distance of a network below which rounding decides.
_ROUNDING = 1e-9
_TABLE = '<table style="width:100%;border-collapse:collapse;font-size:.82em;line-height:1.45">'
_NAME = '<td style="opacity:.65;padding-right:.7em;vertical-align:top;white-space:nowrap">'
_VALUE = '<td style="overflow-wrap:anywhere">'


def status(snapshot: Snapshot) -> str:
    """What the policy does, what is proved about it, and how far it is."""
    tick, progress = snapshot.tick, snapshot.tick.progress
    problem = snapshot.aimed.problem or snapshot.failure
    if problem:
        said, colour = problem, _BAD
    elif snapshot.busy:
        said, colour = "plans", _IDLE
    else:
        said, colour = "has arrived" if snapshot.arrived else tick.message, "inherit"
    rows = [
        ("policy", escape(tick.policy or "waits for a policy")),
        ("proof", _proof(snapshot)),
        ("to the target", f"{_millimetres(snapshot.distance)}, {_degrees(snapshot.angle)}"),
    ]
    if progress is not None:
        bound = f" &le; {progress.bound:.3g} proved" if np.isfinite(progress.bound) else ", no bound proved"
        rounded = progress.distance < _ROUNDING
        rows += [("of the network", "below 1e-9" if rounded else f"{progress.distance:.3g}{bound}")]
    if not np.isnan(snapshot.gap_translation):
        gap = f"{_millimetres(snapshot.gap_translation)}, {_degrees(snapshot.gap_rotation)}"
        rows += [("mechanism gap", gap)]
    nearest = " and ".join(escape(name) for name in snapshot.nearest)
    clearance = f"{_millimetres(snapshot.clearance)}<br>{nearest}" if any(snapshot.nearest) else "more than 600 mm"
    pace = f"{tick.time:.1f} s, {snapshot.achieved:.2f} times real time"
    if snapshot.paused:
        pace = f"{tick.time:.1f} s, paused"
    elif not snapshot.keeps_up:
        pace = f'<b style="color:{_BAD}">{pace}: this machine is too slow for {snapshot.speed:g} times</b>'
    rows += [("clearance", clearance), ("tracking error", _millimetres(snapshot.tracking)), ("time", pace)]
    table = "".join(f"<tr>{_NAME}{name}</td>{_VALUE}{value}</td></tr>" for name, value in rows)
    line = f'<div style="color:{colour};min-height:2.7em;font-size:.88em;padding-bottom:.3em">{escape(said)}</div>'
    return f'<div style="padding:.2em .9em .5em">{line}{_TABLE}{table}</table></div>'


def _proof(snapshot: Snapshot) -> str:
    progress, found = snapshot.tick.progress, snapshot.certificate
    if found is None:
        return f'<span style="color:{_IDLE}">none</span>'
    word, colour = ("certified", _GOOD) if found.valid else ("not certified", _BAD)
    largest = f"&lambda;<sub>max</sub> {found.lambda_max:.3g} against &gamma;/&mu; {found.bound:.3g}"
    rate = "" if progress is None else f"<br>rate {progress.rate:.3g} /s"
    return f'<b style="color:{colour}">{word}</b><br>{largest}{rate}'


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.3g} mm" if abs(value) >= 1e-6 else "below 1 µm"


def _degrees(value: float) -> str:
    return f"{np.rad2deg(value):.2g}°" if value > 1e-4 else "0°"
