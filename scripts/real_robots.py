"""Import robots that nobody here wrote, plan to random targets, and follow the plans: one line a robot.

    python scripts/real_robots.py FOLDER [--robots NAME,...] [--targets 10] [--output results/robots]

FOLDER holds the models, such as a checkout of MuJoCo Menagerie; those of `ROBOTS` that are not there are left out, and
`--robots` takes any other file in it. One JSON file a robot, so that an interrupted run goes on where it was, and all
of them in `robots.md`.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from lieednn_sim import storage
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.arm.importer.loading import load_spec
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.evaluation.metrics import SETTLED_ROTATION, SETTLED_TRANSLATION, evaluate
from lieednn_sim.planning import plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.simulation import simulate

# Of MuJoCo Menagerie; with the base of one arm where there are two.
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
    "hello_robot_stretch_3/stretch.xml": {},
    "pal_tiago/tiago_position.xml": {},
    "google_robot/robot.xml": {},
    "aloha/aloha.xml": {"base": "left/base_link"},
    "flexiv_rizon4/flexiv_rizon4.xml": {},
    "i2rt_yam/yam.xml": {},
    "agilex_piper/piper.xml": {},
    "arx_l5/arx_l5.xml": {},
    "low_cost_robot_arm/low_cost_robot_arm.xml": {},
}
PLANNERS = ("lieednn-certified", "minimum-jerk")
CONTROLLERS = ("position-servo", "inverse-dynamics")
_EVERY = 20  # of a motion's samples one is looked at in the original model
_POSTURES = 100  # at which the forward map is compared


def try_robot(file: Path, options: dict[str, Any], targets: int) -> dict[str, Any]:
    """What comes of one robot, as a row of the table with what is behind it."""
    begun = time.perf_counter()
    row: dict[str, Any] = {"robot": f"{file.parent.name}/{file.stem}"}
    try:
        arm = Arm.load(file, **options)
    except LieEDNNError as error:
        return row | {"failures": [f"load: {error}"]}
    assert arm.import_report is not None
    original = _Original(arm, file)
    row |= {"links": arm.n_links, "joints": arm.n_joints, "load_s": time.perf_counter() - begun}
    row |= {"forward_map_m": original.forward_error(), "report": str(arm.import_report).splitlines()}
    made: dict[str, list[float]] = {planner: [] for planner in PLANNERS}
    arrived, failures = dict.fromkeys(CONTROLLERS, 0), []
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
                continue
            made[planner].append(found.cpu_time)
            deepest = max(deepest, original.penetration(found.motion))
            if planner != PLANNERS[0]:
                continue
            for controller in CONTROLLERS:
                try:
                    frame = evaluate(simulate(arm, found, controller=controller), clearance=False).end_effector
                except LieEDNNError as error:
                    failures.append(f"{controller} {seed}: {error}")
                    continue
                close = frame.final_mm <= 1e3 * SETTLED_TRANSLATION
                if close and frame.final_deg <= np.rad2deg(SETTLED_ROTATION):
                    arrived[controller] += 1
                else:
                    failures.append(f"{controller} {seed}: {frame.final_mm:.3g} mm, {frame.final_deg:.3g} degrees off")
    row |= {f"plans {planner}": len(times) for planner, times in made.items()}
    row |= {f"planning_s {planner}": float(np.median(times)) if times else None for planner, times in made.items()}
    row |= {"targets": targets, "penetration_mm": 1e3 * deepest, "failures": failures, **arrived}
    return row | {"seconds": time.perf_counter() - begun}


class _Original:
    """The model as it came, with the arm's joints where the arm has them and all else at its posture."""

    def __init__(self, arm: Arm, file: Path) -> None:
        self._arm = arm
        self._model = load_spec(file).compile()
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
        self._moving = arm.model.body_weldid != 0

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

    def penetration(self, motion: Motion) -> float:
        """How deep the arm is in anything in the original model on the way, but for what the report ignores [m]."""
        deepest = 0.0
        for qpos in self._arm.qpos(motion.q[::_EVERY]):
            for distance, geoms in zip(*self._finder.geoms(self._placed(qpos)), strict=True):
                one, other = sorted(self._body[self._names[body]] for body in self._model.geom_bodyid[geoms])
                if (one << 16) + other not in self._ignored and self._moving[[one, other]].any():
                    deepest = max(deepest, -float(distance))
        return deepest

    def _placed(self, qpos: np.ndarray) -> np.ndarray:
        placed = self._qpos.copy()
        for there, here in self._addresses:
            placed[there] = qpos[here]
        return placed


def as_markdown(rows: list[dict[str, Any]], folder: str) -> str:
    """The table, and what the reports said before planning of each robot with a failure."""
    heads = ["robot", "links", "joints", "forward map [m]", *PLANNERS, *CONTROLLERS, "deepest [mm]", "seconds"]
    lines = [f"Models: {folder}", "", f"| {' | '.join(heads)} |", "| --- |" + " ---: |" * (len(heads) - 1)]
    for row in rows:
        if "links" not in row:
            lines.append(f"| {row['robot']} | not loaded |" + " |" * (len(heads) - 2))
            continue
        counts = [f"{row[name]} of {row['targets']}" for name in (*(f"plans {p}" for p in PLANNERS), *CONTROLLERS)]
        cells = [row["robot"], row["links"], row["joints"], f"{row['forward_map_m']:.1e}", *counts]
        lines.append(f"| {' | '.join(map(str, cells))} | {row['penetration_mm']:.2g} | {row['seconds']:.0f} |")
    lines += [
        "",
        "Plans are from home to random targets, then followed; a controller counts where the end effector ends within "
        "1 mm and 0.1 degrees. Deepest: how deep any plan is in anything in the model as it came, but for the contacts "
        "that the report names as ignored.",
    ]
    for row in rows:
        if row["failures"]:
            lines += ["", f"## {row['robot']}", "", *(f"- {failure}" for failure in row["failures"])]
            notes = [line for line in row.get("report", []) if line.startswith("note: ")]
            lines += ["", "The report before planning:", "", *(f"- {note}" for note in notes)]
    return "\n".join(lines) + "\n"


def main(words: list[str] | None = None) -> None:
    """Try the robots of a folder that are not done yet; the table is written after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", default="", help="files in the folder, by default those of ROBOTS")
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--models", default="", help="what the models are, for the table: a name and a commit")
    parser.add_argument("--output", type=Path, default=Path("results/robots"))
    arguments = parser.parse_args(words)
    files = arguments.robots.split(",") if arguments.robots else list(ROBOTS)
    arguments.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in files:
        file = arguments.folder / name
        if not file.is_file():
            print(f"{name}: not there")
            continue
        path = arguments.output / f"{file.parent.name}_{file.stem}.json"
        if not path.is_file():
            storage.save_json(path, try_robot(file, ROBOTS.get(name, {}), arguments.targets))
        rows.append(json.loads(path.read_text()))
        with storage.atomic_text(arguments.output / "robots.md") as stream:
            stream.write(as_markdown(rows, arguments.models or arguments.folder.name))
        print(f"{name}: done", flush=True)


if __name__ == "__main__":
    main()
