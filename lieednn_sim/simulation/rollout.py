"""Rollouts: logs of simulated motions, with one row per instant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim import io
from lieednn_sim._mujoco import kinematics_each, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.frames import BodyFrames, find_frame
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.lie.se3 import transforms
from lieednn_sim.planning.clearance import Clearance, proved_clearance
from lieednn_sim.planning.monitor import MOVED, ClearanceMonitor, displaced
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation.disturbances import Disturbances
from lieednn_sim.validation import as_floats, as_positive, as_times
from lieednn_sim.values import Floats, StrPath, check_fields, frozen, set_fields

_PER_COORDINATE = ("q", "qd", "q_ref", "qd_ref", "force", "constraint_force")
_OTHERS = ("qpos", "ctrl", "link_position", "link_quaternion", "contacts", "contact_force", "target")
_ARRAYS = ("t", *_PER_COORDINATE, *_OTHERS)
_CHANNEL = "channel "  # before the names of channels in a file
SLIP = "slip in the hand"  # the channel of what a sequence holds


@frozen
class Rollout:
    """Log of a simulation and of its conditions; row k of every array over time belongs to time ``t[k]``.

    Attributes:
        arm: the simulated arm in its scene.
        t: ``(K,)`` times [s].
        q: ``(K, n)`` joint coordinates [rad, m].
        qd: ``(K, n)`` their rates [rad/s, m/s].
        q_ref: ``(K, n)`` reference of the joint coordinates; the controller may have seen held samples of it.
        qd_ref: ``(K, n)`` its rates.
        ctrl: ``(K, nu)`` controls of the arm's own actuators, within the ranges to which MuJoCo clips them.
        force: ``(K, n)`` actuator force along each coordinate [N m, N], for ball joints about the axes of the moving
            body; gravity compensation by ``gravcomp`` is part of it at joints with ``actuatorgravcomp`` alone.
        constraint_force: ``(K, n)`` the same for the forces of contacts, joint limits and welds.
        link_position: ``(K, N, 3)`` simulated link frames, world [m].
        link_quaternion: ``(K, N, 4)`` the same, (w, x, y, z).
        contacts: ``(K,)`` number of contacts; for a view, those between what the arm moves or carries and anything that
            does not move with it, fingers around a free body included.
        contact_force: ``(K,)`` largest normal force among the contacts [N].
        channels: ``(K, ...)`` further logs of controllers and disturbances by name, such as those of `MocapWelds` and
            `Pushes`; ``slip in the hand`` is how far the body held by a sequence has moved in the hand [m].
        channel_units: units of the channels, by name.
        motion_end: time at which the reference comes to rest [s].
        qpos: ``(K, nq)`` positions in the order of the arm's model.
        steps: the time at which each step of a sequence began [s], and its name; empty for a single motion.
        controller: a name of `CONTROLLERS`.
        reference_rate: rate at which the controller saw samples of the reference [Hz], None for every step.
        disturbances: disturbances unknown to the controller.
        motion: the planned motion that was followed; None without one.
        target: ``(n,)`` joint position to reach; by default the reference's last one.

    Raises:
        InputError: arrays are malformed, or do not match the arm and the motion.
    """

    arm: Arm
    t: Floats
    q: Floats
    qd: Floats
    q_ref: Floats
    qd_ref: Floats
    ctrl: Floats
    force: Floats
    constraint_force: Floats
    link_position: Floats
    link_quaternion: Floats
    contacts: NDArray[np.int_]
    contact_force: Floats
    qpos: Floats
    motion_end: float
    channels: Mapping[str, Floats] = field(default_factory=dict)
    channel_units: Mapping[str, str] = field(default_factory=dict)
    controller: str = "position-servo"
    reference_rate: float | None = None
    disturbances: Disturbances = field(default_factory=Disturbances)
    motion: Motion | None = None
    target: Floats = field(default_factory=lambda: np.zeros(0))
    steps: tuple[tuple[float, str], ...] = ()

    def __post_init__(self) -> None:
        k = len(as_times("t", self.t))
        n, links = self.arm.n_joints, self.arm.n_links
        check_fields(self, as_floats, *_PER_COORDINATE, shape=(k, n))
        if np.size(self.target) == 0:
            set_fields(self, target=self.q_ref[-1])
        check_fields(self, as_floats, "t", "contacts", "contact_force", shape=(k,))
        check_fields(self, as_floats, "ctrl", shape=(k, "nu"))
        check_fields(self, as_floats, "qpos", shape=(k, self.arm.model.nq))
        check_fields(self, as_floats, "link_position", shape=(k, links, 3))
        check_fields(self, as_floats, "link_quaternion", shape=(k, links, 4))
        check_fields(self, as_floats, "target", shape=(n,))
        set_fields(self, contacts=self.contacts.astype(int))
        if not (np.linalg.norm(self.link_quaternion, axis=-1) > 0.5).all():
            raise InputError("link_quaternion must hold unit quaternions")
        if self.channels.keys() != self.channel_units.keys():
            raise InputError("channels and channel_units must have the same names")
        channels = {name: as_floats(name, v, (k, *np.shape(v)[1:])) for name, v in self.channels.items()}
        set_fields(self, channels=channels)
        if self.reference_rate is not None:
            check_fields(self, as_positive, "reference_rate")
        if self.motion is not None and not np.array_equal(self.q_ref[: len(self.motion.q)], self.motion.q[:k]):
            raise InputError("the motion is another one than the rollout followed")

    def __repr__(self) -> str:
        touching = int(np.count_nonzero(self.contacts))
        return (
            f"<Rollout of {self.arm.name} by {self.controller}: {len(self.t)} samples in {self.t[-1]:g} s, "
            f"{self.q.shape[1]} joints, {self.link_position.shape[1]} links, contact in {touching} samples>"
        )

    @property
    def timestep(self) -> float:
        """Simulation step [s]."""
        return float(self.t[1] - self.t[0])

    @property
    def hold(self) -> float:
        """Time simulated after the motion [s]."""
        return float(self.t[-1] - self.motion_end)

    @property
    def tracking_error(self) -> Floats:
        """``(K, n)`` how far the coordinates are from their reference [rad, m]."""
        return np.asarray(self.q - self.q_ref)

    @cached_property
    def slack(self) -> float:
        """By how much parts may have come nearer to each other that other joints than the arm's have moved [m]."""
        return 2.0 * displaced(self.arm, self.q, self.qpos)

    @cached_property
    def tracked(self) -> tuple[Floats, Floats, Floats, Floats] | None:
        """Times, planned joints and rates, and how far the joints were from these, for proofs about the run.

        None without a plan, or if anything but the arm and what it carries was moved, which the plan does not know.
        """
        if self.motion is None or self.disturbances.obstacles or not self.slack < MOVED:
            return None
        planned = np.minimum(np.arange(len(self.t)), len(self.motion.t) - 1)
        q = self.motion.q[planned]
        return self.t, q, self.motion.qd[planned], np.abs(self.q - q)

    @cached_property
    def clearance(self) -> Clearance | None:
        """The proved clearance of the run at every instant: that of its plan, less what errors and `slack` take."""
        return self.tracked and proved_clearance(self.arm, *self.tracked, slack=self.slack, others=True)

    @cached_property
    def outside(self) -> str:
        """When and by which joint it left the proof of its plan's clearance; empty if it did not, or has no proof."""
        if self.motion is None or self.disturbances.obstacles or (self.clearance and self.clearance.proved):
            return ""
        monitor = ClearanceMonitor(self.arm, self.motion.t, self.motion.q, self.motion.qd)
        lefts = map(monitor.left, range(len(self.t)), self.q, self.qpos) if monitor.clearance.proved else ()
        return next(filter(None, lefts), "")

    def step_at(self, time: float) -> str:
        """Name of the step of a sequence that was being done at a time [s]; empty for a single motion."""
        return next((name for begin, name in reversed(self.steps) if begin <= time + 1e-9), "")

    def poses(self, name: str) -> RigidTransform:
        """Poses of shape ``(K,)`` of any body or site of the arm's model in the world; `InputError` lists the names."""
        model, frame = self.arm.model, BodyFrames.of([find_frame(self.arm.model, name)])
        # In turn, since the poses of all bodies of a large model do not fit into memory.
        each = [frame.poses(data.xpos, data.xmat) for data in kinematics_each(model, self.qpos)]
        places, turns = map(np.concatenate, zip(*each, strict=True))
        return transforms(turns, places)

    def link_poses(self) -> RigidTransform:
        """Simulated link frames as poses of shape ``(K, N)``."""
        rotation = Rotation.from_quat(self.link_quaternion, scalar_first=True)
        return RigidTransform.from_components(self.link_position, rotation)

    def save(self, path: StrPath) -> None:
        """Write to an ``.npz`` file, atomically."""
        meta = {
            "arm": self.arm.name,
            "scene": self.arm.scene,
            "model": self.arm.fingerprint,
            "motion_end": self.motion_end,
            "controller": self.controller,
            "reference_rate": self.reference_rate,
            "disturbances": asdict(self.disturbances),
            "payload": self.arm.payload,
            "channel_units": dict(self.channel_units),
            "steps": [list(step) for step in self.steps],
            "mujoco": mujoco.__version__,
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        arrays |= {_CHANNEL + name: values for name, values in self.channels.items()}
        io.save_arrays(path, "rollout", arrays, meta)

    @classmethod
    def load(cls, path: StrPath, arm: Arm, motion: Motion | None = None) -> Rollout:
        """Read a file that `save` wrote.

        Args:
            path: path of the file.
            arm: the simulated arm in its scene, with or without its payload; of a view, its mocap bodies in place.
            motion: the plan that was followed, which the file does not hold.

        Raises:
            FileError: it is no such file, or belongs to another arm, scene or motion.
        """
        arrays, meta = io.load_arrays(path, "rollout")
        if arm.payload == 0.0 and isinstance(mass := meta.get("payload"), float):
            arm = arm.with_payload(max(mass, 0.0))
        if meta.get("model") != arm.fingerprint:
            raise FileError(
                f"{path} is of arm {meta.get('arm')!r} in scene {meta.get('scene')!r} (fingerprint "
                f"{io.short(meta.get('model'))}), not of {arm.name!r} in scene {arm.scene!r} "
                f"({io.short(arm.fingerprint)}); load it with its own arm, or simulate it again"
            )
        values = dict(zip(_ARRAYS, io.take(arrays, path, *_ARRAYS), strict=True))
        try:
            units = dict(meta["channel_units"])
            channels = dict(zip(units, io.take(arrays, path, *(_CHANNEL + name for name in units)), strict=True))
            rate = meta["reference_rate"]
            return cls(
                arm=arm,
                motion=motion,
                motion_end=float(meta["motion_end"]),
                # The name may be of a user's controller: nothing is run because of it.
                controller=f"{meta['controller']:s}",
                reference_rate=None if rate is None else float(rate),
                disturbances=Disturbances.from_json(meta["disturbances"]),
                channels=channels,
                channel_units=units,
                steps=tuple((float(begin), str(name)) for begin, name in meta["steps"]),
                **values,
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise FileError(f"{path} is not a valid rollout: {error}") from None
