"""`import_model`: the arm of a file, read as it stands, with a short list of additions to its spec."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm.checks import ancestry
from lieednn_sim.arm.frames import chosen_joints, joint_groups, named_frames
from lieednn_sim.arm.importer import mending
from lieednn_sim.arm.importer.floor import AUTO, add_floor, as_floor
from lieednn_sim.arm.importer.home import choose_home, give_controls, move_inside, take_controls
from lieednn_sim.arm.importer.loading import compile_spec, load_spec
from lieednn_sim.arm.importer.overlaps import ignore_overlaps
from lieednn_sim.arm.importer.remarks import draw, facts, remarks
from lieednn_sim.arm.importer.report import Coupling, ImportOptions, ImportReport, Servo
from lieednn_sim.arm.importer.serial_chain import choose_chain
from lieednn_sim.arm.importer.servos import SERVOS, add_servos, describe_servos
from lieednn_sim.arm.limits import RATES
from lieednn_sim.arm.model_arm import ModelArm
from lieednn_sim.arm.oscillation import PassiveJoints
from lieednn_sim.arm.view import View, read_view
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.validation import as_choice
from lieednn_sim.values import Floats


def import_model(
    model: Path | mujoco.MjSpec, source: Path, name: str, **options: Unpack[ImportOptions]
) -> tuple[ModelArm, ImportReport]:
    """An arm of an MJCF or URDF model, as a view (`Arm.of`) in which everything else stays, and a report.

    Without ``links``, ``joints`` and ``tip`` the arm is the chain with the most driven joints
    (`serial_chain.longest_chain`). It is cut into compound joints (`compound_joints.cut`), with its link frames at the
    origins of the bodies behind the cuts. `docs/howto/own_arm.md` lists what is added to it, and the report says it. A
    given spec is not changed; ``source`` is its file. For the options see `ImportOptions`, for errors `Arm.from_xml`.
    """
    given: dict[str, Any] = {what: value for what, value in options.items() if value is not None}
    rule = as_choice("choice of servos", given.get("servos", "keep"), SERVOS)
    overlaps = as_choice("choice of overlaps", given.get("overlaps", "ignore"), ("ignore", "keep"))
    floor = as_floor(given.get("floor", AUTO))
    notes: list[str] = []
    spec = load_spec(model, notes)
    joints = mending.read_joints(source, notes)
    mending.mend_joints(spec, joints, notes)
    if source.suffix.lower() == ".urdf":
        mending.mend_inertias(spec, notes)
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_RK4:  # which an arm must not have, see `parsing.read_arm`
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        notes.append("integrator implicitfast in place of RK4, which has no inverse dynamics in discrete time")
    compiled = compile_spec(spec)
    label, keyframe, qpos = choose_home(spec, compiled, given.get("keyframe"), given.get("home", {}), notes)
    # MuJoCo makes three joints of a planar one, without ranges.
    planar = [joint for joint, element in joints.items() if element.get("type") == "planar"]
    parts = {f"{joint}_{motion}": joint for joint in planar for motion in ("TX", "TY", "RZ")}
    named = choose_chain(compiled, qpos, options, parts, notes)
    if "links" in named:
        chain, *_ = joint_groups(compiled, named_frames(compiled, named["links"], named.get("base")))
    else:
        chain = tuple(chosen_joints(compiled, named["joints"]))
    first = min(map(int, compiled.jnt_bodyid[[*chain]]), key=lambda body: len(ancestry(compiled, body)))
    qpos = mending.fix_base(spec, compiled, first, qpos, notes)

    def viewed() -> ModelArm:
        now = compile_spec(spec)
        return ModelArm.viewing(now, kinematics_at(now, qpos), named, name=name, source=source, spec=spec)

    if len(qpos) < compiled.nq:
        compiled = compile_spec(spec)
    view = read_view(compiled, kinematics_at(compiled, qpos), name=name, **named)
    mending.tie_stages(spec, compiled, view.couplings, notes)
    named["limits"] = _limits(view, compiled, joints, given.get("limits", {}), notes)
    arm = viewed()
    home, samples = move_inside(arm, notes), draw(arm, 64, seed=0)
    if overlaps == "ignore":
        home = ignore_overlaps(spec, arm, home, samples, notes)
    qpos = arm.qpos(home)
    arm = viewed()
    add_floor(spec, arm, floor, notes)
    commands = take_controls(spec)
    added = add_servos(spec, arm, _closed(arm, home, samples), rule, notes)
    give_controls(spec, compile_spec(spec), keyframe, qpos, commands)
    arm = viewed()
    servos = tuple(describe_servos(arm, _closed(arm, home, samples), added))
    report = _report(arm, view, label, servos, notes)
    try:
        modes = PassiveJoints(arm).modes(home)
    except NoSolutionError as error:
        modes = ()
        notes.append(str(error))
    found = tuple(remarks(arm, report.groups, servos, samples))
    return arm, replace(report, notes=(*notes, *arm.notes, *facts(arm), *found), modes=modes, remarks=found)


def _closed(arm: ModelArm, home: Floats, samples: Floats) -> Floats:
    """Positions ``(S, nq)`` at home and at those configurations at which all loops can be closed."""
    rows = arm.qpos(np.vstack([home, samples]), strict=False)
    return rows[~np.isnan(rows).any(axis=1)]


def _limits(
    view: View, model: Any, joints: mending.Joints, given: Mapping[str, Mapping[str, float]], notes: list[str]
) -> dict[str, dict[str, float]]:
    """Limits of rates by coordinate: the given ones, or those of a URDF for all joints that it moves."""
    space, limits = view.fields["space"], dict[str, dict[str, float]]()
    for rate, per in zip(RATES, ("", "^2", "^3"), strict=True):
        most = np.full(len(space), np.inf)
        for name, limit in mending.rate_limits(joints, rate, notes).items():
            joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
            slopes = np.abs(space.rates[model.jnt_dofadr[joint]]) if joint >= 0 else np.zeros(len(space))
            most = np.minimum(most, np.divide(limit, slopes, out=np.full(len(space), np.inf), where=slopes > 0.0))
        if np.isfinite(most).any():
            shown = ", ".join(map("{} {:.3g}".format, space.names, most)).replace(" inf", " none")
            notes.append(f"{rate} limits of the URDF [rad/s{per}, m/s{per}]: {shown}")
        for name, value in zip(space.names, most, strict=True):
            limits.setdefault(name, {}).update({rate: float(value)} if np.isfinite(value) else {})
    return {name: {**limits.get(name, {}), **given.get(name, {})} for name in {**limits, **given}}


def _report(arm: ModelArm, view: View, label: str, servos: tuple[Servo, ...], notes: list[str]) -> ImportReport:
    model = arm.model
    names = [model.joint(joint).name for joint in range(model.njnt)]
    mine = {int(model.dof_jntid[dof]) for dof in arm.dofs}
    ties = {follower: f"tendon {model.tendon(tendon).name!r}" for follower, tendon in view.couplings.added.items()}
    couplings = tuple(
        Coupling(names[follower], names[leader], ratio, shift, ties.get(follower, "equality"))
        for follower, (leader, ratio, shift) in view.couplings.lines.items()
    )
    return ImportReport(
        configuration=label,
        base=view.chain.frames[0].name,
        links=tuple(frame.name for frame in view.chain.frames[1:]),
        groups=tuple(tuple(names[joint] for joint in group) for group in view.chain.groups),
        couplings=couplings,
        others=tuple(name for joint, name in enumerate(names) if joint not in mine),
        servos=servos,
        notes=tuple(notes),
    )
