"""An arm in a scene: loaded from a file or a spec, among obstacles, with its contacts."""

from __future__ import annotations

import copy
import pickle
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, fixed_body, move_bodies, without_clearance
from lieednn_sim.arm.equalities import loop_closures
from lieednn_sim.arm.fingerprint import arm_fingerprint, model_fingerprint
from lieednn_sim.arm.grasp import add_payload, load_body
from lieednn_sim.arm.importer.importing import import_model
from lieednn_sim.arm.importer.loading import compile_spec, read_model
from lieednn_sim.arm.importer.report import ImportOptions, ImportReport
from lieednn_sim.arm.model_arm import LIMITS, ModelArm
from lieednn_sim.arm.models import chosen, find_model, label_of, models_directory
from lieednn_sim.arm.obstacles import add_own_obstacles, check_home, is_scene_file, load_obstacles, scene_label
from lieednn_sim.arm.parsing import read_arm, read_chain
from lieednn_sim.arm.scenes import add_obstacles
from lieednn_sim.arm.surroundings import check_data, home_data, state_of
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.registry import SCENES
from lieednn_sim.validation import Seed, as_choice, as_floats, as_nonnegative, as_path, as_seed, quoted
from lieednn_sim.values import StrPath


@dataclass(frozen=True, eq=False)
class Arm(ModelArm):
    """A robot arm among obstacles; make one with `Arm.load`.

    The base class `SerialArm` has the joint coordinates, limits and kinematics, `ModelArm` the contacts and everything
    else in the model; this class adds files, scenes and obstacles.

    Attributes:
        scene: name of the obstacles around it: one of `registry.SCENES`, or the stem of their file.
        scene_seed: seed of the obstacles' positions.
        import_report: what the importer found and added, for a file without the package's sites; otherwise None.
    """

    scene: str = "free"
    scene_seed: int = 0
    import_report: ImportReport | None = None

    @classmethod
    def load(cls, name: StrPath, scene: StrPath = "free", seed: Seed = 0, **options: Unpack[ImportOptions]) -> Arm:
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
        if model.options or not model.path.is_relative_to(models_directory()):
            return cls.from_xml(*model[:2], **model.options).with_scene(scene, seed)
        recipe = (("from_xml", model[:2], ImportOptions()),)  # cached, since the package's own files do not change
        return copy.deepcopy(_loaded(pickle.dumps(recipe))).with_scene(scene, seed)

    @classmethod
    def from_xml(cls, path: StrPath, name: str | None = None, **options: Unpack[ImportOptions]) -> Arm:
        """Load an MJCF or URDF file that holds one arm.

        A file with the sites ``base_frame`` and ``link1_frame``, ``link2_frame``, ... is taken as it is. Any other file
        is imported (`importer.importing.import_model`): the arm is its longest chain, or the one that the options name.

        Args:
            path: the file.
            name: the arm's name; by default the file's stem, or its folder's name when the file is ``scene.xml``.
            options: import options; naming any of them imports the file.

        Raises:
            FileError: there is no such file, or MuJoCo cannot compile it.
            InputError: it holds no such arm.
        """
        source = as_path("path", path)
        arm = cls._taken(source, read_model(source), source, name or label_of(source), options)
        return replace(arm, recipe=(("from_xml", (source.absolute(), arm.name), options),))

    @classmethod
    def from_spec(
        cls, spec: mujoco.MjSpec, source: Path = Path("a spec"), name: str = "arm", **options: Unpack[ImportOptions]
    ) -> Arm:
        """The arm in a spec, which is not changed, as for `from_xml`.

        Args:
            spec: the spec.
            source: the file that it is from, if any.
            name: the arm's name.
            options: import options.

        Raises:
            FileError: MuJoCo cannot compile it.
            InputError: it holds no such arm.
        """
        return cls._taken(spec, spec, source, name, options)

    @classmethod
    def _taken(
        cls, model: Path | mujoco.MjSpec, spec: mujoco.MjSpec, source: Path, name: str, options: ImportOptions
    ) -> Arm:
        """The arm in ``spec``: read by its frame sites if it has them, otherwise imported from ``model``."""
        given = chosen(options)
        # The package's own arms have these sites, at their link frames.
        if not given and spec.site("base_frame") is not None and spec.site("link1_frame") is not None:
            compiled = compile_spec(spec)
            if not loop_closures(compiled):
                return cls(name=name, source=source, spec=spec, model=compiled, **read_arm(compiled, name))
            chain = read_chain(compiled, name)
            named = {"links": [frame.name for frame in chain.frames[1:]], "base": chain.frames[0].name}
            return cls.viewing(compiled, home_data(compiled), named, name=name, source=source, spec=spec)
        arm, report = import_model(model, source, name, **given)
        return cls(**{item.name: getattr(arm, item.name) for item in fields(arm)}, import_report=report)

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        joints: Sequence[str] | None = None,
        *,
        links: Sequence[str] | None = None,
        tip: str | None = None,
        base: str | None = None,
        limits: Mapping[str, Mapping[str, float]] | None = None,
        clearance: float = PLANNED_CLEARANCE,
    ) -> Arm:
        """Take some joints of any compiled model as an arm; everything else stays where ``data`` has it.

        The arm's model is a copy of the given one, with mocap bodies and active equalities as in ``data``. Its other
        joints, free bodies and robots are obstacles, or parts of the link that carries them. The keyframe ``home`` is
        the state of ``data``. To add obstacles, add them to the model before it is compiled.

        Joints that active equalities tie to the named joints move with them, anywhere in the model: by a joint or
        tendon equality, or in a closed loop of ``connect`` and ``weld``, such as the cylinder that lifts a boom
        (`Dependents`). Their ranges, and those of limited tendons, limit the arm. A joint of the chain itself may only
        follow linearly; of a boom and its cylinder, for example, name the boom's joint, which is on the chain. A free
        body that an active weld fixes to the end effector is held (`holding`).

        Args:
            model: a compiled model, which is not changed.
            data: its state. Planning uses positions, mocap bodies and active equalities; a simulation starts from the
                whole state, with its controls and activations.
            joints: names of the joints, on one chain, in any order; `joint_names` are in the chain's order.
            links: instead of the joints, names of the bodies or sites at the link frames, from the base outwards; the
                joints between two of them move one link.
            tip: body or site of the end effector, by default the last body that the joints move.
            base: body or site of the base frame, by default the parent of the first body that moves.
            limits: ``velocity``, ``acceleration`` and ``jerk`` of coordinates by name [rad or m, s].
            clearance: distance that planned motions keep from contact, start and target included [m].

        Warns:
            UserWarning: the model has flexes, or geoms of the type sdf, from which motions keep no clearance.

        Raises:
            InputError: the joints do not form an arm, or data belongs to another model or is not finite.
            NoSolutionError: the state is not near a solution of the equalities, or at a dead centre of a loop.
        """
        check_data(model, data)
        named: dict[str, Any] = {"joints": joints, "links": links, "tip": tip, "base": base, "limits": limits}
        named = {what: value for what, value in named.items() if value is not None}
        if said := without_clearance(model):
            warnings.warn(said, stacklevel=3)  # past the wrapper that checks arguments
        more = {"clearance": clearance, "state": state_of(model, data)}
        own = model.names[: model.names.index(b"\0")].decode("utf-8", "replace")
        name = "arm" if own in ("", "MuJoCo Model") else own
        return cls.viewing(model, data, named, name=name, source=Path("a compiled model"), spec=None, **more)

    def at(self, data: mujoco.MjData) -> Arm:
        """This view in another state of its model, with nothing in its hand; raises as `of`.

        Clearance, and limits that have been changed by `dataclasses.replace`, are kept.
        """
        self._require_view()
        moved = replace(Arm.of(self.model, data, clearance=self.clearance, **self.named), spec=self.spec)
        kept = self.payload > 0.0
        changed = {name: np.asarray((getattr(self, name) != self.made[name]) | kept) for name in LIMITS}
        limits = {name: np.where(changed[name], getattr(self, name), getattr(moved, name)) for name in LIMITS}
        return replace(moved, name=self.name, payload=self.payload, **limits)

    def with_scene(self, scene: StrPath, seed: Seed = 0) -> Arm:
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
        # What is not the name of a file must be a text, which `as_choice` checks.
        label = scene_label(scene) if own else as_choice("scene", scene, SCENES, "or a file")  # type: ignore[arg-type]
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
        return replace(self.recompiled(spec), scene=label, scene_seed=seed, recipe=recipe)

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
        return replace(self.recompiled(spec), scene=label)

    def with_moved_bodies(self, places: Mapping[str, ArrayLike], grown: float = 0.0) -> Arm:
        """This arm with some obstacles moved, such as to where they were measured, and grown by a margin.

        Args:
            places: positions ``(3,)`` of bodies without joints, in the frames of their parents [m], by name.
            grown: distance by which the surfaces of their geoms are moved outwards [m]; meshes are not grown.

        Raises:
            InputError: there is no such body, or a value is malformed.
        """
        more = as_nonnegative("grown", grown)
        if self.spec is None:
            models = [copy.deepcopy(model) for model in (self.model, self.collision_model)]
            for model in filter(None, models):
                move_bodies(model, places, more)
            return replace(self, model=models[0], collision_model=models[1])
        spec = self.copied_spec()
        for name, place in places.items():
            fixed_body(self.model, name)
            body = spec.body(name)
            body.pos = as_floats(f"the place of {quoted(name)}", place, (3,))
            for geom in body.geoms:
                # Sizes that a geom's type does not use are zero.
                geom.size = geom.size + more * (geom.size > 0.0)
        return replace(self.recompiled(spec), scene=self.scene, scene_seed=self.scene_seed)

    def with_payload(self, payload: float) -> Arm:
        """This arm with a further mass [kg] at its end effector's frame, which plans and controllers account for.

        The mass is a ball of steel that touches nothing and whose weight MuJoCo does not compensate. Limits of
        velocity, acceleration and jerk stay those of the arm alone; each motion's forces are checked (`check_forces`).

        Raises:
            InputError: the mass is negative; or, in a view of a compiled model, MuJoCo compensates the weight of the
                end effector's body, at its centre of mass.
        """
        mass = as_nonnegative("payload", payload)
        if (whole := self.payload + mass) == self.payload:
            return self
        if self.spec is None:
            model = copy.deepcopy(self.model)
            load_body(model, self, mass)
            return replace(self, model=model, payload=whole)
        spec = self.copied_spec()
        add_payload(spec, self, mass, name := f"payload up to {whole} kg")
        for k, servo in enumerate(spec.actuators):
            # Otherwise the compiler would derive a servo's damping from the inertia with the payload.
            servo.gainprm, servo.biasprm = self.model.actuator_gainprm[k], self.model.actuator_biasprm[k]
        recipe = self.recipe and (*self.recipe, ("with_payload", (mass,), ImportOptions()))
        kept: dict[str, Any] = {name: getattr(self, name) for name in ("scene", "scene_seed", *LIMITS)}
        arm = replace(self.recompiled(spec), payload=whole, recipe=recipe, **kept)
        if abs(arm.model.body(name).mass[0] - mass) > 1e-6 * mass:
            raise InputError(f"settotalmass or boundmass in the file of {self.name!r} would change the payload")
        return arm

    def copied_spec(self) -> mujoco.MjSpec:
        """A copy of the spec, to be changed; `InputError` for a view, which has none."""
        if self.spec is None:
            raise InputError(
                "a view of a compiled model has no spec to change: add bodies to the model before it is compiled, or "
                "take another controller or policy"
            )
        return self.spec.copy()

    def recompiled(self, spec: mujoco.MjSpec) -> Arm:
        """This arm in a changed copy of its spec, which has the same joints; raises as `from_xml`."""
        # Acceleration limits stay those of the arm without its payload.
        loaded = ("acceleration_limits",) if self.payload > 0.0 else ()
        kept = {name: getattr(self, name) for name in ("clearance", "start_tolerance", "payload", *loaded)}
        if self.qpos_home is None:
            return replace(Arm.from_spec(spec, self.source, self.name), **kept)
        model = compile_spec(spec)
        data = kinematics_at(model, self.qpos_home)
        more = {name: getattr(self, name) for name in ("name", "source", "import_report")}
        arm = replace(Arm.viewing(model, data, self.named, spec=spec, **more), **kept)
        return arm if self.grasp is None or arm.grasp is not None else arm.holding(*self.grasp.named)

    def __repr__(self) -> str:
        return f"<Arm {self.name}: {self.n_links} links, {self.n_joints} joints, scene {self.scene}>"

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the spec, which MuJoCo cannot pickle: it is loaded again, once in each process.

        Raises:
            InputError: the arm was made from a spec.
        """
        if self.spec is None:
            return dict(vars(self))
        if not self.recipe:
            raise InputError(
                f"arm {self.name!r} was made from a spec, which cannot be pickled: make the arm in each process"
            )
        state = {item.name: getattr(self, item.name) for item in fields(self) if item.name != "spec"}
        return {**state, "compiled": self._compiled}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if "compiled" not in state:
            vars(self).update(state)
            return
        loaded = _loaded(pickle.dumps(state["recipe"]))
        if loaded._compiled != state.pop("compiled"):
            raise FileError(f"{state['source']}, or a file that it uses, has changed since the arm was loaded from it")
        vars(self).update(state, spec=loaded.spec)

    def __deepcopy__(self, _: dict[int, Any]) -> Arm:
        limits = {name: getattr(self, name).copy() for name in LIMITS}
        return replace(self, spec=self.spec and self.spec.copy(), model=copy.deepcopy(self.model), **limits)

    @cached_property
    def _compiled(self) -> str:
        """Fingerprint of the model that the spec gives, whatever has been changed in `model` since."""
        return model_fingerprint(self.spec.copy().compile())

    @cached_property
    def fingerprint(self) -> str:
        """Fingerprint of this arm and its obstacles, see `fingerprint.arm_fingerprint`."""
        return arm_fingerprint(self)


@lru_cache(maxsize=8)
def _loaded(recipe: bytes) -> Arm:
    arm: Any = Arm
    for method, arguments, options in pickle.loads(recipe):
        arm = getattr(arm, method)(*arguments, **options)
    assert isinstance(arm, Arm)
    return arm
