"""Configurations of the arm: home, those at which limits and servos are designed and checked, and its keyframes."""

from __future__ import annotations

import numpy as np
import scipy

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer.draft import Draft
from lieednn_sim.arm.importer.loading import compile_spec
from lieednn_sim.values import Floats

_SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
MARGIN = 0.05  # fraction of its range that a keyframe keeps away from each limit


def draw_configurations(draft: Draft) -> None:
    """Compile the arm without actuators; choose home, random configurations with a fixed seed, and extremes."""
    draft.bare = compile_spec(draft.spec)
    draft.dofs = draft.dofs_of(draft.bare)
    home, moved = _coordinates_inside(draft, draft.qpos)
    draft.notes += [f"{name}: moved off its limits in the keyframe 'home'" for name in moved]
    rng = np.random.default_rng(0)
    samples = 64  # random configurations for which servos are designed and checked
    draft.samples = [home, *(random_coordinates(draft, rng) for _ in range(samples))]
    place_home(draft, home)


def place_home(draft: Draft, home: dict[int, Floats]) -> None:
    """Make other positions of the independent joints home."""
    draft.samples[0] = home
    kinds, ranges = draft.original.jnt_type, draft.ranges
    draft.extremes = [
        {joint: ranges[joint][[end]] if kinds[joint] == _SLIDE else q for joint, q in home.items()} for end in (0, 1)
    ]


def add_keyframes(draft: Draft) -> None:
    """Add ``home`` and the model's own keyframes, at rest, as the keyframes of the arm; compile it."""
    keyframes, original = {"home": draft.samples[0]}, draft.original
    for k in draft.keyframes:
        if np.isfinite(original.key_qpos[k]).all():
            inside, _ = _coordinates_inside(draft, original.key_qpos[k])
            keyframes.setdefault(original.key(k).name or f"key{k}", inside)
    for name, q in keyframes.items():
        (qpos,) = draft.configurations([q])
        draft.spec.add_key(name=name, qpos=qpos, ctrl=np.concatenate([q[joint] for joint in draft.independent]))
    draft.model = compile_spec(draft.spec)


def random_coordinates(draft: Draft, rng: np.random.Generator) -> dict[int, Floats]:
    """Positions of the independent joints, uniform within their ranges (a ball joint: axis and angle)."""
    q = {}
    for joint in draft.independent:
        low, high = draft.ranges[joint]
        value = rng.uniform(low, high, size=1)
        if draft.is_ball(joint):
            axis = rng.normal(size=3)
            value = value * axis / np.linalg.norm(axis)
        q[joint] = value
    return q


def _coordinates_inside(draft: Draft, qpos: Floats) -> tuple[dict[int, Floats], list[str]]:
    """Positions of the independent joints at ``qpos``, each kept 5 % of its range off its limits; names of those moved.

    For stages that only a tendon couples, the leader takes the least-squares fit of all their positions.
    """
    q, moved = {}, []
    model, couplings = draft.original, draft.couplings
    for joint in draft.independent:
        low, high = draft.ranges[joint]
        address = model.jnt_qposadr[joint]
        if draft.is_ball(joint):
            turn = scipy.spatial.transform.Rotation.from_quat(qpos[address : address + 4], scalar_first=True)
            given = turn.as_rotvec()
            angle = float(np.linalg.norm(given))
            value = given * min(1.0, (1.0 - MARGIN) * high / angle) if angle else given
        else:
            stages = [(1.0, 0.0, float(qpos[address]))]
            for follower in couplings.added:
                leader, ratio, shift = couplings.lines[follower]
                if leader == joint:
                    stages.append((ratio, shift, float(qpos[model.jnt_qposadr[follower]])))
            given = np.array([sum(r * (x - s) for r, s, x in stages) / sum(r * r for r, _, _ in stages)])
            margin = MARGIN * (high - low)
            value = np.clip(given, low + margin, high - margin)
        if not np.allclose(value, given, atol=1e-9):
            moved.append(model.joint(joint).name)
        q[joint] = value
    return q, moved
