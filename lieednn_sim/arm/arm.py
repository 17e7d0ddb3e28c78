"""A serial arm of compound joints, read from MJCF: frames, limits, forward map, encoding and retraction."""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder
from lieednn_sim.arm.coordinates import Coordinates
from lieednn_sim.arm.fingerprint import arm_fingerprint
from lieednn_sim.arm.importer import ImportOptions, ImportReport
from lieednn_sim.arm.kinematics import CompoundJoints
from lieednn_sim.arm.models import find_model, label_of, open_model
from lieednn_sim.arm.obstacles import add_own_obstacles, check_home, is_scene_file, load_obstacles, scene_label
from lieednn_sim.arm.parsing import read_arm
from lieednn_sim.arm.projection import Retraction, Retractor
from lieednn_sim.arm.scenes import SCENES, add_obstacles
from lieednn_sim.arm.visuals import discard_visuals, moves_alike
from lieednn_sim.errors import FileError, InputError, LieEDNNError
from lieednn_sim.lie import poses
from lieednn_sim.validation import as_choice, as_floats, as_path, as_seed
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm whose consecutive sites ``link<i>_frame`` are each moved by the compound joint between them.

    Link frame i is link frame i-1 times a fixed mount, T_i(q) and a fixed tip; frame 0 is the site ``base_frame``.
    q in R^n holds one coordinate for a hinge or slide and three, its rotation vector, for a ball joint; coupled stages
    of a telescope share one.

    Attributes:
        name: name of the model.
        source: the scene file.
        spec: the spec that `model` was compiled from; copy it to add bodies.
        model: the compiled scene.
        space: the joint coordinates, and their conversion to MuJoCo's.
        joints: the compound joints.
        mounts: fixed poses, shape ``(N,)``, from link frame i-1 to joint frame i.
        tips: fixed poses, shape ``(N,)``, from joint frame i to link frame i at the reference position.
        position_limits: ``(n, 2)`` [rad, m].
        velocity_limits: ``(n,)`` [rad/s, m/s]; infinite, as are the next three, where the model gives none.
        acceleration_limits: ``(n,)`` [rad/s^2, m/s^2].
        jerk_limits: ``(n,)`` [rad/s^3, m/s^3].
        force_limits: ``(n,)`` [N m, N].
        length_scale: metres per unit of v in the network's coordinates, since the activation takes pure numbers.
        site_ids: ``(N,)`` ids of the link frames' sites.
        scene: name of the obstacles around it: one of `scenes.SCENES`, or the stem of their file.
        scene_seed: seed of the obstacles' positions.
        import_report: what the importer did, for a file without the package's conventions; otherwise None.
        clearance: distance that planned motions keep from contact, start and target included [m]; change it with
            `dataclasses.replace`.
    """

    name: str
    source: Path
    spec: mujoco.MjSpec
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
    site_ids: NDArray[np.int_]
    scene: str = "free"
    scene_seed: int = 0
    import_report: ImportReport | None = None
    clearance: float = PLANNED_CLEARANCE

    @classmethod
    def load(
        cls,
        name: str | os.PathLike[str],
        scene: str | os.PathLike[str] = "free",
        seed: int = 0,
        **options: Unpack[ImportOptions],
    ) -> Arm:
        """Load an arm, with the obstacles of a scene.

        Args:
            name: an arm of the package; or an MJCF or URDF file (see `from_xml`), optionally followed by its links as
                in ``robot.urdf:wrist,tool``; or a YAML or JSON file that describes the import (`models.find_model`).
            scene: a name of `scenes.SCENES`, or a file of obstacles (see `among`).
            seed: seed of the obstacles' positions.
            options: import options for such a file (see `from_xml`).

        Raises:
            FileError: there is no such file, or MuJoCo cannot compile it.
            InputError: an unknown arm or scene, or the file holds no arm.
        """
        found = find_model(name, options)
        return cls.from_xml(found.path, found.name, **found.options).among(scene, seed)

    @classmethod
    def from_xml(
        cls,
        path: str | os.PathLike[str],
        name: str | None = None,
        **options: Unpack[ImportOptions],
    ) -> Arm:
        """Load an MJCF or URDF file that holds one arm.

        A file with the sites ``base_frame`` and ``link1_frame``, ``link2_frame``, ... is taken as it is. Any other is
        imported (`importer.import_arm`): cut into compound joints, given servos where it has none, other joints locked.

        Args:
            path: the file.
            name: the arm's name; by default the file's stem, or its folder's name when the file is ``scene.xml``.
            options: the options of `importer.import_arm`; naming any of them imports the file.

        Raises:
            FileError: there is no such file, or MuJoCo cannot compile it.
            InputError: it holds no such arm.
        """
        source = as_path("path", path)
        spec, import_report = open_model(source, **options)
        return cls.from_spec(spec, source, name or label_of(source), import_report)

    @classmethod
    def from_spec(cls, spec: mujoco.MjSpec, source: Path, name: str, import_report: ImportReport | None = None) -> Arm:
        """Compile a spec in the conventions of this class, such as one from `import_arm`; raises as `from_xml`."""
        try:
            model = spec.compile()
        except ValueError as error:
            raise FileError(f"MuJoCo cannot compile {source}: {str(error).strip()}") from None
        return cls(
            name=name, source=source, spec=spec, model=model, import_report=import_report, **read_arm(model, name)
        )

    def among(self, scene: str | os.PathLike[str], seed: int = 0) -> Arm:
        """This arm with the obstacles of a scene; itself for the scene ``"free"``.

        Args:
            scene: a name of `scenes.SCENES`, or a file of obstacles with a suffix of `obstacles.SCENE_SUFFIXES` (see
                `obstacles.load_obstacles`), whose stem becomes the arm's `scene`.
            seed: seed of the obstacles' positions, where these are random.

        Raises:
            FileError: there is no such file, or it cannot be read.
            InputError: no such scene, a bad seed, the arm has obstacles already, there is no place for them around it,
                or a file's obstacles touch it at home.
        """
        as_seed("seed", seed)
        own = is_scene_file(scene)
        label = scene_label(scene) if own else as_choice("scene", scene, SCENES)  # type: ignore[arg-type]
        if label == "free":
            return self
        if self.scene != "free":
            raise InputError(f"arm {self.name!r} already has the obstacles of scene {self.scene!r}")
        if own:
            arm = self.amid(load_obstacles(scene), label)
            check_home(arm)
            return arm
        spec = self.spec.copy()
        add_obstacles(spec, self, label, seed)
        return replace(self._of(spec), scene=label, scene_seed=seed)

    def amid(self, obstacles: mujoco.MjSpec, label: str) -> Arm:
        """This arm with the obstacles of a spec (see `obstacles.shapes`); does not check that home is free of them.

        Args:
            obstacles: bodies without joints, in the world's frame.
            label: the new arm's `scene`.

        Raises:
            FileError: MuJoCo cannot compile them.
        """
        spec = self.spec.copy()
        add_own_obstacles(spec, self, obstacles, label)
        return replace(self._of(spec), scene=label)

    def _of(self, spec: mujoco.MjSpec) -> Arm:
        """This arm, compiled from an extended spec."""
        return replace(Arm.from_spec(spec, self.source, self.name, self.import_report), clearance=self.clearance)

    def __repr__(self) -> str:
        return f"<Arm {self.name}: {self.n_links} links, {self.n_joints} joints, scene {self.scene}>"

    @property
    def n_links(self) -> int:
        """N."""
        return len(self.site_ids)

    @property
    def n_joints(self) -> int:
        """n, the number of joint coordinates."""
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
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint coordinates; a ball joint's three end in ``_x``, ``_y``, ``_z``."""
        return self.space.names

    @property
    def exact(self) -> bool:
        """Whether every compound joint has six degrees of freedom, so that every network state is met without a gap."""
        return self._retractor.exact

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links for tables and plots; the last one is the end effector."""
        return (*(f"link {i}" for i in range(1, self.n_links)), "end effector")

    def limit_excess(self, q: Floats) -> Floats:
        """How far each coordinate ``(..., n)`` is outside its limits, negative inside; for a ball joint, its angle."""
        q = as_floats("q", q, (self.n_joints,), batched=True)
        low, high = self.position_limits.T
        excess = np.maximum(low - q, q - high)
        balls = self.space.balls
        if len(balls):
            excess[..., balls] = np.linalg.norm(q[..., balls], axis=-1, keepdims=True) - high[balls]
        return excess

    def within_angles(self, q: Floats) -> Floats:
        """Coordinates ``(..., n)`` with the rotation vectors of ball joints clipped to their largest angles."""
        q = as_floats("q", q, (self.n_joints,), batched=True)
        high, inside, balls = self.position_limits[:, 1], q.copy(), self.space.balls
        if len(balls):
            angle = np.linalg.norm(q[..., balls], axis=-1, keepdims=True)
            inside[..., balls] *= np.minimum(1.0, high[balls] / np.maximum(angle, 1e-300))
        return inside

    def check_reachable(self, q: ArrayLike, what: str = "q") -> Floats:
        """As `check_position`, and nothing may be closer than the arm's `clearance` at ``q``."""
        position = self.check_position(q, what)
        touching = self.near_contacts(position)
        if touching:
            raise InputError(f"{what} is out of reach: {touching[0][0]!r} would touch {touching[0][1]!r} there")
        return position

    def keyframe(self, name: str) -> Floats:
        """Joint coordinates ``(n,)`` of a keyframe."""
        key = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, name)
        if key < 0:
            known = [self.model.key(k).name for k in range(self.model.nkey)]
            raise InputError(f"no keyframe {name!r}; keyframes of {self.name}: {', '.join(known)}")
        return self.coordinates(self.model.key_qpos[key])

    def check_position(self, q: ArrayLike, what: str = "q") -> Floats:
        """Return ``q`` ``(n,)`` if it is within the limits; else raise `InputError` with the joint, value and range."""
        position = as_floats(what, q, (self.n_joints,))
        outside = self.limit_excess(position)
        worst = int(outside.argmax())
        if outside[worst] > 0.0:
            raise InputError(f"{what} is out of reach: {self.describe_excess(position, worst)}")
        return position

    def describe_excess(self, q: Floats, joint: int) -> str:
        """The message that a coordinate of q ``(n,)`` is outside its limits; for a ball joint, that its angle is."""
        low, high = self.position_limits[joint]
        value, name = q[joint], self.joint_names[joint]
        if joint in self.space.balls:
            value, low, name = high + self.limit_excess(q)[joint], 0.0, name[:-2]
        return f"joint {name!r} would be at {value:.4g} {self.unit(joint)}, its range is [{low:.4g}, {high:.4g}]"

    def qpos(self, q: ArrayLike) -> Floats:
        """MuJoCo's generalised positions ``(..., nq)`` at joint coordinates ``(..., n)``."""
        return self.space.to_qpos(as_floats("q", q, (self.n_joints,), batched=True))

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

    def contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that touch each other at ``q`` ``(n,)``."""
        return self._touching.bodies(self.space.to_qpos(as_floats("q", q, (self.n_joints,))))

    def near_contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that are closer than the arm's `clearance` to each other at ``q`` ``(n,)``."""
        return self._nearly_touching.bodies(self.space.to_qpos(as_floats("q", q, (self.n_joints,))))

    def near_contacts_along(self, q: Floats) -> Iterator[list[tuple[str, str]]]:
        """`near_contacts` at each of the postures ``(K, n)``, lazily; the conversion to qpos is done at once."""
        return map(self._nearly_touching.bodies, self.qpos(q))

    def unit(self, joint: int) -> str:
        """``"rad"`` or ``"m"``."""
        return self.space.units[joint]

    def joint_poses(self, q: ArrayLike) -> RigidTransform:
        """Per-joint poses T_i(q), ``(..., n)`` to shape ``(..., N)``."""
        return self.joints.poses(as_floats("q", q, (self.n_joints,), batched=True))

    def link_poses(self, q: ArrayLike) -> RigidTransform:
        """World poses of the link frames, ``(..., n)`` to shape ``(..., N)``; the last is the end effector."""
        return self.compose(self.joint_poses(q))

    def compose(self, joint_poses: RigidTransform) -> RigidTransform:
        """World poses of the link frames from per-joint poses of shape ``(..., N)``, feasible or not."""
        moved = self.mounts.as_matrix() @ joint_poses.as_matrix() @ self.tips.as_matrix()
        frame, frames = self.base.as_matrix(), []
        for i in range(self.n_links):
            frame = frame @ moved[..., i, :, :]
            frames.append(frame)
        stacked = np.stack(frames, axis=-3)
        return poses(stacked[..., :3, :3], stacked[..., :3, 3])

    def encode(self, q: ArrayLike) -> Floats:
        """Network coordinates (omega, v / length_scale) of T_i(q), ``(..., n)`` to ``(..., N, 6)``.

        They are Log T_i(q); or, for a link that moves along one screw, such as behind a hinge, the screw times its
        coordinate, however far it turns.
        """
        return self.joints.twists(as_floats("q", q, (self.n_joints,), batched=True)) / self.twist_units

    def decode(self, xi: ArrayLike, xi_dot: ArrayLike | None = None, start: ArrayLike | None = None) -> Retraction:
        """Nearest joint positions to network coordinates ``(..., N, 6)``, their rates along ``xi_dot``, and the gap.

        With a joint position ``start`` ``(n,)``, coordinates ``(K, ..., N, 6)`` are followed along their first axis: of
        several equally near postures, the one that continues the way is taken.
        """
        shape = (self.n_links, 6)
        twist = as_floats("xi", xi, shape, batched=True) * self.twist_units
        rate = None if xi_dot is None else as_floats("xi_dot", xi_dot, shape, batched=True) * self.twist_units
        begin = None if start is None else as_floats("start", start, (self.n_joints,))
        return self._retractor(twist, rate, begin)

    def physics(self) -> Any:
        """A `dm_control.mujoco.Physics` of the scene at the keyframe ``home``, for dm_control's tasks and viewers.

        Raises:
            LieEDNNError: dm_control is not installed; it has no release for MuJoCo 4 or Python 3.13.
        """
        try:
            from dm_control import mujoco as dm_mujoco
        except ImportError:
            raise LieEDNNError("Arm.physics needs dm_control, which takes Python 3.11 or 3.12 and MuJoCo 3") from None

        physics = dm_mujoco.Physics.from_model(dm_mujoco.wrapper.MjModel(copy.deepcopy(self.model)))
        with physics.reset_context():
            mujoco.mj_resetDataKeyframe(self.model, physics.data.ptr, self.model.key("home").id)
        return physics

    @property
    def without_visuals(self) -> Arm:
        """This arm without its visual geoms: it moves exactly as this one does, to the last bit, at half the cost.

        Itself where the motion depends on them, or where the model has been changed since it was compiled.
        """
        return self._bare if moves_alike(self._bare.model, self.model) else self

    @cached_property
    def _bare(self) -> Arm:
        spec, model = discard_visuals(self)
        return replace(self, spec=spec, model=model)

    @cached_property
    def fingerprint(self) -> str:
        """Fingerprint of this arm and its obstacles, see `fingerprint.arm_fingerprint`."""
        return arm_fingerprint(self)

    @cached_property
    def _touching(self) -> ContactFinder:
        return ContactFinder(self.without_visuals.model)

    @cached_property
    def _nearly_touching(self) -> ContactFinder:
        return ContactFinder(self.without_visuals.model, self.clearance)

    @cached_property
    def _retractor(self) -> Retractor:
        return Retractor(self.joints, self.length_scale)

    @property
    def twist_units(self) -> Floats:
        """``(6,)`` the units of the network's coordinates (omega, v) [rad, m]."""
        return np.repeat([1.0, self.length_scale], 3)
