"""How closely planned motions keep a line, or an orientation, and how long planning takes.

A start is a random target of the arm, and the end effector goes from there into a random direction, by 0.1 to 0.4 m: on
a straight line, turned as it likes; or by any way, turned as at the start. Ways that the arm cannot follow in small
steps, because of its limits, its reach or contact, are drawn again.

    python scripts/kept_ways.py telescopic_pr telescopic_rrp telescopic_compound robot.xml --ways 20
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls
from lieednn_sim.budget import cpu_time
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.planning.kept import followed

KINDS = ("line", "orientation")
# Most ways drawn for one that the arm can follow.
_DRAWN = 40


def drawn(arm: ls.Arm, kind: str, seed: int) -> tuple[np.ndarray, ls.TaskSpaceRegion, ls.TaskSpaceRegion] | None:
    """The start, the goal and the region to keep; None if the arm cannot follow the way."""
    rng, start = np.random.default_rng(seed), ls.draw_target(arm, seed)
    here, way = arm.link_poses(start)[-1], rng.normal(size=3)
    there = here.translation + rng.uniform(0.1, 0.4) * way / np.linalg.norm(way)
    line = kind == "line"
    keep = ls.TaskSpaceRegion.line(here.translation, there) if line else ls.TaskSpaceRegion.orientation(here.rotation)
    goal = ls.TaskSpaceRegion.box(there, there)
    target = followed(arm, start, goal, keep)
    return None if target is None or arm.near_contacts(target) else (start, goal, keep)


def row(arm: ls.Arm, kind: str, ways: int) -> str:
    """A row of the table."""
    seed, tried, deviations, times = 0, 0, [], []
    while tried < ways and seed < _DRAWN * ways:
        seed += 1
        problem = drawn(arm, kind, seed)
        if problem is None:
            continue
        tried, begun = tried + 1, cpu_time()
        start, goal, keep = problem
        try:
            motion = ls.plan(arm, goal, start=start, keep=keep, seed=seed).motion
        except NoSolutionError as error:
            print(f"{arm.name}, {kind}, seed {seed}: {error}")
        else:
            times.append(cpu_time() - begun)
            ends = RigidTransform.from_matrix(arm.link_poses(motion.q).as_matrix()[:, -1])
            deviations.append(np.max(keep.distance(ends), axis=1))
    if not times:
        return f"| {arm.name} | {kind} | {seed} | {tried} | 0 | | | | |"
    distance, angle = np.max(deviations, axis=0)
    return (
        f"| {arm.name} | {kind} | {seed} | {tried} | {len(times)} | {1e3 * distance:.2g} | {np.rad2deg(angle):.2g} "
        f"| {np.median(times):.2f} | {np.max(times):.2f} |"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("arms", nargs="+", help="names of arms or model files")
    parser.add_argument("--ways", type=int, default=20, help="ways of each kind that the arm can follow")
    options = parser.parse_args(arguments)
    print("| arm | kept | drawn | can be followed | planned | off [mm] | off [degrees] | CPU [s], median | longest |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name in options.arms:
        for kind in KINDS:
            print(row(ls.Arm.load(name), kind, options.ways), flush=True)


if __name__ == "__main__":
    main()
