"""Import robots of others, plan to random targets, and follow the plans: a line for each robot.

    python scripts/real_robots.py FOLDER... [--robots NAME,...] [--targets 10] [--output results/robots]

The folders hold the models, such as checkouts of MuJoCo Menagerie and of ROS packages. Those of `ROBOTS` that are in
none are left out; `--robots` also takes other files. Writes a JSON file for each robot, so that interrupted runs can be
continued, and a table of all of them, `robots.md`. Seconds are CPU time.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
from robot_reports import wrong_in_report

from lieednn_sim import filesystem, storage
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.arm.importer.loading import load_spec
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.metrics import Evaluation, evaluate
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import simulate

# Of MuJoCo Menagerie, then URDFs with meshes of ROS packages; with the base or links of one arm where there are two.
ROBOTS: dict[str, dict[str, Any]] = {
    "franka_emika_panda/panda.xml": {},
    "franka_fr3/fr3.xml": {},
    "universal_robots_ur5e/ur5e.xml": {},
    "universal_robots_ur10e/ur10e.xml": {},
    "kuka_iiwa_14/iiwa14.xml": {},
    "kinova_gen3/gen3.xml": {},
    "ufactory_xarm7/xarm7.xml": {},
    "ufactory_lite6/lite6.xml": {},
    "rethink_robotics_sawyer/sawyer.xml": {},
    "unitree_z1/z1_gripper.xml": {},
    "trossen_vx300s/vx300s.xml": {},
    "trs_so_arm100/so_arm100.xml": {},
    "robotstudio_so101/so101.xml": {},
    "boston_dynamics_spot/spot_arm.xml": {},
    "hello_robot_stretch/stretch.xml": {},
    "hello_robot_stretch_3/stretch.xml": {},
    "pal_tiago/tiago_position.xml": {},
    "google_robot/robot.xml": {},
    "aloha/aloha.xml": {"base": "left/base_link"},
    "flexiv_rizon4/flexiv_rizon4.xml": {},
    "i2rt_yam/yam.xml": {},
    "agilex_piper/piper.xml": {},
    "arx_l5/arx_l5.xml": {},
    "low_cost_robot_arm/low_cost_robot_arm.xml": {},
    # Of Gepetto's example-robot-data.
    "panda_description/urdf/panda.urdf": {},
    "ur_description/urdf/ur10_robot.urdf": {},
    "tiago_description/robots/tiago.urdf": {},
    "tiago_pro_description/robots/tiago_pro.urdf": {"links": [f"arm_left_{k}_link" for k in range(1, 8)]},
    "talos_data/robots/talos_full_v2.urdf": {"links": [f"arm_left_{k}_link" for k in range(1, 8)]},
    "talos_data/robots/talos_left_arm.urdf": {},
    "bravo7_description/urdf/bravo7_gripper.urdf": {},
    "kinova_description/robots/kinova.urdf": {},
    # Made by xacro, of the packages of Franka and Universal Robots.
    "franka_description/fr3.urdf": {},
    "ur_description/ur10e.urdf": {},
    # Of VAMP.
    "fetch/fetch.urdf": {},
}
PLANNERS = ("lieednn-certified", "minimum-jerk")
CONTROLLERS = ("position-servo", "inverse-dynamics")
_EVERY = 20  # every 20th sample of a motion is checked in the original model
_POSTURES = 100  # at which the forward map is compared


def try_robot(file: Path, options: dict[str, Any], targets: int) -> dict[str, Any]:
    """The results for a robot: a row of the table, with details."""
    begun = time.process_time()
    row: dict[str, Any] = {}
    try:
        arm = Arm.load(file, **options)
    except LieEDNNError as error:
        return row | {"failures": [f"load: {error}"]}
    assert arm.import_report is not None
    original = _Original(arm, file)
    row |= {"links": arm.n_links, "joints": arm.n_joints, "load_s": time.process_time() - begun}
    report = str(arm.import_report).splitlines()
    row |= {"forward_map_m": original.forward_error(), "report": report, "wrong": original.wrong(file)}
    made: dict[str, list[float]] = {planner: [] for planner in PLANNERS}
    arrived, failures = dict.fromkeys(CONTROLLERS, 0), list[str]()
    unexplained: list[str] = []
    deepest = 0.0
    for seed in range(targets):
        try:
            target = draw_target(arm, seed)
        except LieEDNNError as error:
            failures.append(f"target {seed}: {error}")
            continue
        for planner in PLANNERS:
            try:
                found = plan(arm, target, planner=planner, seed=seed)
            except LieEDNNError as error:
                failures.append(f"{planner} {seed}: {error}")
                unexplained += _unexplained_plan(f"{planner} {seed}", str(error), report)
                continue
            made[planner].append(found.cpu_time)
            deepest = max(deepest, original.penetration(found.motion))
            if planner != PLANNERS[0]:
                continue
            for controller in CONTROLLERS:
                try:
                    evaluation = evaluate(simulate(arm, found, controller=controller), clearance=False)
                except LieEDNNError as error:
                    failures.append(f"{controller} {seed}: {error}")
                    unexplained.append(failures[-1])
                    continue
                if not evaluation.shortfall:
                    arrived[controller] += 1
                else:
                    failures.append(f"{controller} {seed}: {evaluation.shortfall}; {'; '.join(evaluation.causes[:2])}")
                    unexplained += _unexplained_error(f"{controller} {seed}", evaluation, report)
    row |= {f"plans {planner}": len(times) for planner, times in made.items()}
    row |= {f"planning_s {planner}": float(np.median(times)) if times else None for planner, times in made.items()}
    row |= {"targets": targets, "penetration_mm": 1e3 * deepest, "failures": failures, "unexplained": unexplained}
    row |= arrived
    return row | {"seconds": time.process_time() - begun}


def _unexplained_plan(name: str, failure: str, report: list[str]) -> list[str]:
    """Bodies in contact in a failed plan that the import report does not mention."""
    pair = re.search(r"'([^']+)' would come within 2 mm of '([^']+)'", failure)
    fast = re.search(r"joint '([^']+)' would (?:move|accelerate) at .*, its limit is ([0-9.e+-]+)", failure)
    limits = [line for line in report if "velocity limits" in line or "acceleration limits" in line]
    if fast and any(f"{fast[1]} {fast[2]}" in line for line in limits):
        return []
    if pair is None:
        return [f"{name}: {failure}"]
    ways = [line for line in report if "straight ways from home" in line or "random postures" in line]
    known = any({*pair.groups()} == {*both} for line in ways for both in re.findall(r"'([^']+)' and '([^']+)'", line))
    return [] if known else [f"{name}: {pair.group()}"]


def _unexplained_error(name: str, evaluation: Evaluation, report: list[str]) -> list[str]:
    """Joints that keep an arm from arriving, by friction, load or slow servos, that the report does not mention."""
    told = [line.removeprefix("note: ") for line in report]
    words = {"dry friction": "dry friction", "load of": "sags", "slow": "slow", "force limit": "force"}
    lines = []
    for cause in evaluation.causes:
        joint = re.match(r"joint '([^']+)' ends", cause)
        kinds = [kind for said, kind in words.items() if said in cause]
        if joint and not any(line.startswith(f"{joint[1]}: ") and kind in line for kind in kinds for line in told):
            lines.append(f"{name}: {cause}")
    return lines if evaluation.causes else [f"{name}: {evaluation.shortfall}"]


class _Original:
    """The original model, with the arm's joints as in the arm and all others as at home."""

    def __init__(self, arm: Arm, file: Path) -> None:
        self._arm = arm
        spec = load_spec(file)
        for body in spec.bodies:
            # Of no account here, and in many a URDF such that MuJoCo refuses them.
            if np.isfinite(body.fullinertia).all():
                body.fullinertia = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
        self._model = spec.compile()
        self._finder = ContactFinder(self._model)
        report = arm.import_report
        assert report is not None
        name = report.posture.removeprefix("keyframe ").strip("'")
        keys = [self._model.key(k).name or f"key{k}" for k in range(self._model.nkey)]
        self._qpos = (self._model.key_qpos[keys.index(name)] if name in keys else self._model.qpos0).copy()
        self._addresses = []
        for joint in range(arm.model.njnt):
            here, there = arm.model.jnt_qposadr[joint], self._model.joint(arm.model.joint(joint).name).qposadr[0]
            width = 4 if arm.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL else 1
            self._addresses += [(int(there) + k, int(here) + k) for k in range(width)]
        self._frames = [self._model.body(link).id for link in report.links]
        ignored = {int(signature) for signature in arm.model.exclude_signature}
        names = [self._model.body(body).name for body in range(self._model.nbody)]
        self._body = {name: arm.model.body(name).id for name in names}
        self._names, self._ignored = names, ignored
        # What is locked together, such as the fingers of a closed gripper, touches at any posture or at none.
        self._part = arm.model.body_weldid

    def forward_error(self) -> float:
        """Largest distance of the links' origins between the arm's forward map and the original model [m]."""
        data, worst = mujoco.MjData(self._model), 0.0
        low, high = self._arm.position_limits.T
        for q in np.random.default_rng(0).uniform(low, high, (_POSTURES, len(low))):
            data.qpos[:] = self._placed(self._arm.qpos(q))
            mujoco.mj_kinematics(self._model, data)
            away = self._arm.link_poses(q).translation - data.xpos[self._frames]
            worst = max(worst, float(np.abs(away).max()))
        return worst

    def wrong(self, file: Path) -> list[str]:
        """Wrong statements of the report."""
        return wrong_in_report(self._arm, self._model, self._qpos, file)

    def penetration(self, motion: Motion) -> float:
        """Deepest penetration on the way in the original model, without contacts that the report ignores [m]."""
        deepest = 0.0
        for qpos in self._arm.qpos(motion.q[::_EVERY]):
            for distance, geoms in zip(*self._finder.geoms(self._placed(qpos)), strict=True):
                one, other = sorted(self._body[self._names[body]] for body in self._model.geom_bodyid[geoms])
                if (one << 16) + other not in self._ignored and self._part[one] != self._part[other]:
                    deepest = max(deepest, -float(distance))
        return deepest

    def _placed(self, qpos: np.ndarray) -> np.ndarray:
        placed = self._qpos.copy()
        for there, here in self._addresses:
            placed[there] = qpos[here]
        return placed


def as_markdown(rows: list[dict[str, Any]], folder: str) -> str:
    """The table, and the import reports' remarks on each robot with a failure."""
    heads = ["robot", "links", "joints", "report right", "forward map [m]", *PLANNERS, *CONTROLLERS]
    heads += ["deepest [mm]", "times minimum jerk's", "failures not in the report", "seconds"]
    lines = [f"Models: {folder}", "", f"| {' | '.join(heads)} |", "| --- |" + " ---: |" * (len(heads) - 1)]
    for row in rows:
        if "links" not in row:
            lines.append(f"| {row['robot']} | not loaded |" + " |" * (len(heads) - 2))
            continue
        counts = [f"{row[name]} of {row['targets']}" for name in (*(f"plans {p}" for p in PLANNERS), *CONTROLLERS)]
        right = "yes" if not row["wrong"] else f"{len(row['wrong'])} wrong"
        cells = [row["robot"], row["links"], row["joints"], right, f"{row['forward_map_m']:.1e}", *counts]
        times = [row[f"planning_s {planner}"] for planner in PLANNERS]
        ratio = f"{times[0] / times[1]:.1f}" if all(times) else "-"
        cells += [f"{row['penetration_mm']:.2g}", ratio, len(row["unexplained"]), f"{row['seconds']:.0f}"]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    lines += [
        "",
        "Plans are from home to random targets, then followed; a controller counts where every link ends within 1 mm "
        "and 0.1 degrees. Report right: joints, ranges, limits of force, velocity and acceleration, gains, dry "
        "friction and ignored contacts, held against the model by `scripts/robot_reports.py`. Deepest: how deep any "
        "plan is in anything in the model as it came, but for the contacts that the report names as ignored. Times: "
        "median CPU time of planning with the first planner over that of minimum jerk. Not in the report: failures "
        "whose bodies or joints the report did not name before planning. Seconds: CPU time.",
    ]
    for row in rows:
        for what, found in (("The report is wrong", row.get("wrong")), ("Not in the report", row.get("unexplained"))):
            if found:
                lines += ["", f"## {row['robot']}: {what.lower()}", "", *(f"- {line}" for line in found)]
        if row["failures"]:
            lines += ["", f"## {row['robot']}", "", *(f"- {failure}" for failure in row["failures"])]
            notes = [line for line in row.get("report", []) if line.startswith("note: ")]
            lines += ["", "The report before planning:", "", *(f"- {note}" for note in notes)]
    return "\n".join(lines) + "\n"


def main(words: list[str] | None = None) -> None:
    """Try the robots that are not done yet; the table is written after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--robots", default="", help="files in the folders, by default those of ROBOTS")
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--models", default="", help="what the models are, for the table: a name and a commit")
    parser.add_argument("--output", type=Path, default=Path("results/robots"))
    arguments = parser.parse_args(words)
    files = arguments.robots.split(",") if arguments.robots else list(ROBOTS)
    arguments.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in files:
        file = next((folder / name for folder in arguments.folders if (folder / name).is_file()), None)
        if file is None:
            print(f"{name}: not there")
            continue
        path = arguments.output / f"{file.parent.name}_{file.stem}.json"
        if not path.is_file():
            storage.save_json(path, try_robot(file, ROBOTS.get(name, {}), arguments.targets))
        rows.append(json.loads(path.read_text()) | {"robot": f"{Path(name).parts[0]}/{file.stem}"})
        with filesystem.atomic_text(arguments.output / "robots.md") as stream:
            stream.write(as_markdown(rows, arguments.models or ", ".join(folder.name for folder in arguments.folders)))
        print(f"{name}: done", flush=True)


if __name__ == "__main__":
    main()
