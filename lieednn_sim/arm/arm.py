"""A serial arm of compound joints, read from MJCF: frames, limits, forward map, encoding and retraction."""

from __future__ import annotations

import copy
import itertools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.joints import CompoundJoints, Retraction
from lieednn_sim.arm.models import scene_path
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.validation import as_floats

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm whose consecutive sites ``link<i>_frame`` are each moved by one revolute and one prismatic joint.

    Link frame i is link frame i-1 times a fixed mount, T_i(q) and a fixed tip; frame 0 is the site ``base_frame``.

    Attributes:
        name: name of the model.
        source: the scene file.
        model: the compiled scene.
        joint_names: names in qpos order.
        joints: the compound joints.
        mounts: fixed poses, shape ``(N,)``, from link frame i-1 to joint frame i.
        tips: fixed poses, shape ``(N,)``, from joint frame i to link frame i at the reference position.
        position_limits: ``(2N, 2)`` [rad, m].
        velocity_limits: ``(2N,)`` [rad/s, m/s].
        force_limits: ``(2N,)`` [N m, N].
        acceleration_limits: ``(2N,)`` [rad/s^2, m/s^2]; infinite where the model names none.
        spec: what `model` was compiled from, for whoever adds bodies to a copy of it.
        length_scale: metres per unit of v in the network's coordinates, since the activation sees bare numbers.
        site_ids: ``(N,)`` the link frames' sites.
    """

    name: str
    source: Path
    model: mujoco.MjModel
    joint_names: tuple[str, ...]
    joints: CompoundJoints
    base: RigidTransform
    mounts: RigidTransform
    tips: RigidTransform
    position_limits: Floats
    velocity_limits: Floats
    force_limits: Floats
    acceleration_limits: Floats
    length_scale: float
    site_ids: NDArray[np.int_]
    spec: Any

    @classmethod
    def load(cls, name: str) -> Arm:
        """Load an arm of the package; `InputError` lists the known names."""
        return cls.from_xml(scene_path(name), name)

    @classmethod
    def from_xml(cls, path: str | os.PathLike[str], name: str | None = None) -> Arm:
        """Load a scene file that holds one arm with the conventions of this class."""
        source = Path(path)
        if not source.is_file():
            raise FileError(f"no such file: {source}")
        try:
            spec = mujoco.MjSpec.from_file(str(source))
            model = spec.compile()
        except ValueError as error:
            raise FileError(f"MuJoCo cannot compile {source}: {error}") from None
        return _read(model, spec, source, name or source.parent.name)

    @property
    def n_links(self) -> int:
        """N."""
        return len(self.site_ids)

    @property
    def n_joints(self) -> int:
        """2N."""
        return len(self.joint_names)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links for tables and plots; the last one is the end effector."""
        return (*(f"link {i}" for i in range(1, self.n_links)), "end effector")

    def limit_excess(self, q: Floats) -> Floats:
        """How far each of the positions ``(..., 2N)`` is outside its limits; negative inside."""
        low, high = self.position_limits.T
        return np.maximum(low - q, q - high)

    def keyframe(self, name: str) -> Floats:
        """Joint positions ``(2N,)`` of a keyframe."""
        key = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, name)
        if key < 0:
            known = [self.model.key(k).name for k in range(self.model.nkey)]
            raise InputError(f"no keyframe {name!r}; keyframes of {self.name}: {', '.join(known)}")
        return np.array(self.model.key_qpos[key])

    def check_position(self, q: ArrayLike, what: str = "q") -> Floats:
        """Return ``q`` ``(2N,)`` when it keeps the limits; else `InputError` names the joint, value and range."""
        position = as_floats(what, q, (self.n_joints,))
        outside = self.limit_excess(position)
        worst = int(outside.argmax())
        if outside[worst] > 0.0:
            low, high = self.position_limits[worst]
            raise InputError(
                f"{what} is out of reach: joint {self.joint_names[worst]!r} would be at {position[worst]:.4g} "
                f"{self.unit(worst)}, its range is [{low:.4g}, {high:.4g}]"
            )
        return position

    def qpos(self, q: ArrayLike) -> Floats:
        """MuJoCo's generalised positions ``(..., nq)`` at joint coordinates ``(..., 2N)``."""
        return as_floats("q", q, (self.n_joints,), batched=True)

    def qvel(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """MuJoCo's generalised velocities ``(..., nv)`` at joint coordinates and their rates, both ``(..., 2N)``."""
        return as_floats("qd", qd, (self.n_joints,), batched=True)

    def coordinates(self, qpos: ArrayLike) -> Floats:
        """Joint coordinates ``(..., 2N)`` of MuJoCo's generalised positions ``(..., nq)``."""
        return as_floats("qpos", qpos, (self.model.nq,), batched=True)

    def contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that touch each other at ``q`` ``(2N,)``."""
        data = mujoco.MjData(self.model)
        data.qpos[:] = as_floats("q", q, (self.n_joints,))
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_collision(self.model, data)
        bodies = self.model.geom_bodyid[data.contact.geom] if data.ncon else []
        return [(self.model.body(a).name, self.model.body(b).name) for a, b in bodies]

    def unit(self, joint: int) -> str:
        """``"rad"`` or ``"m"``."""
        return "rad" if joint in self.joints.revolute else "m"

    def joint_poses(self, q: ArrayLike) -> RigidTransform:
        """Per-joint poses T_i(q), ``(..., 2N)`` to shape ``(..., N)``."""
        return self.joints.poses(as_floats("q", q, (self.n_joints,), batched=True))

    def link_poses(self, q: ArrayLike) -> RigidTransform:
        """World poses of the link frames, ``(..., 2N)`` to shape ``(..., N)``; the last is the end effector."""
        return self.compose(self.joint_poses(q))

    def compose(self, joint_poses: RigidTransform) -> RigidTransform:
        """World poses of the link frames from per-joint poses of shape ``(..., N)``, feasible or not."""
        moved = self.mounts.as_matrix() @ joint_poses.as_matrix() @ self.tips.as_matrix()
        frame, frames = self.base.as_matrix(), []
        for i in range(self.n_links):
            frame = frame @ moved[..., i, :, :]
            frames.append(frame)
        return RigidTransform.from_matrix(np.stack(frames, axis=-3))

    def encode(self, q: ArrayLike) -> Floats:
        """Network coordinates (omega, v / length_scale) of Log T_i(q), ``(..., 2N)`` to ``(..., N, 6)``."""
        xi = self.joints.encode(as_floats("q", q, (self.n_joints,), batched=True))
        return xi / self._units

    def decode(self, xi: ArrayLike, xi_dot: ArrayLike | None = None) -> Retraction:
        """Nearest joint positions to network coordinates ``(..., N, 6)``, with rates along ``xi_dot`` and the gap."""
        shape = (self.n_links, 6)
        twist = as_floats("xi", xi, shape, batched=True) * self._units
        rate = None if xi_dot is None else as_floats("xi_dot", xi_dot, shape, batched=True) * self._units
        return self.joints.retract(twist, rate)

    def physics(self) -> Any:
        """A `dm_control.mujoco.Physics` of the scene at the keyframe ``home``, for tasks and viewers of dm_control."""
        from dm_control import mujoco as dm_mujoco

        physics = dm_mujoco.Physics.from_model(dm_mujoco.wrapper.MjModel(copy.deepcopy(self.model)))
        with physics.reset_context():
            physics.data.qpos[:] = self.keyframe("home")
            physics.data.ctrl[:] = self.keyframe("home")
        return physics

    @property
    def _units(self) -> Floats:
        return np.repeat([1.0, self.length_scale], 3)


def _read(model: mujoco.MjModel, spec: Any, source: Path, name: str) -> Arm:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    sites = [_site(model, name, "base_frame")]
    while (found := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"link{len(sites)}_frame")) >= 0:
        sites.append(found)
    if len(sites) == 1:
        raise InputError(f"arm {name!r} has no sites link1_frame, link2_frame, ... at its link frames")

    axes, directions, first, revolute, prismatic, mounts, tips = [], [], [], [], [], [], []
    for i, (parent, child) in enumerate(itertools.pairwise(sites), start=1):
        group = _joints_between(model, model.site_bodyid[parent], model.site_bodyid[child], name, i)
        kinds = [mujoco.mjtJoint(model.jnt_type[j]).name.removeprefix("mjJNT_").lower() for j in group]
        if sorted(kinds) != ["hinge", "slide"]:
            raise InputError(
                f"link {i} of arm {name!r} must be moved by one hinge and one slide joint, "
                f"got: {', '.join(kinds) or 'none'}"
            )
        first.append(kinds[0] == "hinge")
        hinge, slide = group if first[-1] else group[::-1]
        _check_joint(model, name, hinge, reach=np.pi)
        _check_joint(model, name, slide, reach=np.inf)
        # The joint frame sits on the revolute axis and takes the axes of the first moving body.
        orientation = Rotation.from_matrix(data.xmat[model.jnt_bodyid[group[0]]].reshape(3, 3))
        frame = RigidTransform.from_components(data.xanchor[hinge], orientation)
        axes.append(orientation.inv().apply(data.xaxis[hinge]))
        directions.append(orientation.inv().apply(data.xaxis[slide]))
        revolute.append(model.jnt_qposadr[hinge])
        prismatic.append(model.jnt_qposadr[slide])
        mounts.append((_site_pose(data, parent).inv() * frame).as_matrix())
        tips.append((frame.inv() * _site_pose(data, child)).as_matrix())
    n_joints = 2 * len(axes)
    if model.nq != n_joints or model.nu != n_joints:
        raise InputError(
            f"arm {name!r} has {model.nq} coordinates and {model.nu} actuators, expected {n_joints} of each"
        )
    joint_ids = np.argsort(model.jnt_qposadr)
    return Arm(
        name=name,
        source=source,
        model=model,
        joint_names=tuple(model.joint(j).name for j in joint_ids),
        joints=CompoundJoints(
            axis=np.array(axes),
            direction=np.array(directions),
            revolute_first=np.array(first),
            revolute=np.array(revolute, dtype=int),
            prismatic=np.array(prismatic, dtype=int),
            reference=model.qpos0.copy(),
        ),
        base=_site_pose(data, sites[0]),
        mounts=RigidTransform.from_matrix(np.array(mounts)),
        tips=RigidTransform.from_matrix(np.array(tips)),
        position_limits=model.jnt_range[joint_ids].copy(),
        velocity_limits=_numeric(model, "velocity_limit", np.full(n_joints, np.inf)),
        force_limits=_force_limits(model, joint_ids),
        acceleration_limits=_numeric(model, "acceleration_limit", np.full(n_joints, np.inf)),
        length_scale=float(_numeric(model, "length_scale", np.ones(1))[0]),
        site_ids=np.array(sites[1:], dtype=int),
        spec=spec,
    )


def _site(model: mujoco.MjModel, arm: str, site: str) -> int:
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
    if found < 0:
        raise InputError(f"arm {arm!r} has no site {site!r}")
    return found


def _site_pose(data: mujoco.MjData, site: int) -> RigidTransform:
    return RigidTransform.from_components(
        data.site_xpos[site], Rotation.from_matrix(data.site_xmat[site].reshape(3, 3))
    )


def _check_joint(model: mujoco.MjModel, arm: str, joint: int, reach: float) -> None:
    """Refuse joints that the encoding or the servo would get silently wrong."""
    label = f"joint {model.joint(joint).name!r} of arm {arm!r}"
    if not model.jnt_limited[joint]:
        raise InputError(f"{label} has no position limits; give it a range")
    span = np.abs(model.jnt_range[joint] - model.qpos0[model.jnt_qposadr[joint]]).max()
    if span >= reach:
        raise InputError(f"{label} may turn by {span:.3g} rad from its reference; the logarithm needs less than pi")
    drives = np.flatnonzero(model.actuator_trnid[:, 0] == joint)
    if len(drives) != 1 or model.actuator_gear[drives[0], 0] != 1.0:
        raise InputError(f"{label} needs exactly one actuator, of gear 1")


def _joints_between(model: mujoco.MjModel, ancestor: int, body: int, arm: str, link: int) -> list[int]:
    """Joints that move ``body`` relative to ``ancestor``, from the base outwards."""
    group: list[int] = []
    while body != ancestor:
        if body == 0:
            raise InputError(f"link {link} of arm {arm!r} does not descend from link {link - 1}")
        start, count = model.body_jntadr[body], model.body_jntnum[body]
        group = [*range(start, start + count), *group]
        body = model.body_parentid[body]
    return group


def _numeric(model: mujoco.MjModel, field: str, default: Floats) -> Floats:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, field)
    return default if index < 0 else np.array(model.numeric(index).data)


def _force_limits(model: mujoco.MjModel, joint_ids: NDArray[np.int_]) -> Floats:
    limits = np.full(model.nq, np.inf)
    for joint in joint_ids:
        for actuator in np.flatnonzero(model.actuator_trnid[:, 0] == joint):
            if model.actuator_forcelimited[actuator]:
                limits[model.jnt_qposadr[joint]] = np.abs(model.actuator_forcerange[actuator]).max()
    return limits
