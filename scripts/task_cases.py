"""The four tasks of `tasks.py`: their cases, their motions, and the figures measured in simulation."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.evaluation.load import load_metrics

ASSETS = Path(__file__).parents[1] / "assets/tasks"
_LOOKS = 60  # clearances of a simulation are measured at so many instants
_TIME = 60.0  # CPU time that a motion may take to plan [s]


class LeftOutError(Exception):
    """A task cannot run because its robot is missing."""


@dataclass
class Outcome:
    """A case so far: the present state, the plans and simulations that led to it, and the shots of its film."""

    model: Any
    data: Any
    plans: list[Any] = field(default_factory=list)
    runs: list[Any] = field(default_factory=list)
    # Models, times, positions, and the mocap body that rides on the tip.
    shots: list[tuple[Any, Any, Any, str]] = field(default_factory=list)
    cpu_time: float = 0.0  # of planning [s]

    def move(self, arm: ls.Arm, goal: Any, hold: float, riding: str = "", **options: Any) -> None:
        """Plan for a view in the present state, simulate the plan and some time at rest, and go on from there.

        The planner may be followed by ``+`` and the way to settle the load, as in ``lieednn-shaped+least-energy``.
        """
        options["planner"], _, settle = options["planner"].partition("+")
        begun = time.process_time()
        try:
            with ls.time_limit(_TIME):
                found = ls.plan(arm, goal, settle=settle or None, **options)
        finally:
            self.cpu_time += time.process_time() - begun
        run = ls.simulate(arm, found, hold=hold)
        self.plans.append(found)
        self.runs.append(run)
        self.shots.append((run.arm.model, run.t, run.qpos, riding))
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[:] = run.qpos[-1], 0.0, run.ctrl[-1]
        mujoco.mj_forward(self.model, self.data)

    def missed(self, leg: int) -> float:
        """Distance of the tip from the end of the planned motion, after the rest that follows it [m]."""
        run = self.runs[leg]
        return float(np.linalg.norm(run.link_position[-1, -1] - run.arm.tip(run.q_ref[-1])))

    def clearance(self) -> float:
        """Least distance of the arm from anything in its simulations [m]."""
        rows = [np.linspace(0, len(found.t) - 2, _LOOKS).astype(int) for found in self.plans]
        each = zip(self.plans, self.runs, rows, strict=True)
        return min(Collisions(found.arm).clearance(run.q[some]) for found, run, some in each)


class Task:
    """A task: its name, the published figures, the columns of its table and its pass mark."""

    title: ClassVar[str]
    published: ClassVar[str]
    columns: ClassVar[Mapping[str, str]]  # heads of the table by name of the figure
    most: ClassVar[Mapping[str, float]] = {}  # the pass mark: the largest values that pass
    least: ClassVar[Mapping[str, float]] = {}  # and the least ones
    joints: ClassVar[list[str]]  # those that are planned

    def __init__(self, menagerie: Sequence[Path] = ()) -> None:
        del menagerie

    def start(self, case: int) -> Outcome:
        """The state in which a case begins."""
        raise NotImplementedError

    def play(self, done: Outcome, case: int, planner: str) -> None:
        """Plan and simulate all motions of a case; raises `LieEDNNError` if one is not found or fails."""
        raise NotImplementedError

    def judge(self, done: Outcome, case: int) -> dict[str, float]:
        """The figures of a case whose motions were all simulated."""
        raise NotImplementedError

    def missed(self, figures: Mapping[str, float]) -> list[str]:
        """The figures that miss the pass mark."""
        over = [name for name, value in self.most.items() if not figures[name] <= value]
        return over + [name for name, value in self.least.items() if not figures[name] >= value]


class Boom(Task):
    """A boom of 22 m through a penetration of 0.55 m."""

    title = "Boom of 22 m through a penetration of 0.55 m"
    published = (
        "Published: a boom of 22 m and 4.6 t, a hole of 55 cm, and a margin of 30 mm to its wall (sources: "
        "`assets/tasks/boom/README.md`). Pass mark: the simulated boom keeps the 30 mm, and its tip ends within 10 mm "
        "of its goal."
    )
    columns: ClassVar[dict[str, str]] = {"time_s": "time [s]", "clearance_mm": "clearance [mm]", "tip_mm": "tip [mm]"}
    most: ClassVar[dict[str, float]] = {"tip_mm": 10.0}
    least: ClassVar[dict[str, float]] = {"clearance_mm": 30.0}
    joints: ClassVar[list[str]] = ["carriage", "telescope", "yaw", "pitch", "reach"]
    goals: ClassVar[list[list[float]]] = [
        [4.95, 4.20, 0.45, 1.00, 0.40],
        [4.95, 4.15, -0.62, -0.26, 0.26],
        [4.95, 4.16, 0.46, -1.07, 0.18],
        [4.9, 4.15, 0.30, 1.20, 0.45],
        [4.95, 4.02, -0.49, -0.69, 0.43],
    ]

    def start(self, case: int) -> Outcome:
        return _at_home("boom")

    def play(self, done: Outcome, case: int, planner: str) -> None:
        # 3 mm more than the published margin, since the servos do not follow the plan exactly.
        arm = ls.Arm.of(done.model, done.data, self.joints, tip="tip", clearance=0.033)
        done.move(arm, self.goals[case], 5.0, planner=planner, seed=case, duration=(60.0, 240.0))

    def judge(self, done: Outcome, case: int) -> dict[str, float]:
        return {
            "time_s": done.runs[0].motion_end,
            "clearance_mm": 1e3 * done.clearance(),
            "tip_mm": 1e3 * done.missed(0),
        }


class Harvester(Task):
    """A telescopic picking arm at a row of fruit."""

    title = "Picking arm at a row of fruit"
    published = (
        "Published: 5.97 s per fruit on average, including the search for it; 7.53 s and 5.27 s by other robots "
        "(sources: `assets/tasks/harvester/README.md`). Pass mark: the arm takes at most 5.97 s per fruit, with 1 s "
        "for the vacuum, on the average of four fruits; its tip stops within 4.7 mm of its goals; nothing touches."
    )
    columns: ClassVar[dict[str, str]] = {
        "cycle_s": "cycle [s]",
        "moving_s": "of this moving [s]",
        "clearance_mm": "clearance [mm]",
        "tip_mm": "tip [mm]",
    }
    most: ClassVar[dict[str, float]] = {"cycle_s": 5.97, "tip_mm": 4.7}
    least: ClassVar[dict[str, float]] = {"clearance_mm": 0.0}
    joints: ClassVar[list[str]] = ["yaw", "pitch", "extend"]
    dwell = 1.0  # [s]

    def start(self, case: int) -> Outcome:
        """Fruit at random places between the trunks, such that the arm reaches each of them."""
        done, rng = _at_home("harvester"), np.random.default_rng(case)
        for fruit, (y, z) in enumerate(((-0.4, 0.95), (0.0, 1.45), (0.4, 1.25), (0.0, 0.95))):
            while True:
                done.data.mocap_pos[fruit] = np.array([0.98, y, z]) + rng.uniform(-1, 1, 3) * (0.04, 0.11, 0.15)
                mujoco.mj_forward(done.model, done.data)
                arm = ls.Arm.of(done.model, done.data, self.joints, tip="tip")
                aims = (self._aim(done, fruit, 0.01), self._aim(done, fruit, 0.11))
                if all(Collisions(arm).clearance(aim) > 0.004 for aim in aims):
                    break
        return done

    def play(self, done: Outcome, case: int, planner: str) -> None:
        arm = ls.Arm.of(done.model, done.data, self.joints, tip="tip")
        home = arm.keyframe("home")
        options: dict[str, Any] = {"planner": planner, "seed": case, "duration": 1.5, "fastest": True}
        for fruit in range(4):
            done.move(arm.at(done.data), self._aim(done, fruit, 0.11), 0.0, **options)
            done.move(arm.at(done.data), self._aim(done, fruit, 0.01), self.dwell, **options)
            done.data.mocap_pos[fruit] = [-0.38 + 0.09 * fruit, 0.75, 0.41]
            mujoco.mj_forward(done.model, done.data)
            done.move(arm.at(done.data), home, 0.0, riding=f"fruit{fruit}", **options)

    def judge(self, done: Outcome, case: int) -> dict[str, float]:
        moving = sum(run.motion_end for run in done.runs) / 4
        return {
            "cycle_s": moving + self.dwell,
            "moving_s": moving,
            "clearance_mm": 1e3 * done.clearance(),
            "tip_mm": 1e3 * max(done.missed(1 + 3 * fruit) for fruit in range(4)),
        }

    def _aim(self, done: Outcome, fruit: int, gap: float) -> NDArray[np.float64]:
        """Joint positions that point at a fruit, with a gap between it and the tip [m]."""
        away = done.data.mocap_pos[fruit] - done.data.body("cart").xpos
        far, (radius, *_) = np.linalg.norm(away), done.model.geom_size[done.model.body(f"fruit{fruit}").geomadr[0]]
        retracted = 0.5  # from the axes to the tip [m]
        return np.array([np.arctan2(away[1], away[0]), np.arcsin(away[2] / far), far - radius - gap - retracted])


class Crane(Task):
    """A timber crane with an elastic last stage."""

    title = "Timber crane with an elastic last stage, in 8 s"
    published = (
        "Published: a feedforward that knows the load reduces its swing by more than 60 % (sources: "
        "`assets/tasks/crane/README.md`). Pass mark: the load swings by at most 40 % of what a trapezoidal speed "
        "leaves on the same path in the same time; the hook stops within 50 mm of its goal; the load keeps 100 mm from "
        "everything."
    )
    columns: ClassVar[dict[str, str]] = {
        "time_s": "time [s]",
        "swing_deg": "swing left [deg]",
        "ratio": "of a trapezoid's",
        "bend_mm": "bending left [mm]",
        "hook_mm": "hook [mm]",
        "load_mm": "load's clearance [mm]",
    }
    most: ClassVar[dict[str, float]] = {"ratio": 0.4, "hook_mm": 50.0}
    least: ClassVar[dict[str, float]] = {"load_mm": 100.0}
    joints: ClassVar[list[str]] = ["slew", "inner", "outer", "telescope"]
    duration: ClassVar[float] = 8.0  # [s]
    starts: ClassVar[list[list[float]]] = [
        [-1.5, 0.45, -1.45, 1.0],
        [1.6, 0.55, -1.60, 1.1],
        [-1.9, 0.40, -1.35, 0.6],
        [1.3, 0.50, -1.50, 1.4],
        [-1.2, 0.45, -1.40, 1.3],
    ]
    goals: ClassVar[list[list[float]]] = [
        [0.0, 0.70, -1.60, 0.2],
        [0.0, 0.75, -1.65, 0.3],
        [0.0, 0.65, -1.50, 0.1],
        [0.0, 0.70, -1.60, 0.4],
        [0.0, 0.80, -1.75, 0.3],
    ]

    def start(self, case: int) -> Outcome:
        """The crane at its start with its load at rest: bent, and hanging straight down."""
        model = mujoco.MjModel.from_xml_path(str(ASSETS / "crane/scene.xml"))
        data = mujoco.MjData(model)
        data.qpos[:4] = data.ctrl[:] = self.starts[case]
        data.joint("swing_along").qpos = data.qpos[1] + data.qpos[2]
        for _ in range(4000):
            mujoco.mj_step(model, data)
            data.qvel[4:] *= 0.98
        data.qpos[:4], data.qvel[:], data.time = self.starts[case], 0.0, 0.0
        mujoco.mj_forward(model, data)
        return Outcome(model, data)

    def play(self, done: Outcome, case: int, planner: str) -> None:
        arm = ls.Arm.of(done.model, done.data, self.joints, tip="tip")
        done.move(arm, self.goals[case], 10.0, planner=planner, seed=case, duration=self.duration)

    def judge(self, done: Outcome, case: int) -> dict[str, float]:
        (found,), (run,) = done.plans, done.runs
        uninformed = ls.simulate(run.arm, trapezoidal(found.motion), hold=10.0)
        swing, theirs, load = self._swing(run), self._swing(uninformed), load_metrics(run)
        assert load is not None
        assert load.clearance_mm is not None
        rest = run.t >= run.motion_end
        return {
            "time_s": run.motion_end,
            "swing_deg": float(np.rad2deg(swing)),
            "ratio": swing / theirs,
            "bend_mm": 1e3 * self.amplitude(run.qpos[rest, 4]),
            "hook_mm": 1e3 * done.missed(0),
            "load_mm": load.clearance_mm,
        }

    @staticmethod
    def amplitude(bend: NDArray[np.float64]) -> float:
        """How far the hook moves from its middle, up or down, as the last stage bends by angles ``(K,)`` [m]."""
        return 0.5 * 1.2 * float(np.ptp(bend))

    def _swing(self, run: Any) -> float:
        """Largest angle of the load's line from the vertical after the motion [rad]."""
        line = (run.poses("tip").translation - run.poses("load").translation)[run.t >= run.motion_end]
        return float(np.arccos(line[:, 2] / np.linalg.norm(line, axis=1)).max())


class SlowCrane(Crane):
    """The crane in 12 s."""

    title = "Timber crane with an elastic last stage, in 12 s"
    duration: ClassVar[float] = 12.0  # [s]


def _at_home(name: str) -> Outcome:
    model = mujoco.MjModel.from_xml_path(str(ASSETS / name / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return Outcome(model, data)


def trapezoidal(motion: Any, ramp: float = 0.25) -> Any:
    """The same path in the same time with a trapezoidal speed, whose ramps each take a fraction of the time."""
    step = np.linalg.norm(np.diff(motion.q, axis=0), axis=1)
    far, passed = np.unique(np.append(0.0, np.cumsum(step)), return_index=True)
    now = motion.t / motion.t[-1]
    speed = np.clip(np.minimum(now, 1.0 - now) / ramp, 0.0, 1.0)
    progress = np.append(0.0, np.cumsum(speed[1:] + speed[:-1]))
    wanted = far[-1] * progress / progress[-1]
    q = np.stack([np.interp(wanted, far, column[passed]) for column in motion.q.T], axis=1)
    return replace(motion, q=q, qd=np.gradient(q, motion.t, axis=0))
