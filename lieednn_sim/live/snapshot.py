"""What a live view shows, computed from the state of a session in the thread that shows it."""

from __future__ import annotations

import copy

import numpy as np
from scipy.spatial.transform import RigidTransform

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.live.engine import Tick
from lieednn_sim.live.proof import certificate_of, network_policy
from lieednn_sim.live.session import Aim, Session
from lieednn_sim.stability import Certificate
from lieednn_sim.values import Floats, frozen

# Distance of the end effector at which the arm has arrived [m], and angle [rad].
_ARRIVED = 1e-3, 5e-3
# Distance within which geoms are looked at [m], and the least derivative of one that joints can change.
_NEAR, _LEAST_SLOPE = 0.6, 1e-6


@frozen
class Snapshot:
    """One instant of a session.

    Attributes:
        tick: state of the loop.
        aimed: the target that was asked for last.
        certificate: of the policy's network; None without one.
        frames: link frames, poses of shape ``(N,)``.
        planned: link frames of the reference.
        distance: of the end effector from the target [m].
        angle: the same as an angle [rad].
        tracking: distance of the end effector from its reference [m].
        gap_translation: largest mechanism gap of a link [m]; NaN without a network.
        gap_rotation: the same as an angle [rad].
        clearance: least distance of two geoms whose distance the joints can change [m]; infinite beyond 0.6 m.
        nearest: their names; empty beyond.
        achieved: speed at which the loop simulates, relative to real time.
        speed: speed at which it should.
        paused: whether it waits.
        busy: whether a policy or a plant is being made.
        failure: the last error; empty if there is none.
    """

    tick: Tick
    aimed: Aim
    certificate: Certificate | None
    frames: RigidTransform
    planned: RigidTransform
    distance: float
    angle: float
    tracking: float
    gap_translation: float
    gap_rotation: float
    clearance: float
    nearest: tuple[str, str]
    achieved: float
    speed: float
    paused: bool
    busy: bool
    failure: str

    @property
    def arrived(self) -> bool:
        """Whether the end effector is within a millimetre and 5 mrad of the target."""
        return self.distance < _ARRIVED[0] and self.angle < _ARRIVED[1]

    @property
    def keeps_up(self) -> bool:
        """Whether the machine simulates as fast as it should."""
        return self.paused or self.achieved > 0.95 * self.speed


class Observer:
    """Takes snapshots of a session, all in one thread."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._arm = copy.deepcopy(session.arm)
        self._collisions = Collisions(self._arm)

    def look(self) -> Snapshot:
        """The present instant."""
        session, arm = self._session, self._arm
        tick = session.tick
        poses = arm.link_poses(np.stack([tick.q, tick.q_ref, tick.target]))
        frames, planned, goals = poses[0], poses[1], poses[2]
        places: Floats = np.asarray(poses.translation)[:, -1]
        near = self._collisions.distances(tick.q, _NEAR)
        changing = np.flatnonzero(np.abs(near.jacobian).max(axis=1, initial=0.0) > _LEAST_SLOPE)
        first = int(changing[0]) if len(changing) else None
        inner = network_policy(session.policy)
        gap = np.full(2, np.nan) if inner is None else inner.gap.max(axis=0)
        return Snapshot(
            tick,
            session.aimed,
            certificate_of(session.policy),
            frames,
            planned,
            float(np.linalg.norm(places[0] - places[2])),
            float((frames[-1].rotation.inv() * goals[-1].rotation).magnitude()),
            float(np.linalg.norm(places[0] - places[1])),
            float(gap[1]),
            float(gap[0]),
            np.inf if first is None else float(near.distance[first]),
            ("", "") if first is None else self._collisions.names(near.pairs[first]),
            session.achieved,
            session.speed,
            session.paused,
            session.busy,
            session.failure,
        )
