"""How closely planned motions keep a line, or an orientation, and how long planning takes.

    python scripts/path_constraints.py telescopic_pr telescopic_rrp telescopic_compound robot.xml --ways 20

A start is a random target of the arm, and the end effector goes from there into a random direction, by 0.1 to 0.4 m: on
a straight line, turned as it likes; or by any way, turned as at the start. Ways that the arm cannot follow in small
steps, because of its limits, its reach or contact, are drawn again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from common import options
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls
from lieednn_sim.errors import NoSolutionError
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.planning.path_constraints import followed

HEADINGS = ("arm", "kept", "drawn", "can be followed", "planned", "off [mm]", "off [degrees]", "CPU [s]", "longest")
KINDS = ("line", "orientation")
# Most ways drawn for one that the arm can follow.
DRAWN = 40


def drawn(arm: ls.Arm, kind: str, seed: int) -> tuple[np.ndarray, ls.TaskSpaceRegion, ls.TaskSpaceRegion] | None:
    """The start, the goal and the region to keep; None if the arm cannot follow the way."""
    rng, start = np.random.default_rng(seed), ls.draw_target(arm, seed)
    here, way = arm.link_poses(start)[-1], rng.normal(size=3)
    there = here.translation + rng.uniform(0.1, 0.4) * way / np.linalg.norm(way)
    line = kind == "line"
    path_constraint = (
        ls.TaskSpaceRegion.line(here.translation, there) if line else ls.TaskSpaceRegion.orientation(here.rotation)
    )
    goal = ls.TaskSpaceRegion.box(there, there)
    target = followed(arm, start, goal, path_constraint)
    return None if target is None or arm.near_contacts(target) else (start, goal, path_constraint)


def row(arm: ls.Arm, kind: str, ways: int) -> list[Any]:
    """A row of the table."""
    seed, problems = 0, list[Any]()
    while len(problems) < ways and seed < DRAWN * ways:
        seed += 1
        problems += [(seed, problem) for problem in [drawn(arm, kind, seed)] if problem is not None]
    times, deviations = [np.nan], [np.zeros(2)]
    for number, (start, goal, path_constraint) in problems:
        try:
            plan = ls.plan(arm, goal, start=start, path_constraint=path_constraint, seed=number)
        except NoSolutionError as error:
            print(f"{arm.name}, {kind}, seed {number}: {error}")
            continue
        ends = RigidTransform.from_matrix(arm.link_poses(plan.motion.q).as_matrix()[:, -1])
        deviations.append(np.max(path_constraint.distance(ends), axis=1))
        times.append(plan.cpu_time)
    distance, angle = np.max(deviations, axis=0)
    cells = [arm.name, kind, seed, len(problems), len(times) - 1, f"{1e3 * distance:.2g}", f"{np.rad2deg(angle):.2g}"]
    return [*cells, f"{np.nanmedian(times):.2f}", f"{np.nanmax(times):.2f}"]


def main(arguments: Sequence[str] | None = None) -> None:
    given = options(arguments, __doc__, "", ["arms+"], ways=20)
    arms = [ls.Arm.load(str(name)) for name in given.arms]
    print(*markdown_table(HEADINGS, (row(arm, kind, given.ways) for arm in arms for kind in KINDS)), sep="\n")


if __name__ == "__main__":
    main()
