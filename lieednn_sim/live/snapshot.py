"""What a live view shows, and says in words, computed from the state of a session in the thread that shows it."""

from __future__ import annotations

import copy
from html import escape
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.evaluation.metrics import pose_errors
from lieednn_sim.live.engine import Tick, certificate_of, network_policy
from lieednn_sim.live.session import Aim, Session
from lieednn_sim.values import Floats

_GOOD, _BAD, _IDLE = "#2f9e44", "#e03131", "#868e96"
_TABLE = '<table style="width:100%;border-collapse:collapse;font-size:.82em;line-height:1.45">'
_NAME = '<td style="opacity:.65;padding-right:.7em;vertical-align:top;white-space:nowrap">'
_VALUE = '<td style="overflow-wrap:anywhere">'


class Snapshot(NamedTuple):
    """One instant of a session."""

    session: Session
    tick: Tick  # state of the loop
    aimed: Aim  # the target that was asked for last
    frames: RigidTransform  # link frames, poses of shape (N,)
    planned: RigidTransform  # link frames of the reference
    distance: float  # of the end effector from the target [m]
    angle: float  # the same as an angle [rad]
    tracking: float  # distance of the end effector from its reference [m]
    gap: Floats | None  # (2,) largest mechanism gap of a link [rad, m]; None without a network
    clearance: float  # least distance of two geoms whose distance the joints can change [m]; infinite beyond 0.6 m
    nearest: tuple[str, str]  # their names; empty beyond

    @property
    def arrived(self) -> bool:
        """Whether the end effector is within a millimetre and 5 mrad of the target."""
        return self.distance < 1e-3 and self.angle < 5e-3


class Observer:
    """Takes snapshots of a session, all in one thread."""

    def __init__(self, session: Session) -> None:
        self._session, self._arm = session, copy.deepcopy(session.arm)
        self._collisions = Collisions(self._arm)

    def look(self) -> Snapshot:
        """The present instant."""
        session, arm, tick = self._session, self._arm, self._session.tick
        poses = arm.link_poses(np.stack([tick.q, tick.q_ref, tick.target]))
        frames, planned, goals = poses[0], poses[1], poses[2]
        distance, angle = pose_errors(frames[-1], goals[-1])
        near = self._collisions.distances(tick.q, 0.6)
        changing = np.flatnonzero(np.abs(near.jacobian).max(axis=1, initial=0.0) > 1e-6)
        first = int(changing[0]) if len(changing) else None
        inner = network_policy(session.policy)
        return Snapshot(
            session,
            tick,
            session.aimed,
            frames,
            planned,
            float(distance),
            float(angle),
            float(pose_errors(frames[-1], planned[-1])[0]),
            None if inner is None else inner.gap.max(axis=0),
            np.inf if first is None else float(near.distance[first]),
            ("", "") if first is None else self._collisions.names(near.pairs[first]),
        )


def status(snapshot: Snapshot) -> str:
    """What the policy does, what is proved about it, and how far it is: HTML that is readable on dark and on white."""
    session, tick, progress = snapshot.session, snapshot.tick, snapshot.tick.progress
    problem = snapshot.aimed.problem or session.failure
    if problem:
        said, colour = problem, _BAD
    elif session.busy:
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
        # Below it rounding decides.
        rows += [("of the network", "below 1e-9" if progress.distance < 1e-9 else f"{progress.distance:.3g}{bound}")]
    if snapshot.gap is not None:
        rows += [("mechanism gap", f"{_millimetres(snapshot.gap[1])}, {_degrees(snapshot.gap[0])}")]
    nearest = " and ".join(escape(name) for name in snapshot.nearest)
    clearance = f"{_millimetres(snapshot.clearance)}<br>{nearest}" if any(snapshot.nearest) else "more than 600 mm"
    pace = f"{tick.time:.1f} s, {session.achieved:.2f} times real time"
    if session.paused:
        pace = f"{tick.time:.1f} s, paused"
    elif session.achieved <= 0.95 * session.speed:
        pace = f'<b style="color:{_BAD}">{pace}: this machine is too slow for {session.speed:g} times</b>'
    if (way := session.way) is not None and not way.clearance.reason:
        where = "inside" if way.holds(tick.q) else f'<b style="color:{_BAD}">outside</b>'
        proved = f'<b style="color:{_GOOD if way.clearance.proved else _BAD}">{way.clearance.at()}</b>'
        rows += [("way ahead", f"{proved}<br>the arm is {where}")]
    rows += [("clearance", clearance), ("tracking error", _millimetres(snapshot.tracking)), ("time", pace)]
    table = "".join(f"<tr>{_NAME}{name}</td>{_VALUE}{value}</td></tr>" for name, value in rows)
    line = f'<div style="color:{colour};min-height:2.7em;font-size:.88em;padding-bottom:.3em">{escape(said)}</div>'
    return f'<div style="padding:.2em .9em .5em">{line}{_TABLE}{table}</table></div>'


def _proof(snapshot: Snapshot) -> str:
    progress, result = snapshot.tick.progress, certificate_of(snapshot.session.policy)
    if result is None:
        return f'<span style="color:{_IDLE}">none</span>'
    word, colour = ("certified", _GOOD) if result.valid else ("not certified", _BAD)
    largest = f"&lambda;<sub>max</sub> {result.lambda_max:.3g} against &gamma;/&mu; {result.bound:.3g}"
    rate = "" if progress is None else f"<br>rate {progress.rate:.3g} /s"
    return f'<b style="color:{colour}">{word}</b><br>{largest}{rate}'


def _millimetres(value: float) -> str:
    return f"{1e3 * value:.3g} mm" if abs(value) >= 1e-6 else "below 1 µm"


def _degrees(value: float) -> str:
    return f"{np.rad2deg(value):.2g}°" if value > 1e-4 else "0°"
