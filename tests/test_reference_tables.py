"""Tables of the scripts whose results are committed, from made-up rows whose figures are known by hand."""

from __future__ import annotations

import contextlib
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import benchmark
import evaluate_demonstrations
import evaluate_pushes
import motion_bench_maker
import numpy as np
import provers
import pytest
import robustness
import shaped
from evaluate_demonstrations import scored

from lieednn_sim.studies.demonstrations.models import Attraction, ModelRow, PathErrors
from lieednn_sim.studies.problems.study import Solution


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_pushes_that_never_come_back_count_but_have_no_fraction():
    fields = ("fraction", "time_s", "velocity", "force", "deviation", "arrived_mm")
    values = [(0.1, 0.2, 0.5, 0.1, 0.1, 0.5), (0.3, 0.4, 0.6, 0.2, 0.16, 2.5), (0.8, 0.9, 0.9, 0.9, 0.08, 0.1)]
    values += [("", "", 0.7, 0.3, 0.12, 0.2)]
    rows = [{"arm": "an arm", "rate": 0.1, "reason": "", **dict(zip(fields, row, strict=True))} for row in values]
    rows.append({"arm": "an arm", "rate": 0.1, "reason": "no force"})
    assert cells(evaluate_pushes.summary(rows, "command")[-1]) == [
        *("an arm", "0.1", "4", "3", "30%", "80%", "2 of 4", "0.40", "0.65", "0.25", "1", "2.5"),
    ]


def test_published_problems_that_are_skipped_are_not_asked_and_lost_ones_are_named():
    times = {"cspace_path_length": 2.0, "motion_time": 3.0, "proved_fraction": 0.5}
    rows = [Solution("box", k, "rrt-connect", solve_time=float(k), **times) for k in range(5)]
    rows += [
        Solution("box", 5, "rrt-connect", reason="plan: no"),
        Solution("cage", 1, "rrt-connect", reason="skipped: x"),
    ]
    rows += [Solution("box", 1, "minimum-jerk", reason="plan: no")]
    lines = motion_bench_maker.report({"a robot": rows})
    assert cells(lines[6]) == [
        *(
            "a robot",
            "`rrt-connect`",
            "7",
            "1",
            "5 of 6",
            "2 / 2 / 3 / 3.92",
            "2 / 2 / 2 / 2",
            "3 / 3 / 3 / 3",
            "50.000%",
        ),
    ]
    assert cells(lines[7])[2:] == ["1", "0", "0 of 1", "-", "-", "-", "-"]
    assert lines[-1] == "- a robot, `rrt-connect`: box 5"


def test_certificates_of_motions_are_counted_and_what_is_nearer_is_found(tmp_path):
    proof = {"set": "walls", "planner": "a-planner", "scene": "001", "reason": "", "fraction": 1.0, "inside": True}
    proof |= {"clearance": 9.0, "found": 10.0, "tube": 2.0, "motion_time": 4.0, "planning_time": 0.2, "tube_time": 0.5}
    rows = [proof, proof | {"fraction": 0.9, "clearance": 5.0, "found": 4.0, "tube": None, "planning_time": 0.4}]
    rows += [proof | {"scene": f"{k}", "reason": why} for k, why in enumerate(("'a' would touch 'b'", "out of time"))]
    assert provers.broken(rows) == rows[1:2]
    lines = provers.report(rows)
    assert cells(lines[6]) == [
        *("walls", "`a-planner`", "2 of 4", "1 of 2", "2 of 2", "7 / 5 / 9", "1 of 2", "2 / 2 / 2"),
        *("4 / 4 / 4", "0.3 / 0.2 / 0.4", "0.5 / 0.5 / 0.5"),
    ]
    assert "below the proved clearance in 1 motions. In the median, the proved clearance is 108% of" in lines[8]
    assert lines[-2:] == ["- walls, `a-planner`, something in the way: 0", "- walls, `a-planner`, 1: out of time"]
    # A rod of 0.5 m with a joint at its end, and a box with a face 0.03 m beyond the other end.
    rod = """<robot name="rod"><link name="base"/><link name="rod"><collision><origin xyz="0.25 0 0"/><geometry>
      <box size="0.5 0.02 0.02"/></geometry></collision></link><joint name="j" type="revolute"><parent link="base"/>
      <child link="rod"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint></robot>"""
    (tmp_path / "rod.urdf").write_text(rod)
    lines = ["1,0,0,0,0,0,0", "2,3,4,5,6,7,8", ",".join(7 * ["NaN"]), "0.58,0,0,0.1,0.2,0.3,NaN"]
    (tmp_path / "scene_001.csv").write_text("\n".join(lines))
    posed = provers.problem(str(tmp_path / "rod.urdf"), tmp_path / "scene_001.csv")
    assert posed.goal.tolist() == [2, 3, 4, 5, 6, 7, 8]
    assert provers.least_distance(posed.arm, np.array([[1.5], [0.0]])) == pytest.approx(0.03, abs=1e-6)


def test_bounds_by_kind_of_network(monkeypatch):
    """Ratios of 0.01, 0.04, 0.09 ... 1.21, of which only the last breaks its bound."""
    kinds = list(robustness.KINDS)

    def case(seed):
        return kinds[seed >= 11], {"push gain": 0.01 * (seed + 1) ** 2 if seed < 11 else 0.5}

    pool = SimpleNamespace(map=lambda function, seeds, chunksize: map(function, seeds))
    monkeypatch.setattr(robustness, "worker_pool", lambda jobs: contextlib.nullcontext(pool))
    monkeypatch.setattr(robustness, "case", case)
    text, broken = robustness.report(13, 1)
    assert broken == 1
    assert any("A ratio above 1 breaks the bound: 1 of 13 do." in line for line in text)
    lines = [cells(line) for line in text if line.startswith("| ")]
    # The 95 % quantile of eleven values is half way between the last two.
    assert ["push gain", kinds[0], "11", "1", "0.36", "1.1", "1.21"] in lines
    assert lines[-1] == ["push gain", kinds[1], "2", "0", "0.5", "0.5", "0.5"]


def test_shaped_networks_beside_their_guides():
    figures = ("deviation_mm", "gap_mm", "jerk", "effector_jerk", "path", "effort", "clearance_mm")
    figures += ("guide_clearance_mm", "fit_ms", "planning_s")

    def row(arm, scene, seed, value):
        case = {"arm": arm, "scene": scene, "seed": float(seed), "guide": "a guide", "reason": ""}
        return case | dict.fromkeys(figures, value) | {"certified": value < 4.0}

    rows = [row("an arm", "poles", seed, value) for seed, value in enumerate((0.5, 0.6, 2.0, 9.0))]
    rows += [row("an arm", "free", 0, 3.0), {"arm": "an arm", "scene": "free", "seed": 1.0, "reason": "no plan"}]
    lines = list(shaped.summary(rows))
    high, low = ["1.3 / 9"] * 6, ["1.3 / 0.5"] * 2
    assert cells(lines[4]) == ["an arm", "poles", "4 of 4", "3", *high, *low, *["1.3 / 9"] * 2]
    assert cells(lines[3]) == ["an arm", "free", "1 of 2", "1", *["3 / 3"] * 10]
    assert cells(lines[5])[:3] == ["all", "obstacles", "4 of 4"]
    assert cells(lines[6])[:3] == ["all", "free", "1 of 2"]
    assert "Among obstacles, 50.0% stay within 1 mm of the guide's path and 75.0% within 5 mm." in lines[7]
    assert lines[8] == "Motions by guide: a guide 4."
    assert lines[9] == "\n- an arm, free, seed 1: no plan"


def test_effort_of_a_motion_by_hand(gantry):
    """Two masses of 1 kg each are lifted with 0.6, then 0.2 m/s^2, gravity compensated."""
    t = 0.01 * np.arange(201)
    acceleration = np.where(t < 1.0, 0.6, 0.2)
    speed = np.append(0.0, np.cumsum(0.01 * acceleration[:-1]))
    q, qd = np.zeros((2, 201, 4))
    qd[:, 2] = speed
    q[:, 2] = np.append(0.0, np.cumsum(0.005 * (speed[1:] + speed[:-1]))) - 0.5
    motion = SimpleNamespace(q=q, qd=qd, timestep=0.01)
    # Of four coordinates one has a force, 2 kg times the acceleration: half of its root mean square.
    assert shaped.effort(gantry, motion) == pytest.approx(0.5 * 2.0 * np.sqrt((0.6**2 + 0.2**2) / 2.0), rel=0.03)


def measured(name, model, rms_mm=1.0, rms_deg=0.1, left_out=1.0, training=1.0, arrived=3, spurious=0):
    def errors(scale):
        return PathErrors(scale, scale, 100.0 * scale, scale, 0.5, 0.0)

    mean = replace(errors(1.0), rms_mm=rms_mm, rms_deg=rms_deg)
    there = Attraction(3, arrived, spurious)
    return scored(name, ModelRow(model, 7, 0.25, mean, errors(training), errors(left_out), there))


def test_claims_on_tasks_hold_where_the_network_is_no_worse():
    rows = [
        row
        for name, ours in (
            ("first", {}),
            ("far", {"rms_mm": 2.5, "left_out": 3.0}),
            ("turned", {"rms_deg": 0.6, "left_out": 1.0}),
        )
        for row in (measured(name, "lieednn-shaped", **ours), measured(name, "dmp", left_out=2.0))
    ]
    assert evaluate_demonstrations.verdicts(rows, "robottasks") == [
        "- Every start arrives, and there is no other attractor: holds.",
        "- The mean demonstration is reproduced within 2 mm and 0.5 degrees RMS: holds in 1 of 3.",
        *(
            f"- {what} of demonstrations left out is at most that of `dmp`: holds in 2 of 3."
            for what in ("DTWD", "RMS of positions", "RMS of turns")
        ),
    ]
    lines = evaluate_demonstrations.table(rows, "robottasks")
    assert cells(lines[4])[:6] == ["first", "dmp", "7", "1.00", "0.10", "100"]
    assert cells(lines[-2])[:6] == ["**mean**", "lieednn-shaped", "", "1.50", "0.27", "100"]
    for lost in ({"arrived": 2}, {"spurious": 1}):
        rows[0] = measured("first", "lieednn-shaped", **lost)
        assert evaluate_demonstrations.verdicts(rows, "robottasks")[0].endswith("**does not hold**.")


def test_claims_on_letters_compare_means_over_them():
    names = ("lieednn-shaped", "dmp", "lpv-ds")
    rows = [
        measured(letter, name, training=x, left_out=x)
        for letter, scales in (("one", (1.0, 4.0, 1.0)), ("other", (1.0, 0.0, 1.0)))
        for name, x in zip(names, scales, strict=True)
    ]
    lines = evaluate_demonstrations.verdicts(rows, "lasa")
    for part, line, next_line in (("training", *lines[1:3]), ("left out", *lines[3:5])):
        assert line == f"- Mean DTWD [mm], {part}: lieednn-shaped 100, dmp 200, lpv-ds 100."
        assert next_line == "  At most that of `dmp`: holds; less than that of `lpv-ds`: **does not hold**."


def test_the_speeds_on_the_site_are_those_of_the_benchmark():
    root = Path(benchmark.__file__).parents[1]
    ratios = json.loads((root / "results/reference/benchmark.json").read_text(encoding="utf-8"))["ratios"]
    page = (root / "docs/results/speed.md").read_text(encoding="utf-8")
    said = {cells(line)[0]: cells(line)[1] for line in page.splitlines() if line.startswith("| ")}
    whole = "in those of a bare call of mj_step with nstep on the whole model"
    for row, begins, digits in (
        ("1000 targets at once", "1000 targets at once", 1),
        ("retargeting", "retargeting, in products", 1),
        ("plan of `lieednn-certified`, free space", "plan of lieednn-certified", 1),
        ("steps/s by position servo, mocap, inverse dynamics", f"steps/s of a rollout by position-servo, {whole}", 2),
        ("steps/s by position servo, mocap, inverse dynamics", f"steps/s of a rollout by mocap, {whole}", 2),
        ("steps/s by position servo, mocap, inverse dynamics", f"steps/s of a rollout by inverse-dynamics, {whole}", 2),
        ("steps/s by computed torque", "steps/s of a rollout by computed-torque, in those of a bare Python loop", 2),
        ("256 simulations by `simulate_many`", "steps/s of 256 rollouts", 1),
        ("64 environments at once", "steps/s of 64 environments at once", 1),
        ("video", "frames/s of a video", 2),
    ):
        median = next(ratio["median"] for name, ratio in ratios.items() if name.startswith(begins))
        assert re.search(rf"(^|[ ,]){re.escape(f'{median:.{digits}f}')}\b", said[row]), f"{row}: {median}"
    steps = [ratio["median"] for name, ratio in ratios.items() if name.startswith("control step of follow")]
    assert said["control step of `follow` with feedback"] == f"{min(steps):.0f} to {max(steps):.0f} us"
    real = next(ratio["median"] for name, ratio in ratios.items() if name.startswith("real time"))
    assert said["simulation"] == f"{round(real, -1):.0f} times as fast as real time"
    index = (root / "docs/results/index.md").read_text(encoding="utf-8")
    assert said["simulation"] in index
    assert said["control step of `follow` with feedback"] in index


def test_what_is_said_of_chunks_is_in_their_table():
    root = Path(benchmark.__file__).parents[1]
    lines = (root / "results/reference/chunks.md").read_text(encoding="utf-8").splitlines()
    rows = [cells(line) for line in lines if line.startswith("| ")]
    single, closed = [row for row in rows if len(row) == 7][2:], [row for row in rows if len(row) == 10]
    clean, wrong = ([row for row in single if row[0].startswith("clean") == kind] for kind in (True, False))
    assert (sum(int(row[1]) for row in clean), sum(int(row[3]) for row in clean)) == (600, 0)
    assert sum(int(row[1]) for row in wrong) == sum(int(row[4]) for row in wrong) == 2200
    rates = {row[2]: row[3] for row in closed if row[:2] == ["reach, clone", "800"]}
    said = (root / "docs/results/index.md").read_text(encoding="utf-8")
    assert f"in {rates['lieednn-chunks']} % of its episodes, with raw chunks in {rates['raw']} %" in said
    ours = [row for row in closed if row[2] == "lieednn-chunks"]
    assert all(float(row[5]) <= 1.0 and row[4] == "0" for row in ours)


def test_what_is_said_of_loads_that_swing_is_in_their_tables():
    root = Path(benchmark.__file__).parents[1]
    text = (root / "results/reference/settling.md").read_text(encoding="utf-8")
    rows = [cells(line) for line in text.splitlines() if line.startswith("| ")]
    percent = {
        tuple(row[:2]): [100.0 * float(value) for value in row[2:]]
        for row in rows
        if len(row) == 11 and row[2][0] in "0123456789"
    }
    ours, ei = percent["crane", "least-energy"], percent["crane", "ei"]
    said = (root / "docs/results/index.md").read_text(encoding="utf-8")
    assert f"leaves {ours[0]:.0f} % of a trapezoid's swing, and at most {max(ours):.0f} % of other loads'" in said
    assert f"EI in the same time {ei[0]:.0f} %" in said
    page = (root / "docs/results/settling.md").read_text(encoding="utf-8").replace("\n", " ")
    for counts in re.findall(r"leaves no more than EI in (\d+ of \d+) plans", text):
        assert counts in page
    for row in rows:
        if row[0] in ("crane", "luffing") and len(row) == 6:
            assert f"{row[2]} of {row[1]}" in page


def test_the_answers_on_the_site_are_in_the_tables():
    root = Path(benchmark.__file__).parents[1]
    answers = (root / "docs/results/index.md").read_text(encoding="utf-8").replace("10,000", "10000").replace(",", "")

    def made(name: str, planner: str) -> str:
        """Motions made, of all arms and scenes."""
        motions = (root / f"results/reference/{name}.md").read_text(encoding="utf-8").split("## Tracking")[0]
        rows = [cells(line) for line in motions.splitlines() if line.startswith("| telescopic")]
        return str(sum(int(row[3].split()[0]) for row in rows if row[2] == planner))

    for answer in (
        f"`lieednn-shaped` solves {made('comparison', 'lieednn-shaped')} of 120",
        f"minimum jerk {made('comparison', 'minimum-jerk')}; "
        f"`lieednn-certified` solves {made('comparison', 'lieednn-certified')}.",
        f"`lieednn-shaped` solve {made('obstacles', 'lieednn-shaped')} of 90 minimum jerk "
        f"{made('obstacles', 'minimum-jerk')}.",
    ):
        assert answer in answers
    for name, written in (
        ("benchmark", ("9995 of 10000",)),
        ("shaped", ("450 of 450", "0.15", "1.04")),
        ("demonstrations", ("27840", "1093", "32460", "1701")),
        ("robustness", ("7979",)),
        ("paper/report", ("Of 36 claims 19 hold",)),
    ):
        table = (root / f"results/reference/{name}.md").read_text(encoding="utf-8")
        for figure in written:
            assert figure in table
            assert figure in answers


def test_what_the_readme_and_the_learning_page_say_is_in_the_tables():
    root = Path(benchmark.__file__).parents[1]

    def text(path: str) -> str:
        return " ".join((root / path).read_text(encoding="utf-8").replace(",", "").split())

    def rows(name: str) -> list[list[str]]:
        lines = (root / f"results/reference/{name}.md").read_text(encoding="utf-8").splitlines()
        return [cells(line) for line in lines if line.startswith("| ")]

    def total(counts: list[str]) -> str:
        """Sums of `done of asked`."""
        done, asked = np.sum([[int(n) for n in count.split(" of ")] for count in counts], axis=0)
        return f"{done} of {asked}"

    shaped_rows = [row[2] for row in rows("shaped") if row[0] == "all"]
    robots = [row for row in rows("robots") if "/" in row[0]]
    motions = [row for row in rows("comparison") if len(row) == 16 and row[0].startswith("telescopic")]
    made, cases = total([row[3] for row in motions]).split(" of ")
    passed: dict[str, list[str]] = {}
    for row in rows("tasks"):
        if re.fullmatch(r"[0-5] of 5", row[1]):
            passed.setdefault(row[0], []).append(row[1])
    ours = passed.pop("lieednn-shaped")
    next_best = max(int(total(counts).split()[0]) for counts in passed.values() if len(counts) == 5)
    timed = [row for row in rows("motion_bench_maker") if row[5][0] in "0123456789"]
    times = {(row[0], row[1].strip("`")): float(row[5].split()[0]) for row in timed}
    slower = [time / times[robot, "rrt-connect"] for (robot, name), time in times.items() if name == "lieednn-shaped"]
    certified, straight = (total([row[column] for row in robots]) for column in (4, 5))
    readme = text("README.md")
    for said in (
        f"[{total(shaped_rows)} planned motions have one]",
        f"[{shaped_rows[0]} problems]",
        f"[{len(robots)} robots tried]",
        f"reaches {total([row[4] for row in robots if 'stretch' in row[0]])} targets",
        f"planned {certified} motions minimum jerk {straight.split()[0]};",
        f"[{len({row[2] for row in motions})} planners 3 arms {cases} cases: {made} planned",
        f"passes {total(ours)} cases the next best {next_best};",
        f"in {min(slower):.1f} to {max(slower):.1f} times RRT-Connect's mean time",
    ):
        assert said in readme, said
    assert f"Of {cases} cases {made} were planned" in text("docs/results/comparison.md")
    learned = {row[0]: row for row in rows("learning")}
    minutes = [float(learned[name][-1]) for name in ("SAC", "PPO")]
    page = text("docs/results/learning.md")
    assert f"is {learned['PPO'][3]} mm from its target after 400000" in page
    assert f"budgets of {min(minutes):.0f} to {np.ceil(max(minutes)):.0f} minutes" in page
    assert f"in {learned['behaviour cloning'][2].split()[0]} % of the episodes" in page
