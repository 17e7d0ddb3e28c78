"""An arm in a scene: loaded from a file or a spec, among obstacles, with its contacts."""

from __future__ import annotations

import copy
import os
import pickle
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder, fixed_body, moved_by
from lieednn_sim.arm.dependents import Dependents
from lieednn_sim.arm.equalities import dof_addresses
from lieednn_sim.arm.fingerprint import arm_fingerprint, model_fingerprint
from lieednn_sim.arm.grasp import Grasp, find_grasp
from lieednn_sim.arm.importer import ImportOptions, ImportReport
from lieednn_sim.arm.models import find_model, label_of, open_model
from lieednn_sim.arm.obstacles import add_own_obstacles, check_home, is_scene_file, load_obstacles, scene_label
from lieednn_sim.arm.parsing import read_arm
from lieednn_sim.arm.scenes import add_obstacles
from lieednn_sim.arm.serial_arm import SerialArm
from lieednn_sim.arm.stops import Stops
from lieednn_sim.arm.view import check_data, name_of, read_view, rigid_groups, standing, state_of
from lieednn_sim.arm.visuals import discard_visuals, moves_alike
from lieednn_sim.errors import FileError, InputError, NoSolutionError
from lieednn_sim.lie import rotations
from lieednn_sim.registry import SCENES
from lieednn_sim.validation import Seed, as_choice, as_count, as_floats, as_path, as_seed, quoted
from lieednn_sim.values import Floats

_LIMITS = ("position_limits", "velocity_limits", "acceleration_limits", "jerk_limits", "force_limits")


@dataclass(frozen=True, eq=False)
class Arm(SerialArm):
    """A robot arm among obstacles; make one with `Arm.load`.

    The base class `SerialArm` has its joint coordinates, limits and kinematics; this class adds obstacles and contacts.

    Attributes:
        scene: name of the obstacles around it: one of `registry.SCENES`, or the stem of their file.
        scene_seed: seed of the obstacles' positions.
        import_report: what the importer did, for a file without the package's conventions; otherwise None.
        clearance: distance that planned motions keep from contact, start and target included [m]; change it with
            `dataclasses.replace`.
        start_tolerance: how far a start may be beyond a limit, such as by a sensor's noise or on a soft stop [rad, m];
            it is then taken as at the limit (`check_start`).
        recipe: names of the methods that loaded it from files, and their arguments; empty for an arm from a spec, which
            cannot be pickled, and for a view.
        qpos_home: of a view, ``(nq,)`` the positions of its model in the state that it was made of: its ``home``.
        state: of a view, the whole of that state (`view.state_of`), in which simulations begin.
        named: of a view, the arguments joints, tip, base and limits of `of`.
        made: of a view, the limits that it was made with, by name.
        collision_model: of a view, `geometry`.
        left_out: of a view, offsets of pairs of geoms that do not count there (`rigid_groups`).
        grasp: what it carries (`holding`).
        dependents: of a view, the joints that it moves by closed loops or curves, if any.
        stops: of a view, ranges of these and of tendons, if any; configurations beyond them are not allowed.
    """

    scene: str = "free"
    scene_seed: int = 0
    import_report: ImportReport | None = None
    clearance: float = PLANNED_CLEARANCE
    start_tolerance: float = 1e-3
    recipe: tuple[tuple[str, tuple[Any, ...], ImportOptions], ...] = ()
    qpos_home: Floats | None = None
    state: Floats | None = None
    named: Mapping[str, Any] = field(default_factory=dict)
    made: Mapping[str, Floats] = field(default_factory=dict)
    collision_model: mujoco.MjModel | None = None
    left_out: dict[tuple[int, int], float] = field(default_factory=dict)
    grasp: Grasp | None = None
    dependents: Dependents | None = None
    stops: Stops | None = None

    @classmethod
    def load(
        cls,
        name: str | os.PathLike[str],
        scene: str | os.PathLike[str] = "free",
        seed: Seed = 0,
        **options: Unpack[ImportOptions],
    ) -> Arm:
        """Load an arm of the package, or of an MJCF or URDF file, with the obstacles of a scene.

        Args:
            name: an arm of the package; or an MJCF or URDF file (see `from_xml`), optionally followed by its links as
                in ``robot.urdf:wrist,tool``; or a YAML or JSON file that describes the import (`models.find_model`).
            scene: a name of `registry.SCENES`, or a file of obstacles (see `with_scene`).
            seed: seed of the obstacles' positions.
            options: import options for such a file (see `from_xml`).

        Raises:
            FileError: there is no such file, or MuJoCo cannot compile it.
            InputError: an unknown arm or scene, or the file holds no arm.
        """
        model = find_model(name, options)
        return cls.from_xml(model.path, model.name, **model.options).with_scene(scene, seed)

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
        arm = cls.from_spec(spec, source, name or label_of(source), import_report)
        return replace(arm, recipe=(("from_xml", (source.absolute(), arm.name), options),))

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

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        joints: Sequence[str],
        *,
        tip: str | None = None,
        base: str | None = None,
        limits: Mapping[str, Mapping[str, float]] | None = None,
        clearance: float = PLANNED_CLEARANCE,
    ) -> Arm:
        """Some joints of anybody's compiled model as an arm; everything else is where ``data`` has it.

        The arm's model is a copy of the given one, with mocap bodies and active equalities as in ``data``. Other
        joints, free bodies and robots are in it: obstacles, or parts of the link that carries them. The keyframe
        ``home`` is the state of ``data``. Obstacles are added to the model itself, before it is compiled.

        Joints that active equalities tie to the named ones move with them, wherever they are: by a joint or tendon
        equality, or in a closed loop of ``connect`` and ``weld``, such as the cylinder that lifts a boom
        (`Dependents`). Their ranges, and those of limited tendons, bound the arm. On the chain itself they may only
        follow in a straight line: of a boom and its cylinder, name the joint of the chain, the boom's. A free body that
        an active weld fixes to the end effector is held (`holding`).

        Args:
            model: a compiled model, which is not changed.
            data: its state. Planning needs positions, mocap bodies and active equalities; a simulation begins with
                controls, activations and all else as well.
            joints: names of the joints, on one chain, in any order. The coordinates are in the order of the chain, that
                of `joint_names`.
            tip: body or site of the end effector, by default the last body that the joints move.
            base: body or site of the base frame, by default the parent of the first body that moves.
            limits: ``velocity``, ``acceleration`` and ``jerk`` of coordinates by name [rad or m, s].
            clearance: distance that planned motions keep from contact, start and target included [m].

        Raises:
            InputError: the joints are not an arm's, or data is of another model, or not finite.
            NoSolutionError: the state is not near a solution of the equalities, or at a dead centre of a loop.
        """
        check_data(model, data)
        own = standing(model, data)
        named: dict[str, Any] = {"joints": tuple(joints), "tip": tip, "base": base, "limits": limits}
        fields, held = read_view(own, data, **named)
        arm = cls(
            name=name_of(model),
            source=Path("a compiled model"),
            spec=None,
            model=own,
            clearance=float(as_floats("clearance", clearance, ())),
            state=state_of(own, data),
            named=named,
            made={name: fields[name].copy() for name in _LIMITS},
            **fields,
        )
        return arm._in_groups() if held is None else arm.holding(held)

    def at(self, data: mujoco.MjData) -> Arm:
        """This view in another state of its model, with nothing in its hand; raises as `of`.

        Clearance, and limits that have been changed by `dataclasses.replace`, are kept.
        """
        self._require_view()
        moved = Arm.of(self.model, data, clearance=self.clearance, **self.named)
        changed = {name: np.asarray(getattr(self, name) != self.made[name]) for name in _LIMITS}
        limits = {name: np.where(changed[name], getattr(self, name), getattr(moved, name)) for name in _LIMITS}
        return replace(moved, name=self.name, **limits)

    def data(self) -> mujoco.MjData:
        """New data of the model: in the state that a view was made of, and of other arms at the model's reference."""
        data = mujoco.MjData(self.model)
        if self.state is not None:
            mujoco.mj_setState(self.model, data, self.state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return data

    def holding(self, body: str, touching: Sequence[str] = ()) -> Arm:
        """This view of a model with a free body that its end effector carries, from where that is in its ``home``.

        The body moves with the end effector. What carries it may touch it. It keeps the clearance from all else, except
        from what it stands on, that is, what it is nearer to than that now: this it may touch, but sink no deeper into.

        Args:
            body: name of a body with a free joint.
            touching: names of bodies that it may touch as well, such as those it is put on.

        Raises:
            InputError: the arm is no view, or there is no such body.
        """
        grasp = find_grasp(self.model, self._require_view(), self.frames[-1:], body, touching, self.clearance)
        return replace(self, grasp=grasp)._in_groups()

    def _in_groups(self) -> Arm:
        """This view with what it does not move against each other in groups."""
        carried = () if self.grasp is None else self.grasp.bodies
        geometry, left_out = rigid_groups(self.model, self.dofs, carried)
        return replace(self, collision_model=geometry, left_out=left_out)

    def with_scene(self, scene: str | os.PathLike[str], seed: Seed = 0) -> Arm:
        """This arm with the obstacles of a scene; itself for the scene ``"free"``.

        Args:
            scene: a name of `registry.SCENES`, or a file of obstacles with a suffix of `obstacles.SCENE_SUFFIXES` (see
                `obstacles.load_obstacles`), whose stem becomes the arm's `scene`.
            seed: seed of the obstacles' positions, where these are random.

        Raises:
            FileError: there is no such file, or it cannot be read.
            InputError: no such scene, a bad seed, the arm has obstacles already, there is no place for them around it,
                or a file's obstacles touch it at home.
        """
        seed = as_seed("seed", seed)
        own = is_scene_file(scene)
        label = scene_label(scene) if own else as_choice("scene", scene, SCENES)  # type: ignore[arg-type]
        if label == "free":
            return self
        if self.scene != "free":
            raise InputError(f"arm {self.name!r} already has the obstacles of scene {self.scene!r}")
        again = ("with_scene", (Path(scene).absolute() if own else label, seed), ImportOptions())
        recipe = self.recipe and (*self.recipe, again)
        if own:
            arm = self.with_obstacles(load_obstacles(scene), label)
            check_home(arm, label)
            return replace(arm, recipe=recipe)
        spec = self.copied_spec()
        add_obstacles(spec, self, label, seed)
        return replace(self._of(spec), scene=label, scene_seed=seed, recipe=recipe)

    def with_obstacles(self, obstacles: mujoco.MjSpec, label: str) -> Arm:
        """This arm with the obstacles of a spec (see `obstacles.shapes`); does not check that home is free of them.

        Args:
            obstacles: bodies without joints, in the world's frame.
            label: the new arm's `scene`.

        Raises:
            FileError: MuJoCo cannot compile them.
        """
        spec = self.copied_spec()
        add_own_obstacles(spec, self, obstacles, label)
        return replace(self._of(spec), scene=label)

    def with_moved_bodies(self, places: Mapping[str, ArrayLike], grown: float = 0.0) -> Arm:
        """This arm with obstacles elsewhere, such as where they are measured, and grown by a margin.

        Args:
            places: positions ``(3,)`` of bodies without joints, in the frames of their parents [m], by name.
            grown: how much further than they do the surfaces of their geoms shall reach [m]; meshes are not grown.

        Raises:
            InputError: there is no such body, or a value is malformed.
        """
        spec = self.copied_spec()
        for name, place in places.items():
            fixed_body(self.model, name)
            body = spec.body(name)
            body.pos = as_floats(f"the place of {quoted(name)}", place, (3,))
            for geom in body.geoms:
                # Sizes that a geom's type does not use are zero.
                geom.size = geom.size + as_floats("grown", grown, ()) * (geom.size > 0.0)
        return replace(self._of(spec), scene=self.scene, scene_seed=self.scene_seed)

    def copied_spec(self) -> mujoco.MjSpec:
        """A copy of the spec, to be changed; `InputError` for a view, which has none."""
        if self.spec is None:
            raise InputError(
                "a view of a compiled model has no spec to change: add bodies to the model before it is compiled, or "
                "take another controller or policy"
            )
        return self.spec.copy()

    def _of(self, spec: mujoco.MjSpec) -> Arm:
        """This arm, compiled from an extended spec."""
        return replace(Arm.from_spec(spec, self.source, self.name, self.import_report), clearance=self.clearance)

    def __repr__(self) -> str:
        return f"<Arm {self.name}: {self.n_links} links, {self.n_joints} joints, scene {self.scene}>"

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the spec, which MuJoCo cannot pickle: it is loaded again, once in each process.

        Raises:
            InputError: the arm was made from a spec.
        """
        if self.qpos_home is not None:
            return dict(vars(self))
        if not self.recipe:
            raise InputError(
                f"arm {self.name!r} was made from a spec, which cannot be pickled: make the arm in each process"
            )
        state = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "spec"}
        return {**state, "compiled": self._compiled}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if state["qpos_home"] is not None:
            vars(self).update(state)
            return
        loaded = _loaded(pickle.dumps(state["recipe"]))
        if loaded._compiled != state.pop("compiled"):
            raise FileError(f"{state['source']}, or a file that it uses, has changed since the arm was loaded from it")
        vars(self).update(state, spec=loaded.spec)

    @property
    def dofs(self) -> NDArray[np.int_]:
        """Addresses in qvel of all that the coordinates move, but for what is carried."""
        more = () if self.dependents is None else dof_addresses(self.model, self.dependents.moved)
        return np.union1d(self.space.rate_addresses, more).astype(int)

    def __deepcopy__(self, _: dict[int, Any]) -> Arm:
        return replace(self, spec=self.spec and self.spec.copy(), model=copy.deepcopy(self.model))

    def check_start(self, q: ArrayLike | str, what: str = "start") -> Floats:
        """Return where the arm is, as `check_position` does; within `start_tolerance` beyond a limit, at that."""
        position = self.configuration(q, what)
        inside = self.within_angles(np.clip(position, *self.position_limits.T))
        worst = int(np.abs(position - inside).argmax())
        if abs(position[worst] - inside[worst]) > self.start_tolerance:
            raise InputError(
                f"{what} is out of reach: {self.describe_excess(position, worst)}; up to {self.start_tolerance:g} "
                "beyond a limit is taken as at it: bring the joint back, or allow more by "
                "dataclasses.replace(arm, start_tolerance=...)"
            )
        return inside

    def check_reachable(self, q: ArrayLike | str, what: str = "q") -> Floats:
        """Return ``q`` as `check_position` does, or raise `InputError` if contact is nearer than `clearance`."""
        position = self.check_position(q, what)
        touching = self.near_contacts(position)
        if touching:
            loose = self._free_bodies()
            first, second = next((pair for pair in touching if loose.intersection(pair)), touching[0])
            hint = "".join(
                f"; if the hand holds it, plan with arm.holding({body!r})"
                for body in sorted(loose.intersection((first, second)))[:1]
            )
            if not hint and not self.contacts(position):
                near = f"nearer than the clearance of {1e3 * self.clearance:g} mm"
                hint = f", or come {near}, which dataclasses.replace(arm, clearance=...) sets"
            raise InputError(f"{what} is out of reach: {first!r} would touch {second!r} there{hint}")
        return position

    def _require_view(self) -> Floats:
        """A view's `qpos_home`; raises `InputError` if the arm is no view."""
        if self.qpos_home is None:
            raise InputError(f"arm {self.name!r} is no view of a compiled model, such as Arm.of makes")
        return self.qpos_home

    def _free_bodies(self) -> set[str]:
        """Names of the bodies in a view's model that are free and not carried."""
        model, carried = self.model, () if self.grasp is None else self.grasp.bodies
        free = model.jnt_bodyid[model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)] if self.state is not None else ()
        return {model.body(body).name for body in free if body not in carried}

    def contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that touch each other at ``q`` ``(n,)``."""
        return self._touching.bodies(self.qpos(as_floats("q", q, (self.n_joints,))))

    def near_contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that are closer than the arm's `clearance` to each other at ``q`` ``(n,)``."""
        return self._nearly_touching.bodies(self.qpos(as_floats("q", q, (self.n_joints,))))

    def near_contacts_along(self, q: Floats) -> Iterator[list[tuple[str, str]]]:
        """`near_contacts` at each of the configurations ``(K, n)``, lazily; the conversion to qpos is done at once.

        Where loops cannot be closed, two bodies of them count as near.
        """
        rows = self.qpos(q, strict=False)
        if self.dependents is None or not np.isnan(rows).any():
            return map(self._nearly_touching.bodies, rows)
        joints = self.dependents.moved
        torn = [tuple(self.model.body(self.model.jnt_bodyid[joint]).name for joint in (joints[0], joints[-1]))]
        return (torn if np.isnan(row).any() else self._nearly_touching.bodies(row) for row in rows)

    @property
    def without_visuals(self) -> Arm:
        """This arm without its visual geoms: it moves exactly as this one does, to the last bit, at half the cost.

        The arm itself is returned where its motion depends on them, or its model was changed after it was compiled.
        """
        return self._bare if self.spec is not None and moves_alike(self._bare.model, self.model) else self

    @cached_property
    def _bare(self) -> Arm:
        spec, model = discard_visuals(self)
        return replace(self, spec=spec, model=model, recipe=())

    @cached_property
    def _compiled(self) -> str:
        """Fingerprint of the model that the spec gives, whatever has been changed in `model` since."""
        return model_fingerprint(self.spec.copy().compile())

    @cached_property
    def fingerprint(self) -> str:
        """Fingerprint of this arm and its obstacles, see `fingerprint.arm_fingerprint`."""
        return arm_fingerprint(self)

    @property
    def geometry(self) -> mujoco.MjModel:
        """The model for distances: in that of a view, what the arm does not move is welded to the world."""
        return self.model if self.collision_model is None else self.collision_model

    @property
    def offsets(self) -> dict[tuple[int, int], float]:
        """Offsets of pairs of geoms that are not the model's own, as of `contacts.ContactOffsets`."""
        return self.left_out if self.grasp is None else {**self.left_out, **self.grasp.offsets}

    def contact_finder(self, margin: float = 0.0) -> ContactFinder:
        """Finds geoms closer than a margin [m]; one for each thread."""
        return ContactFinder(self.geometry, margin, self.offsets)

    def moved_by(self, body: int) -> NDArray[np.bool_]:
        """Which degrees of freedom ``(nv,)`` move a body, by its id; for what is carried, those of what carries it."""
        body = as_count("body", body, 0, self.model.nbody - 1)
        carried = self.grasp is not None and body in self.grasp.bodies
        return moved_by(self.model, self.grasp.carrier if self.grasp is not None and carried else body)

    @property
    def keyframes(self) -> tuple[str, ...]:
        """Names of the keyframes; of a view with ``home``, its state."""
        names = super().keyframes
        return names if self.qpos_home is None or "home" in names else ("home", *names)

    def keyframe(self, name: str) -> Floats:
        """Joint coordinates ``(n,)`` of a keyframe; ``home`` of a view is the state that it was made of."""
        if name == "home" and self.qpos_home is not None:
            return self.coordinates(self.qpos_home)
        return super().keyframe(name)

    def limit_excess(self, q: Floats) -> Floats:
        """How far each coordinate ``(..., n)`` is outside its limits, and what else has a range (`stops`)."""
        excess = super().limit_excess(q)
        if self.stops is None:
            return excess
        return np.concatenate([excess, self.stops.excess(self.qpos(q, strict=False))], axis=-1)

    def describe_excess(self, q: Floats, joint: int) -> str:
        """The message for an entry of `limit_excess` at q ``(n,)`` that is positive."""
        if self.stops is None or joint < self.n_joints:
            return super().describe_excess(q, joint)
        try:
            return self.stops.describe(self.qpos(q), joint - self.n_joints)
        except NoSolutionError as error:
            return str(error)

    def qpos(self, q: ArrayLike, *, strict: bool = True) -> Floats:
        """MuJoCo's positions ``(..., nq)`` at joint coordinates ``(..., n)``, those of loops and what is carried too.

        Args:
            q: joint coordinates.
            strict: whether coordinates at which loops cannot be closed raise; else their positions are NaN.

        Raises:
            InputError: q is malformed.
            NoSolutionError: loops cannot be closed.
        """
        positions, grasp = super().qpos(q), self.grasp
        if self.dependents is not None:
            positions = self.dependents.to_qpos(positions, strict=strict)
        if grasp is not None:
            held = self.link_poses(q).as_matrix()[..., -1, :, :] @ grasp.place.as_matrix()
            positions[..., grasp.qpos : grasp.qpos + 3] = held[..., :3, 3]
            positions[..., grasp.qpos + 3 : grasp.qpos + 7] = rotations(held[..., :3, :3]).as_quat(scalar_first=True)
        return positions

    def qvel(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """MuJoCo's velocities ``(..., nv)`` at coordinates and rates ``(..., n)``, of what is carried too."""
        velocities, grasp = super().qvel(q, qd), self.grasp
        if self.dependents is not None:
            rows = np.broadcast_to(as_floats("q", q, (), batched=True), (*velocities.shape[:-1], self.n_joints))
            # Often many rates at each of a few configurations.
            few, which = np.unique(rows.reshape(-1, self.n_joints), axis=0, return_inverse=True)
            bases = self.dependents.basis(self.qpos(few))[which.reshape(rows.shape[:-1])]
            velocities = np.matvec(bases, velocities[..., self.dependents.dofs])
        if grasp is not None:
            tip = self.link_poses(q).as_matrix()[..., -1, :, :]
            held = tip @ grasp.place.as_matrix()
            omega, speed = np.split(np.matvec(self.jacobian(q), as_floats("qd", qd, (), batched=True)), 2, axis=-1)
            # A free joint's velocity is linear in the world, angular in its body.
            velocities[..., grasp.qvel : grasp.qvel + 3] = speed + np.cross(omega, (held - tip)[..., :3, 3])
            velocities[..., grasp.qvel + 3 : grasp.qvel + 6] = np.vecmat(omega, held[..., :3, :3])
        return velocities

    @cached_property
    def _touching(self) -> ContactFinder:
        return self.without_visuals.contact_finder()

    @cached_property
    def _nearly_touching(self) -> ContactFinder:
        return self.without_visuals.contact_finder(self.clearance)


@lru_cache(maxsize=8)
def _loaded(recipe: bytes) -> Arm:
    """An arm by its pickled recipe."""
    arm: Any = Arm
    for method, arguments, options in pickle.loads(recipe):
        arm = getattr(arm, method)(*arguments, **options)
    assert isinstance(arm, Arm)
    return arm
