"""A serial arm of compound joints: coordinates and limits, forward map, encoding and retraction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import kinematics_at, mujoco, scratch_data
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.arm.frames import BodyFrames
from lieednn_sim.arm.kinematics import CompoundJoints
from lieednn_sim.arm.projection import Retraction, Retractor
from lieednn_sim.errors import InputError
from lieednn_sim.lie.se3 import transforms
from lieednn_sim.validation import as_count, as_floats, quoted
from lieednn_sim.values import Floats, read_only, rounded

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

#: A position that is beyond a limit by at most this [rad, m] was rounded, to 32 bits or in print, and is moved to it.
ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class SerialArm:
    """The coordinates, limits and kinematics of an arm: a chain of links that compound joints move.

    Link frame i is link frame i-1 times a fixed mount, T_i(q) and a fixed tip; frame 0 is that of the base. q in R^n
    holds one coordinate for a hinge or slide and three, its rotation vector, for a ball joint; coupled stages of a
    telescope share one.

    Attributes:
        name: name of the model.
        source: the file it was read from.
        spec: the spec that `model` was compiled from; copy it to add bodies. A view of a compiled model has none.
        model: the compiled model.
        space: the joint coordinates, and their conversion to MuJoCo's.
        joints: the compound joints.
        base: the world pose of frame 0.
        mounts: fixed poses, shape ``(N,)``, from link frame i-1 to joint frame i.
        tips: fixed poses, shape ``(N,)``, from joint frame i to link frame i at the reference position.
        position_limits: ``(n, 2)`` [rad, m].
        velocity_limits: ``(n,)`` [rad/s, m/s]; these and the next three are infinite where the model gives none.
        acceleration_limits: ``(n,)`` [rad/s^2, m/s^2].
        jerk_limits: ``(n,)`` [rad/s^3, m/s^3].
        force_limits: ``(n,)`` [N m, N].
        length_scale: metres per unit of v in the network's coordinates, since the activation takes pure numbers.
        frames: the N link frames, fixed to bodies of the model.
        qpos_home: for a view, the positions ``(nq,)`` of its model in the state that it was made from: its ``home``.
    """

    name: str
    source: Path
    spec: Any
    model: mujoco.MjModel
    space: Coordinates
    joints: CompoundJoints
    base: RigidTransform
    mounts: RigidTransform
    tips: RigidTransform
    position_limits: Floats
    velocity_limits: Floats
    acceleration_limits: Floats
    jerk_limits: Floats
    force_limits: Floats
    length_scale: float
    frames: BodyFrames
    qpos_home: Floats | None = None

    @property
    def n_links(self) -> int:
        """Number N of links."""
        return len(self.frames)

    @property
    def n_joints(self) -> int:
        """Number n of joint coordinates."""
        return len(self.space)

    @property
    def timestep(self) -> float:
        """Time step of the model, the sampling period of every planned motion [s]."""
        return float(self.model.opt.timestep)

    @property
    def ranges(self) -> Floats:
        """Widths ``(n,)`` of the position limits [rad, m]."""
        low, high = self.position_limits.T
        return np.asarray(high - low)

    @property
    def reach(self) -> float:
        """About the largest distance of link frames from the base [m]: lengths between frames plus travel of slides."""
        lengths = np.linalg.norm([self.mounts.translation, self.tips.translation], axis=-1)
        slides = np.array([unit == "m" for unit in self.space.units])
        return float(lengths.sum() + np.abs(self.position_limits[slides]).max(axis=1).sum())

    @property
    def jump_speeds(self) -> Floats:
        """Speeds ``(n,)`` beyond which targets jump: the velocity limits, or 10 rad/s or m/s without one."""
        return np.where(np.isfinite(self.velocity_limits), self.velocity_limits, 10.0)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint coordinates; a ball joint's three end in ``_x``, ``_y``, ``_z``."""
        return self.space.names

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links for tables and plots; the last one is the end effector."""
        return (*(f"link {i}" for i in range(1, self.n_links)), "end effector")

    def keyframe(self, name: str) -> Floats:
        """Joint coordinates ``(n,)`` of a keyframe; ``home`` of a view is the state that it was made from."""
        if name == "home" and self.qpos_home is not None:
            return self.coordinates(self.qpos_home)
        key = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, name)
        if key < 0:
            raise InputError(f"no keyframe {quoted(name)}; keyframes of {self.name}: {', '.join(self.keyframes)}")
        return self.coordinates(self.model.key_qpos[key])

    @property
    def keyframes(self) -> tuple[str, ...]:
        """Names of the keyframes; a view always has ``home``, its state."""
        names = tuple(self.model.key(k).name for k in range(self.model.nkey))
        return names if self.qpos_home is None or "home" in names else ("home", *names)

    def configuration(self, q: ArrayLike | str, what: str = "q") -> Floats:
        """Joint coordinates ``(n,)``: the given ones, or those of a keyframe that is given by its name."""
        return self.keyframe(q) if isinstance(q, str) else as_floats(what, q, (self.n_joints,))

    def limit_excess(self, q: Floats) -> Floats:
        """How far each coordinate ``(..., n)`` is outside its limits, negative inside; for a ball joint, its angle."""
        q = as_floats("q", q, (self.n_joints,), batched=True)
        low, high = self.position_limits.T
        excess = np.maximum(low - q, q - high)
        balls = self.space.balls
        if len(balls):
            excess[..., balls] = self.space.angles(q)[..., None] - high[balls]
        return excess

    def within_angles(self, q: Floats) -> Floats:
        """Coordinates ``(..., n)`` with the rotation vectors of ball joints clipped to their largest angles."""
        q = as_floats("q", q, (self.n_joints,), batched=True)
        high, inside, balls = self.position_limits[:, 1], q.copy(), self.space.balls
        if len(balls):
            angle = self.space.angles(q)[..., None]
            if (beyond := angle > high[balls]).any():
                # Clipped to a little less, so that rounding does not lead beyond the limit.
                inside[..., balls] *= np.where(beyond, (1.0 - 1e-15) * high[balls] / (angle + 1e-300), 1.0)
        return inside

    def check_position(self, q: ArrayLike | str, what: str = "q") -> Floats:
        """The `configuration` of ``q``, moved to limits that it exceeds by up to `ROUNDING`; further, `InputError`."""
        position = self.configuration(q, what)
        outside = self.limit_excess(position)
        if 0.0 < outside.max() <= ROUNDING:
            position = self.within_angles(np.clip(position, *self.position_limits.T))
            outside = self.limit_excess(position)
        worst = int(outside.argmax())
        if outside[worst] > 0.0:
            raise InputError(f"{what} is out of reach: {self.describe_excess(position, worst)}")
        return position

    def describe_excess(self, q: Floats, joint: int) -> str:
        """The message that a coordinate of q ``(n,)`` is outside its limits; for a ball joint, that its angle is."""
        joint = as_count("joint", joint, 0, self.n_joints - 1)
        q = as_floats("q", q, (self.n_joints,))
        low, high = self.position_limits[joint]
        value, name = q[joint], self.joint_names[joint]
        if joint in self.space.balls:
            value, low, name = high + SerialArm.limit_excess(self, q)[joint], 0.0, name[:-2]
        turns = f" ({np.rad2deg(value):.0f} degrees)" if self.unit(joint) == "rad" and abs(value) > 4.0 * np.pi else ""
        digits = 4 if f"{value:.4g}" not in (f"{low:.4g}", f"{high:.4g}") else 8  # so that it is seen to be beyond
        where, limits = f"{value:.{digits}g} {self.unit(joint)}{turns}", f"[{low:.{digits}g}, {high:.{digits}g}]"
        return f"joint {name!r} would be at {where}, its range is {limits}"

    def unit(self, joint: int) -> str:
        """``"rad"`` or ``"m"``."""
        return self.space.units[as_count("joint", joint, 0, self.n_joints - 1)]

    def amount(self, joint: int, value: float) -> str:
        """The size of a change of a coordinate [rad, m], in words."""
        metres = self.unit(joint) == "m"
        return f"{rounded(abs(1e3 * value if metres else np.rad2deg(value)))} {'mm' if metres else 'degrees'}"

    def coordinates(self, qpos: ArrayLike) -> Floats:
        """Joint coordinates ``(..., n)`` of MuJoCo's generalised positions ``(..., nq)``."""
        return self.space.from_qpos(as_floats("qpos", qpos, (self.model.nq,), batched=True))

    def qvel(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """MuJoCo's generalised velocities ``(..., nv)`` at joint coordinates and their rates, both ``(..., n)``."""
        shape = (self.n_joints,)
        return self.space.to_qvel(as_floats("q", q, shape, batched=True), as_floats("qd", qd, shape, batched=True))

    def rates(self, q: ArrayLike, qvel: ArrayLike) -> Floats:
        """Rates ``(..., n)`` of the joint coordinates at q for MuJoCo's generalised velocities ``(..., nv)``."""
        position = as_floats("q", q, (self.n_joints,), batched=True)
        return self.space.from_qvel(position, as_floats("qvel", qvel, (self.model.nv,), batched=True))

    def joint_poses(self, q: ArrayLike) -> RigidTransform:
        """Per-joint poses T_i(q), ``(..., n)`` to shape ``(..., N)``."""
        return self.joints.poses(as_floats("q", q, (self.n_joints,), batched=True))

    def link_poses(self, q: ArrayLike) -> RigidTransform:
        """World poses of the link frames, ``(..., n)`` to shape ``(..., N)``; the last is the end effector."""
        return self.compose(self.joint_poses(q))

    def compose(self, joint_poses: RigidTransform) -> RigidTransform:
        """World poses of the link frames from per-joint poses ``(..., N)``, which need not be feasible."""
        moved = self.mounts.as_matrix() @ joint_poses.as_matrix() @ self.tips.as_matrix()
        frame, frames = self.base.as_matrix(), []
        for i in range(self.n_links):
            frame = frame @ moved[..., i, :, :]
            frames.append(frame)
        stacked = np.stack(frames, axis=-3)
        return transforms(stacked[..., :3, :3], stacked[..., :3, 3])

    def tip(self, q: ArrayLike) -> Floats:
        """Positions of the end effector in the world, ``(..., n)`` to ``(..., 3)`` [m]: those of the last link frame.

        They take a quarter of the time of `link_poses`.
        """
        base = self.base.as_matrix()
        return np.asarray(self.tip_in_frames(q)[..., 0, :] @ base[:3, :3].T + base[:3, 3])

    def tip_in_frames(self, q: ArrayLike) -> Floats:
        """Positions of the end effector in the base frame and in all link frames but the last, ``(..., N, 3)`` [m]."""
        q = as_floats("q", q, (self.n_joints,), batched=True)
        offset, places = (q - self.joints.reference).reshape(-1, self.n_joints), []
        mounts, tips = self.mounts.as_matrix(), self.tips.as_matrix()
        point = np.zeros((len(offset), 3))
        for mount, joint, tip in zip(mounts[::-1], self.joints.joints[::-1], tips[::-1], strict=True):
            point = point @ tip[:3, :3].T + tip[:3, 3]
            for factor in joint.factors[::-1]:
                point = factor.move(point, offset)
            point = point @ mount[:3, :3].T + mount[:3, 3]
            places.append(point)
        return np.stack(places[::-1], axis=1).reshape(*q.shape[:-1], self.n_links, 3)

    def jacobian(self, q: ArrayLike, link: int = -1) -> Floats:
        """The geometric Jacobian J of a link frame, ``(..., n)`` to ``(..., 6, n)``: its twist is J(q) qd.

        The twist is (omega, v): the angular velocity [rad/s] and the velocity of the frame's origin [m/s], both along
        the axes of the world (Lynch and Park's spatial twist has the velocity at the world's origin, v - omega x p). A
        column is the twist per unit rate of its coordinate; for a ball joint, that of its rotation vector.

        Args:
            q: joint coordinates ``(..., n)`` [rad, m].
            link: index of the link frame, from 0; -1, the last, is the end effector.

        Raises:
            InputError: a value is malformed, or there is no such link.
        """
        last = as_count("link", link, -self.n_links, self.n_links - 1) % self.n_links
        q = as_floats("q", q, (self.n_joints,), batched=True)
        flat, data = q.reshape(-1, self.n_joints), scratch_data(self.model)
        twists = np.empty((len(flat), 6, self.model.nv))
        for twist, row in zip(twists, self.space.to_qpos(flat), strict=True):
            mujoco.mj_comPos(self.model, kinematics_at(self.model, row, data))
            twist.reshape(2, 3, -1)[::-1] = self.frames.jacobian(self.model, data, last)
        rates = self.space.to_qvel(flat[:, None], np.eye(self.n_joints))
        return (twists @ np.swapaxes(rates, -1, -2)).reshape(*q.shape[:-1], 6, self.n_joints)

    def encode(self, q: ArrayLike) -> Floats:
        """Network coordinates (omega, v / length_scale) of T_i(q), ``(..., n)`` to ``(..., N, 6)``.

        They are Log T_i(q) or, for a link that moves along one screw, such as behind a single hinge, the screw times
        its coordinate, however far it turns.
        """
        return self.joints.twists(as_floats("q", q, (self.n_joints,), batched=True)) / self.twist_units

    def decode(self, xi: ArrayLike, xi_dot: ArrayLike | None = None, start: ArrayLike | None = None) -> Retraction:
        """Nearest joint positions to network coordinates ``(..., N, 6)``, their rates along ``xi_dot``, and the gap.

        With a joint position ``start`` ``(n,)``, coordinates ``(K, ..., N, 6)`` are followed along their first axis: of
        several equally near configurations, the one that continues the path is taken. With guesses ``(K, ..., n)`` it
        is the one next to its guess, which takes less time.
        """
        shape = (self.n_links, 6)
        twist = as_floats("xi", xi, shape, batched=True) * self.twist_units
        rate = None if xi_dot is None else as_floats("xi_dot", xi_dot, shape, batched=True) * self.twist_units
        if start is None:
            return self.retractor(twist, rate)
        begin = as_floats("start", start, (self.n_joints,), batched=True)
        if begin.ndim > 1:
            begin = as_floats("start", begin, (*twist.shape[:-2], self.n_joints))
        return self.retractor(twist, rate, begin)

    @cached_property
    def twist_units(self) -> Floats:
        """``(6,)`` the units of the network's coordinates (omega, v) [rad, m]."""
        return read_only(np.repeat([1.0, self.length_scale], 3))

    @cached_property
    def retractor(self) -> Retractor:
        """The projection of the links' poses onto the joints, by which `decode` works."""
        return Retractor(self.joints, self.length_scale)
