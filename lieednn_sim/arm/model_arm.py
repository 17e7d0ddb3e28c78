"""An arm within its MuJoCo model: what it moves besides its chain, what it carries, touches, and is limited by."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import FREE, SCALAR, ancestry
from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, ContactFinder
from lieednn_sim.arm.dependents import Dependents
from lieednn_sim.arm.equalities import dof_addresses
from lieednn_sim.arm.fingerprint import discard_visuals, moves_alike
from lieednn_sim.arm.forces import tangent_basis
from lieednn_sim.arm.grasp import Grasp, find_grasp
from lieednn_sim.arm.limits import Stops
from lieednn_sim.arm.serial_arm import SerialArm
from lieednn_sim.arm.surroundings import home_data, keep_awake, rigid_groups, standing
from lieednn_sim.arm.view import read_view
from lieednn_sim.errors import InputError, NoSolutionError
from lieednn_sim.lie.se3 import rotations
from lieednn_sim.validation import as_choice, as_count, as_floats, as_nonnegative
from lieednn_sim.values import Floats, check_fields, weakly_cached

#: The limits of an arm, by the names of its fields.
LIMITS = ("position_limits", "velocity_limits", "acceleration_limits", "jerk_limits", "force_limits")


@dataclass(frozen=True, eq=False)
class ModelArm(SerialArm):
    """An arm in its model; make one with `Arm.load` or `Arm.of`.

    A view is an arm of some of the joints of a model. The package's own arms consist of all joints of their models.

    Attributes:
        recipe: names of the methods that loaded it from files, and their arguments; empty for an arm from a spec, which
            cannot be pickled, and for a view of a compiled model.
        clearance: distance that planned motions keep from contact, ends included [m]; set by `dataclasses.replace`.
        start_tolerance: how far a start may be beyond a limit, such as by a sensor's noise or on a soft stop [rad, m];
            it is then moved to the limit (`check_start`).
        leaves: for an arm that `leaving` returns, the configuration ``(n,)`` at which its motions begin.
        state: for a view of a compiled model, the whole of that state (`state_of`), from which simulations start. An
            imported file is a view, too, but its simulations start at rest, with the controls of the keyframe ``home``.
        named: for a view, the arguments joints, links, tip, base and limits of `Arm.of`.
        made: for a view, the limits that it was made with, by name.
        notes: which ranges were made or narrowed, and why.
        collision_model: a model used as `geometry` instead of the arm's own, such as a copy with moving obstacles.
        grasp: what it carries (`Arm.holding`).
        payload: mass at the end effector's frame [kg], part of `model` (`Arm.with_payload`).
        dependents: for a view, the joints that it moves by closed loops or curves, if any.
        stops: for a view, ranges of these joints and of tendons, if any; configurations beyond them are refused.
    """

    recipe: tuple[tuple[str, tuple[Any, ...], Any], ...] = ()
    clearance: float = PLANNED_CLEARANCE
    start_tolerance: float = 1e-3
    leaves: Floats | None = None
    state: Floats | None = None
    named: Mapping[str, Any] = field(default_factory=dict)
    made: Mapping[str, Floats] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    collision_model: mujoco.MjModel | None = None
    grasp: Grasp | None = None
    payload: float = 0.0
    dependents: Dependents | None = None
    stops: Stops | None = None

    def __post_init__(self) -> None:
        check_fields(self, as_nonnegative, "clearance", "start_tolerance")
        check_fields(self, as_floats, "position_limits", shape=(self.n_joints, 2), largest=np.inf)
        check_fields(self, as_floats, *LIMITS[1:], shape=(self.n_joints,), largest=np.inf)
        low, high = self.position_limits.T
        if not ((low <= high) & (low < np.inf) & (high > -np.inf)).all():
            raise InputError("position_limits must have lower limits that are not above the upper ones")
        if wrong := [name for name in LIMITS[1:] if getattr(self, name).min(initial=0.0) < 0.0]:
            raise InputError(f"{wrong[0]} must not be negative")

    @classmethod
    def viewing(cls, model: mujoco.MjModel, data: mujoco.MjData, named: Mapping[str, Any], **more: Any) -> Self:
        """A view that has ``more`` fields set; the other arguments and the errors are those of `of`."""
        own = standing(model, data)
        view = read_view(own, data, name=more["name"], **named)
        made = {name: view.fields[name].copy() for name in LIMITS}
        arm = cls(model=own, named=named, made=made, **view.fields, **more)
        keep_awake(own, arm.dofs, arm.spec)
        return arm if view.held is None else arm.holding(view.held, tied=True)

    def data(self) -> mujoco.MjData:
        """New data of the model: in its `state` for a view of a compiled model, otherwise at ``home``."""
        if self.state is None:
            return home_data(self.model)
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, self.state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return data

    @property
    def dofs(self) -> NDArray[np.int_]:
        """Addresses in qvel of everything that the coordinates move, except for what is carried."""
        more = () if self.dependents is None else dof_addresses(self.model, self.dependents.moved)
        return np.union1d(self.space.rate_addresses, more).astype(int)

    @cached_property
    def continuous(self) -> NDArray[np.bool_]:
        """Which coordinates ``(n,)`` each turn a single hinge without a range, so that a whole turn changes nothing."""
        model, joints = self.model, self.model.dof_jntid[self.space.own_rate_addresses]
        free = (model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_HINGE)) & (model.jnt_limited[joints] == 0)
        free &= np.count_nonzero(self.space.rates, axis=0) == 1
        return free if self.dependents is None else np.zeros_like(free)

    def nearest_turn(self, q: ArrayLike, near: ArrayLike) -> Floats:
        """Coordinates ``(n,)``, with whole turns added to `continuous` ones to bring them nearest to ``near``."""
        q, near = (as_floats(what, value, (self.n_joints,)) for what, value in (("q", q), ("near", near)))
        turned = q + 2.0 * np.pi * np.round((near - q) / (2.0 * np.pi)) * self.continuous
        low, high = self.position_limits.T
        return np.where((turned < low) | (turned > high), q, turned)

    def check_start(self, q: ArrayLike | str, what: str = "start") -> Floats:
        """Return a start as `check_position` does, moved to a limit that it exceeds by up to `start_tolerance`."""
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

    def _require_view(self) -> Floats:
        """A view's `qpos_home`; raises `InputError` if the arm is no view."""
        if self.qpos_home is None:
            raise InputError(f"arm {self.name!r} is no view of a compiled model, such as Arm.of makes")
        return self.qpos_home

    def _free_bodies(self) -> set[str]:
        """Names of the bodies in a view's model that are free and not carried."""
        model, carried = self.model, () if self.grasp is None else self.grasp.bodies
        free = model.jnt_bodyid[model.jnt_type == FREE] if self.state is not None else ()
        return {model.body(body).name for body in free if body not in carried}

    @property
    def geometry(self) -> mujoco.MjModel:
        """The model in which distances are measured; in a view's, what the arm does not move is welded to the world."""
        return self._groups[0] if self.collision_model is None else self.collision_model

    @property
    def offsets(self) -> dict[tuple[int, int], float]:
        """Contact offsets of pairs of geoms that differ from the model's own, see `contacts.ContactOffsets`."""
        return self._groups[1] if self.grasp is None else {**self._groups[1], **self.grasp.offsets}

    @property
    def unsupported(self) -> Self:
        """This arm, to measure distances without those of a held body from what it may touch, such as its support."""
        return self if self.grasp is None else self._unsupported

    @cached_property
    def _unsupported(self) -> Self:
        assert self.grasp is not None
        return replace(self, grasp=replace(self.grasp, offsets=dict.fromkeys(self.grasp.offsets, -np.inf)))

    @cached_property
    def _groups(self) -> tuple[mujoco.MjModel, dict[tuple[int, int], float]]:
        """The model for distances of a view, and the pairs of geoms that do not count in it (`rigid_groups`)."""
        if self.qpos_home is None:
            return self.model, {}
        return rigid_groups(self.model, self.dofs, () if self.grasp is None else self.grasp.bodies)

    def contact_finder(self, margin: float = 0.0) -> ContactFinder:
        """A new finder of geoms closer than a margin [m]; each thread needs its own."""
        return ContactFinder(self.geometry, margin, self.offsets, self.leaving_qpos)

    @property
    def leaving_qpos(self) -> Floats | None:
        """MuJoCo's positions ``(nq,)`` at `leaves`; None where that is None."""
        return None if self.leaves is None else self.qpos(self.leaves)

    def leaving(self, start: Floats) -> tuple[Self, str]:
        """This arm for motions from ``start`` ``(n,)``, which may be closer to something than the `clearance`.

        The start may touch it, and be up to `start_tolerance` deep in it. Motions from there leave it: distances grow
        to the clearance before a coordinate has changed by 0.1 rad or m, and never shrink
        (`planning.motion.check_joints`).

        Returns:
            The arm, which is this one if nothing is that close, or something is deeper; and what is close, in words.
        """
        qpos = self.qpos(start)
        distance, _ = self._finder(self.clearance).geoms(qpos)
        if not len(distance) or distance.min() < -self.start_tolerance:
            return self, ""
        pairs = ", ".join(f"{first!r} to {second!r}" for first, second in self._finder(self.clearance).bodies(qpos))
        depth, near = -1e3 * distance.min(), f"nearer than the clearance of {1e3 * self.clearance:g} mm"
        how = f"{depth:.2g} mm deep" if depth > 1e-3 else f"{round(max(-depth, 0.0), 3):g} mm, {near}"
        return replace(self, leaves=start), f"{pairs} ({how}){self._if_held(qpos)}"

    def _if_held(self, qpos: Floats) -> str:
        """Advice on a free body nearer than the clearance at ``(nq,)``, which a hand may hold; empty without one."""
        near = {body for pair in self._finder(self.clearance).bodies(qpos) for body in pair}
        held = min(self._free_bodies().intersection(near), default="")
        return f"; if the hand holds it, plan with arm.holding({held!r})" if held else ""

    def left_along(self, q: Floats) -> Iterator[Floats]:
        """Distances, at most the `clearance`, of geoms that were too near at `leaves`, at configurations ``(K, n)``."""
        return map(self._finder(self.clearance).left, self.qpos(q))

    def moved_by(self, body: int) -> NDArray[np.bool_]:
        """Which degrees of freedom ``(nv,)`` move the body with an id; what is carried moves with its carrier."""
        body = as_count("body", body, 0, self.model.nbody - 1)
        mover = self.grasp.carrier if self.grasp is not None and body in self.grasp.bodies else body
        return np.isin(self.model.dof_bodyid, ancestry(self.model, mover))

    def limit_excess(self, q: Floats) -> Floats:
        """How far each coordinate ``(..., n)`` is outside its limits, then the same for the ranges of `stops`."""
        excess = super().limit_excess(q)
        if self.stops is None:
            return excess
        return np.concatenate([excess, self.stops.excess(self.qpos(q, strict=False))], axis=-1)

    def describe_excess(self, q: Floats, joint: int) -> str:
        """The message for an entry of `limit_excess` at q ``(n,)`` that is positive."""
        if self.stops is None or joint < self.n_joints:
            why = (note for note in self.notes if note.startswith(f"{self.joint_names[joint]}: "))
            return "; ".join((super().describe_excess(q, joint), *why))
        try:
            return self.stops.describe(self.qpos(q), joint - self.n_joints)
        except NoSolutionError as error:
            return str(error)

    def qpos(self, q: ArrayLike, *, strict: bool = True) -> Floats:
        """MuJoCo's positions ``(..., nq)`` at joint coordinates ``(..., n)``, with those of loops and carried bodies.

        Args:
            q: joint coordinates.
            strict: whether to raise where loops cannot be closed; otherwise the positions there are NaN.

        Raises:
            NoSolutionError: loops cannot be closed.
        """
        return self.to_qpos(as_floats("q", q, (self.n_joints,), batched=True), strict=strict)

    def to_qpos(self, q: Floats, *, strict: bool = True) -> Floats:
        """`qpos` of an unchecked q, since the checks take as long as a test for contact."""
        positions, grasp = self.space.to_qpos(q), self.grasp
        if self.dependents is not None:
            positions = self.dependents.to_qpos(positions, strict=strict)
        if grasp is not None:
            held = self.link_poses(q).as_matrix()[..., -1, :, :] @ grasp.place.as_matrix()
            positions[..., grasp.qpos : grasp.qpos + 3] = held[..., :3, 3]
            positions[..., grasp.qpos + 3 : grasp.qpos + 7] = rotations(held[..., :3, :3]).as_quat(scalar_first=True)
        return positions

    def coordinates_at(self, positions: Mapping[str, float]) -> Floats:
        """The coordinates ``(n,)`` that bring joints of the model to ``positions`` [rad, m], the others being at home.

        Each joint, such as the stroke of a cylinder, takes the place of the coordinate that moves it most.

        Raises:
            InputError: a joint is no hinge or slide that the arm moves, or two of them move one coordinate.
            NoSolutionError: the loops cannot be closed there.
        """
        model, data, rates = self.model, self.data(), self.unit_rates(self.keyframe("home"))
        data.qpos[:] = qpos = self.qpos(self.keyframe("home"))
        given: dict[int, int] = {}
        joints = model.dof_jntid[np.flatnonzero(rates.any(axis=1))].tolist()
        moved = {model.joint(j).name: j for j in joints if model.jnt_type[j] in SCALAR}
        for name, position in positions.items():
            joint = moved[as_choice("joint that the arm moves", name, moved)]
            k = int(np.abs(rates[model.jnt_dofadr[joint]]).argmax())
            if k in given:
                raise InputError(f"give one of the joints that move with {self.joint_names[k]!r}, not {name!r} as well")
            given[k], qpos[model.jnt_qposadr[joint]] = joint, float(as_floats(name, position, ()))
        own = model.dof_jntid[self.space.own_rate_addresses].tolist()
        chosen = dict.fromkeys(given.get(k, joint) for k, joint in enumerate(own))
        return self.coordinates(Dependents(model, data, [*chosen]).to_qpos(qpos))

    def qvel(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """MuJoCo's velocities ``(..., nv)`` at coordinates and rates ``(..., n)``, with those of carried bodies."""
        velocities, grasp = super().qvel(q, qd), self.grasp
        if self.dependents is not None:
            rows = np.broadcast_to(as_floats("q", q, (), batched=True), (*velocities.shape[:-1], self.n_joints))
            # Callers often give many rates at each of a few configurations.
            few, which = np.unique(rows.reshape(-1, self.n_joints), axis=0, return_inverse=True)
            bases = self.dependents.basis(self.qpos(few))[which.reshape(rows.shape[:-1])]
            velocities = np.matvec(bases, velocities[..., self.dependents.dofs])
        if grasp is not None:
            tip = self.link_poses(q).as_matrix()[..., -1, :, :]
            held = tip @ grasp.place.as_matrix()
            omega, speed = np.split(np.matvec(self.jacobian(q), as_floats("qd", qd, (), batched=True)), 2, axis=-1)
            # A free joint has its linear velocity in the world's frame, its angular velocity in the body's.
            velocities[..., grasp.qvel : grasp.qvel + 3] = speed + np.cross(omega, (held - tip)[..., :3, 3])
            velocities[..., grasp.qvel + 3 : grasp.qvel + 6] = np.vecmat(omega, held[..., :3, :3])
        return velocities

    def unit_rates(self, q: ArrayLike | None = None) -> Floats:
        """Velocities ``(..., nv, n)`` of all that moves at unit rates of the coordinates at ``q`` ``(..., n)``.

        Without ``q``, they are those at any configuration (`tangent_basis`), or at home if there are closed loops.
        """
        if q is None and self.dependents is None:
            return tangent_basis(self.space)
        at = self.keyframe("home") if q is None else as_floats("q", q, (self.n_joints,), batched=True)
        return np.swapaxes(self.qvel(at[..., None, :], np.eye(self.n_joints)), -1, -2)

    def moving(self, qpos: Floats) -> Floats:
        """`unit_rates` ``(nv, n)`` without what is carried; with closed loops ``(K, nv, n)``, at ``(K, nq)``."""
        unit, tied = tangent_basis(self.space), self.dependents
        return unit if tied is None else tied.basis(qpos) @ unit[tied.dofs]

    def holding(self, body: str, touching: Sequence[str] = (), *, tied: bool = False) -> Self:
        """This view of a model, with a free body that its end effector carries from its place in ``home`` on.

        The body moves with the end effector, and may touch what carries it. It keeps the clearance from all else,
        except that it may touch, but not sink deeper into, what is nearer than the clearance now, such as its support.

        Args:
            body: name of a body with a free joint.
            touching: names of bodies that it may touch as well, such as those it is put on.
            tied: whether something else fixes it to the hand; then it may be anywhere.

        Raises:
            InputError: the arm is no view, or no such body is at the hand: up to 0.1 m or a tenth of its reach away.
        """
        return replace(self, grasp=find_grasp(self, self._require_view(), body, touching, self.clearance, tied))

    def check_reachable(self, q: ArrayLike | str, what: str = "q") -> Floats:
        """Return ``q`` as `check_position` does, or raise `InputError` if contact is nearer than `clearance`."""
        position = self.check_position(q, what)
        touching = self.near_contacts(position)
        if touching:
            loose = self._free_bodies()
            first, second = next((pair for pair in touching if loose.intersection(pair)), touching[0])
            hint = self._if_held(self.qpos(position))
            depth = -1e3 * self._finder(self.clearance).geoms(self.qpos(position))[0].min()
            if not hint and depth <= 0.0:
                near = f"nearer than the clearance of {1e3 * self.clearance:g} mm"
                hint = f", or come {near}, which dataclasses.replace(arm, clearance=...) sets"
            elif not hint:
                out = f"; motions lead out of contact from {1e3 * self.start_tolerance:g} mm deep at most: "
                out += "bring the arm out, or allow more by dataclasses.replace(arm, start_tolerance=...)"
                hint = f", {depth:.4g} mm deep" + out * (what == "start")
            raise InputError(f"{what} is out of reach: {first!r} would touch {second!r} there{hint}")
        return position

    def contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that touch each other at ``q`` ``(n,)``."""
        return self._finder(0.0).bodies(self.qpos(as_floats("q", q, (self.n_joints,))))

    def near_contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of the bodies that are closer than the arm's `clearance` to each other at ``q`` ``(n,)``."""
        return self._finder(self.clearance).bodies(self.qpos(as_floats("q", q, (self.n_joints,))))

    def near_contacts_along(self, q: Floats) -> Iterator[list[tuple[str, str]]]:
        """`near_contacts` at each of the configurations ``(K, n)``, lazily; the conversion to qpos is done at once.

        Where loops cannot be closed, two of their bodies count as near.
        """
        rows = self.qpos(q, strict=False)
        if self.dependents is None or not np.isnan(rows).any():
            return map(self._finder(self.clearance).bodies, rows)
        joints = self.dependents.moved
        torn = [tuple(self.model.body(self.model.jnt_bodyid[joint]).name for joint in (joints[0], joints[-1]))]
        return (torn if np.isnan(row).any() else self._finder(self.clearance).bodies(row) for row in rows)

    @property
    def without_visuals(self) -> Self:
        """This arm without its visual geoms: it moves exactly as this one does, to the last bit, at half the cost.

        The arm itself is returned where its motion depends on them, or its model was changed after it was compiled.
        """
        if self.spec is None or self.grasp is not None:
            return self
        return self._bare if moves_alike(self._bare.model, self.model) else self

    @cached_property
    def _bare(self) -> Self:
        spec, model = discard_visuals(self)
        return replace(self, spec=spec, model=model, recipe=())

    @weakly_cached
    def _finder(self, margin: float) -> ContactFinder:
        return self.without_visuals.contact_finder(margin)
