"""Remarks on an imported arm that a user should look at: half turns, shapes, contacts, servos, singular links."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from lieednn_sim.arm.contacts import PLANNED_CLEARANCE, colliding_geoms
from lieednn_sim.arm.forces import disabled_actuators, dry_friction, required_forces
from lieednn_sim.arm.importer.report import Servo
from lieednn_sim.arm.kinematics import least_singular_value
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.step_stability import step_remedy
from lieednn_sim.arm.surroundings import moved_together
from lieednn_sim.values import Floats

_OFF = 3e-4  # worth a remark [rad, m]: over a few joints, a millimetre at an arm's length
_PATHS, _LOOKS = 256, 20  # straight paths, and configurations on each
_SHOWN = 4  # pairs of bodies in a remark
_MANY_TURNS = 4.0  # of a hinge with limits
_SLOW = 5.0  # a slower servo is worth a remark [Hz]
# Least singular value of a link's screws, of unit size, at which its pose still determines its joints; at the larger
# `singularities.NEARLY_SINGULAR` paths begin to be straightened.
_SINGULAR = 0.1


def facts(arm: ModelArm) -> Iterator[str]:
    """An arm's unit of length and its acceleration limits, in words."""
    if arm.length_scale != 1.0:
        yield f"unit of length in the network's coordinates: {arm.length_scale:g} m, the furthest that a link moves"
    limits = zip(arm.joint_names, arm.acceleration_limits, strict=True)
    if shown := ", ".join(f"{name} {limit:.3g}" for name, limit in limits if np.isfinite(limit)):
        yield f"acceleration limits [rad/s^2, m/s^2]: {shown}"


def remarks(arm: ModelArm, groups: Sequence[Sequence[str]], servos: Sequence[Servo], samples: Floats) -> Iterator[str]:
    """Remarks on an arm: what moves each link, what drives each coordinate, and random configurations ``(S, n)``."""
    home = arm.keyframe("home")
    if len(groups) == 1:
        yield "the arm is one link; networks of a single neuron are hard to certify: name more links"
    turns = zip(arm.joint_names, arm.ranges, arm.continuous, strict=True)
    for joint, (name, span, endless) in enumerate(turns):
        if arm.unit(joint) == "rad" and span > _MANY_TURNS * 2.0 * np.pi and not endless:
            yield f"{name} may turn {span / (2.0 * np.pi):.3g} times about: are its limits in degrees?"
        elif arm.unit(joint) == "rad" and span < np.deg2rad(2.0 * np.pi):  # a full turn in radians, read as degrees
            yield f"{name} may turn by {np.rad2deg(span):.3g} degrees: are its limits in radians, the file in degrees?"
        elif arm.unit(joint) == "m" and span > 10.0 * max(arm.model.stat.extent, 5.0):
            yield f"{name} may move by {span:.3g} m: are its limits in millimetres?"
    if (size := arm.model.stat.extent) > 200.0:  # [m]
        yield f"the model is {size:.3g} m large: are its lengths in millimetres?"
    turned = np.linalg.norm(arm.encode(np.vstack([home, samples]))[..., :3], axis=-1).max(axis=0)
    for i, (compound, turn) in enumerate(zip(arm.joints.joints, turned, strict=True), start=1):
        if len(groups[i - 1]) > 1 and turn > 0.95 * np.pi and compound.screw is None:
            why = f"link {i} may turn by {turn:.3g} rad against link {i - 1}"
            yield f"{why}; the logarithm is unique below pi: name more links"
    moving = moved_together(arm.model, arm.dofs)[arm.model.geom_bodyid] > 0
    if not moving.any():
        yield (
            "no moving body has a geom: the arm is invisible and touches nothing; of a URDF MuJoCo reads <collision>, "
            'and <visual> only with <mujoco><compiler discardvisual="false"/></mujoco> in <robot>'
        )
    elif not colliding_geoms(arm.model)[moving].any():
        yield "no geom of a moving body can collide: the arm passes through obstacles and through itself"
    yield from _drives(arm, servos, np.vstack([home, samples[:16]]))
    for first, second in arm.contacts(home):
        yield f"bodies {first!r} and {second!r} touch at home"
    yield from _straight_paths(arm, home)
    yield from _singular_links(arm, groups, home, samples)


def _drives(arm: ModelArm, servos: Sequence[Servo], q: Floats) -> Iterator[str]:
    """Actuators that are disabled; servos that stick, are slow, or too weak for their load at rest."""
    if (idle := disabled_actuators(arm.model)).any():
        disabled = ", ".join(arm.model.actuator(int(a)).name for a in np.flatnonzero(idle))
        yield f"actuators that the file disables, which neither drive nor hold: {disabled}"
    if unstable := step_remedy(arm.model, arm.qpos(q[0])):
        yield unstable
    basis = arm.unit_rates()
    loads = required_forces(arm.model, arm.qpos(q, strict=False), limited=True) @ basis
    frictions = dry_friction(arm.model, basis)
    design = "designed servos (servos='design', --servos design) or " if any(servo.kept for servo in servos) else ""
    if slow := ", ".join(f"{servo.name} {servo.frequency:.2g} Hz" for servo in servos if 0 < servo.frequency < _SLOW):
        yield f"servos too slow to follow motions well: {slow}; what helps: {design}the controller inverse-dynamics"
    held = [by / servo.kp if servo.kp else 0.0 for servo, by in zip(servos, frictions, strict=True)]
    if stuck := ", ".join(f"{servos[j].name} {arm.amount(j, off)}" for j, off in enumerate(held) if off > _OFF):
        yield f"dry friction may hold servos off by: {stuck}; what helps: {design}the controller inverse-dynamics"
    for servo, friction, load in zip(servos, frictions, loads.T, strict=True):
        limit = min(-servo.force_range[0], servo.force_range[1])
        if abs(load[0]) > limit + friction:
            yield f"{servo.name}: needs {load[0]:.4g} at home, more than its force limits allow"
        elif (weak := int((np.abs(load) > limit + friction).sum())) > 0:
            most = f"up to {np.abs(load).max():.4g}, its force limit is {limit:.4g}"
            yield f"{servo.name}: cannot hold its load at {weak} of {len(load) - 1} random configurations, {most}"


def _straight_paths(arm: ModelArm, home: Floats) -> Iterator[str]:
    """The bodies between which straight paths from home to random configurations come near contact."""
    found, counts = (Counter[str](), Counter[str]()), Counter[tuple[bool, bool]]()
    fractions = np.linspace(1.0, 0.0, _LOOKS, endpoint=False)
    ways = arm.qpos(home + fractions[:, None] * (draw(arm, _PATHS, seed=1)[:, None] - home), strict=False)
    finder = arm.without_visuals.contact_finder(PLANNED_CLEARANCE)
    for way, torn_at in zip(ways, np.asarray(np.isnan(ways).any(axis=-1)).tolist(), strict=True):
        for k, torn in enumerate(torn_at):
            close = [] if torn else finder.bodies(way[k])
            if torn or close:
                counts[k > 0, torn] += 1
                found[k > 0].update({"{!r} and {!r}".format(*sorted(pair)) for pair in close})
                break
    others = _PATHS - counts[False, False] - counts[False, True]
    search = "there planners fail that do not search for a way around, as lieednn-shaped and rrt-connect do"
    some, paths = f"{_PATHS} random configurations are", f"{others} straight paths from home to the others"
    for (between, torn), count in sorted(counts.items()):
        # Sets have no order: ties are broken by name.
        most = sorted(found[between].items(), key=lambda item: (-item[1], item[0]))
        shown = ", ".join(f"{pair} ({times})" for pair, times in most[:_SHOWN])
        shown += f" and {len(most) - _SHOWN} more" if len(most) > _SHOWN else ""
        what, then = (f"{paths} {'pass' if torn else 'come'}", search) if between else (some, "these cannot be targets")
        near = f"within {1e3 * PLANNED_CLEARANCE:g} mm of contact, between {shown}"
        yield f"{count} of {what} {'where closed loops stay open' if torn else near}: {then}"


def _singular_links(arm: ModelArm, groups: Sequence[Sequence[str]], home: Floats, samples: Floats) -> Iterator[str]:
    """Links of several joints whose pose does not determine the joints somewhere on a straight path."""
    fractions = np.linspace(0.0, 1.0, _LOOKS + 1)[:, None]
    paths = np.array([home + fractions * (sample - home) for sample in samples])
    scale = np.array([np.sqrt(0.5)] * 3 + [1.0 / arm.length_scale])  # of the columns of a rotation, and of a position
    for i, (compound, group) in enumerate(zip(arm.joints.joints, groups, strict=True), start=1):
        if len(compound.indices) < 2:
            continue
        frames, _ = compound.pose_and_slopes(paths.reshape(-1, arm.n_joints) - arm.joints.reference)
        columns = (frames[:, 1:] * scale).reshape(len(frames), -1, 12)
        jacobian = np.swapaxes(compound.selection(compound.indices) @ columns, -1, -2)
        near = least_singular_value(jacobian).reshape(paths.shape[:2]).min(axis=1) < _SINGULAR
        if near.any():
            yield (
                f"link {i}: {near.sum()} of {len(paths)} straight paths from home pass near configurations at which "
                f"its pose does not determine {', '.join(group)}; networks, which lead an arm by poses, leave a "
                "gap there, or fail: name more links to avoid that"
            )


def draw(arm: ModelArm, count: int, seed: int) -> Floats:
    """Random configurations ``(count, n)`` within the limits."""
    low, high = arm.position_limits.T
    return arm.within_angles(np.random.default_rng(seed).uniform(low, high, (count, arm.n_joints)))
