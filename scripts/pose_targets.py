"""Plan to random reachable poses of arms, and to the joint positions that they were drawn from: a row for each arm.

    python scripts/pose_targets.py [ARM ...] [--poses 100] [--output results/pose_targets.md]

An arm is a name of the package or a path of a model; by default the package's three. A pose is that of the end effector
at a random target. Errors are those of the last sample of the motion. Seconds are CPU time.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from lieednn_sim import io
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.planning import plan
from lieednn_sim.studies.markdown import table_head, table_line

HEADINGS = (
    *("arm", "poses", "planned as poses", "planned as joint targets", "only as joint targets"),
    *("largest error [mm]", "largest error [deg]", "median time [s]", "longest time [s]"),
)


def try_arm(name: str, poses: int) -> list[Any]:
    """The row of an arm."""
    arm = Arm.load(name)
    planned, of_joints, lost = 0, 0, list[int]()
    errors, times = [(0.0, 0.0)], [np.nan]
    for seed in range(poses):
        target = draw_target(arm, seed)
        pose = arm.link_poses(target)[-1]
        try:
            plan(arm, target, seed=seed)
            as_joints = True
        except LieEDNNError:
            as_joints = False
        of_joints += as_joints
        try:
            found = plan(arm, pose, seed=seed)
        except LieEDNNError as error:
            print(f"{arm.name}, pose {seed}: {error}", flush=True)
            lost += [seed] if as_joints else []
            continue
        planned += 1
        missed = pose.inv() * arm.link_poses(found.motion.q[-1])[-1]
        errors.append((1e3 * float(np.linalg.norm(missed.translation)), float(np.rad2deg(missed.rotation.magnitude()))))
        times.append(found.cpu_time)
    far, turned = np.max(errors, axis=0)
    only = ", ".join(f"pose {seed}" for seed in lost) or "none"
    return [
        *(arm.name, poses, planned, of_joints, only),
        *(f"{far:.1g}", f"{turned:.1g}", f"{np.nanmedian(times):.2f}", f"{np.nanmax(times):.2f}"),
    ]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("arms", nargs="*", metavar="ARM", default=list(arm_names()))
    parser.add_argument("--poses", type=int, default=100, help="poses of each arm (default: %(default)s)")
    parser.add_argument("--output", default="results/pose_targets.md", help="file (default: %(default)s)")
    options = parser.parse_args(arguments)
    rows = []
    for name in options.arms:
        rows.append(try_arm(name, options.poses))
        print(rows[-1], flush=True)
    lines = [table_line([str(cell) for cell in row]) for row in rows]
    with io.atomic_text(options.output) as stream:
        stream.write("\n".join(["# Poses as targets", "", *table_head(HEADINGS), *lines]) + "\n")


if __name__ == "__main__":
    main()
