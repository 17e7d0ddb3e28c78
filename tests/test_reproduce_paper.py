"""The script that reproduces the paper, on a handful of experiments."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest
import reproduce_paper
from matplotlib.figure import Figure
from paper import claims, experiments, measures, plan, results, style
from paper.claims import checked

from lieednn_sim.errors import InputError

TINY = plan.Plan("quick", 5, 1, 1, 150, 20, 10, 20)
# A training in milliseconds, another kind of job, a check, and a job that cannot be done.
FEW = [
    plan.Job("tracked", "train", {"algorithm": "tracked", "changes": {}, "seed": 0}),
    plan.Job("certified synthesis", "synthesis", {"seed": 0}),
    plan.Job("activation", "check", {"name": "activation", "samples": 10}),
]


@pytest.fixture
def few_jobs(monkeypatch):
    """The first target of each group; one that P = 10 learns soon instead where the figures show an example."""
    slow = ("Riemannian gradient", "stability-aware", "exact projection")
    chosen = [job for job in plan.jobs(TINY) if job.parameters.get("seed", 0) == 0 and job.name not in slow]
    for k, job in enumerate(chosen):
        if job.name in ("P=10", "no projection"):
            changes = {**job.parameters["changes"], "max_epochs": 5000}
            chosen[k] = dataclasses.replace(job, parameters={**job.parameters, "seed": 4, "changes": changes})
    monkeypatch.setattr(reproduce_paper, "jobs", lambda _: chosen)
    return chosen


def test_a_tiny_run_writes_a_report_with_a_verdict_for_every_claim(tmp_path, few_jobs, monkeypatch):
    # Other tests lay figures out, and what is drawn well as a PNG is drawn well as a PDF.
    monkeypatch.setattr(style, "fix_layout", lambda figure, _: figure.set_layout_engine(None))
    draw = Figure.savefig

    def as_png(figure, target, **options):
        if target.suffix == ".pdf":
            target.write_bytes(bytes(2000))
        else:
            draw(figure, target, **options | {"dpi": 20})

    monkeypatch.setattr(Figure, "savefig", as_png)
    path = reproduce_paper.reproduce(TINY, tmp_path, 1, "the command")
    text = path.read_text(encoding="utf-8")
    rows = re.findall(r"^\|.*\*\*(.+?)\*\* \|$", text, flags=re.MULTILINE)
    assert len(rows) == len(claims.CLAIMS)
    assert set(rows) <= {measures.HOLDS, measures.PART, measures.FAILS, measures.UNKNOWN}
    assert rows.count(measures.UNKNOWN) < 3
    # Links work wherever the directory is copied to.
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == 2 * 6
    assert all((tmp_path / link).stat().st_size > 1000 for link in links)
    assert len(json.loads((tmp_path / "claims.json").read_text())["claims"]) == len(claims.CLAIMS)
    # A second run finds everything done.
    assert len(list((tmp_path / "jobs").iterdir())) == len(few_jobs)
    monkeypatch.setattr(results, "run", None)
    assert len(results.run_all(few_jobs, tmp_path / "jobs", 1)) == len(few_jobs)


def test_results_are_kept_as_they_are_and_a_failure_loses_nothing(tmp_path):
    broken = plan.Job("broken", "train", {"algorithm": "tracked", "changes": {"period": -1}, "seed": 0})
    with pytest.raises(InputError, match="period"):
        results.run_all([FEW[0], broken], tmp_path, 1)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    found = results.Results.collect(TINY, results.run_all(FEW, tmp_path, 1))
    assert len(before) == 1
    assert all(path.stat().st_mtime_ns == time for path, time in before.items())
    record = found.successes("tracked")[0]
    again = experiments.KINDS["train"](**FEW[0].parameters)
    assert np.array_equal(record.arrays["weight"], again[0]["weight"])
    assert record["epochs"] == again[1]["epochs"]


def test_each_job_has_a_file_of_its_own():
    work = plan.jobs(plan.FULL)
    assert len({job.key for job in work}) == len(work)


def test_verdicts_follow_from_the_numbers():
    def made(name, **values):
        job = plan.Job(name, "train", {"seed": 0})
        measured = {"accuracy": 1.0, "structure_error": 0.0, "seconds": 1.0, "one_norm": 4.0, "infinity_norm": 4.0}
        motion = {"smallest_one_norm": 1.2, "reached": 1.0, "from_zero": 0.0, "abscissa": -1.0, "acceleration": 1.0}
        motion |= {"acceleration_bound": 9.0, "closing": 4.0, "closing_applies": False}
        return results.Record(job, {}, {"success": True, "epochs": 100.0, "rises": 0.2, **measured, **motion, **values})

    def verdicts(**groups):
        found = results.Results(TINY, {f"P={name[1:]}": group for name, group in groups.items()})
        return {claim.text: claim.verdict for claim in claims.judge(found)}

    texts = {measure: text for _, text, measure in claims.CLAIMS}
    converging, faster = texts[measures.oscillating], texts[measures.larger_is_faster]
    good = {f"p{period}": [made(f"P={period}", epochs=float(1000 - period))] * 10 for period in plan.INSIDE}
    assert verdicts(**good)[converging] == measures.HOLDS
    assert verdicts(**good)[faster] == measures.HOLDS
    bad = {name: [made(name, success=False)] * 10 for name in good}
    assert verdicts(**bad)[converging] == measures.FAILS
    assert verdicts(**bad)[faster] == measures.FAILS
    assert verdicts(**{**bad, "p10": good["p10"]})[converging] == measures.PART
    assert set(verdicts().values()) == {measures.UNKNOWN}
    # How soon the runs converge is one thing, how many are lost another: these here are sooner, though most are lost.
    small, lost = texts[measures.small_periods], {"success": False, "reason": "lost the equilibrium"}
    few = [made("P=1", epochs=50.0)] * 3 + [made("P=1", **lost)] * 7
    spent = [made("P=1", epochs=50.0)] * 3 + [made("P=1", success=False, reason="epochs spent")] * 7
    late = [made("P=4", epochs=5000.0)] * 10
    assert verdicts(**good, p1=few, p4=few)[small] == measures.FAILS
    assert verdicts(**good, p1=few, p4=late)[small] == measures.PART
    assert verdicts(**good, p1=spent, p4=late)[small] == measures.HOLDS
    assert verdicts(**good, p1=[made("P=1", **lost)] * 3, p4=late)[small] == measures.PART
    groups = {f"P={name[1:]}": group for name, group in {**good, "p1": few, "p4": late}.items()}
    row = measures.small_periods(results.Results(TINY, groups))
    assert "P=1: 3 of 10 in 50 epochs and 1 s (medians), 7 lost the equilibrium" in row[0]


def test_verdicts_of_the_checks_follow_from_the_numbers():
    def verdict(claim, name, **values):
        record = results.Record(plan.Job(name, "check", {}), {}, values)
        return checked(results.Results(TINY, {name: [record]}), claim)[1]

    near = {"count": 1, "nearest": 1.0, "rising": [0.0] * 6, "smallest": 0.5}
    falling = [1.0, 0.9, 0.5, 0.2, 0.1, -0.1]
    for loss, random, expected in (
        ([1.0] * 6, [1.0] * 6, measures.HOLDS),
        ([0.98] * 6, [1.0] * 6, measures.FAILS),
        (falling, falling, measures.PART),
    ):
        assert verdict("riemannian", "riemannian", loss=loss, random=random, **near) == expected
    norms = {"count": 5, "columns": 5, "sums": 5, "beyond": 5, "violating": 5}
    for claim, changes, expected in (
        ("columns alone", {}, measures.HOLDS),
        ("columns alone", {"columns": 4}, measures.FAILS),
        ("sums alone", {}, measures.HOLDS),
        ("sums alone", {"sums": 4}, measures.FAILS),
        ("one norm for both", {}, measures.PART),
        ("one norm for both", {"violating": 0}, measures.HOLDS),
        ("one norm for both", {"columns": 4}, measures.FAILS),
    ):
        assert verdict(claim, "single norms", **norms | changes) == expected
    equal = {"count": 2, "tanh": 0.1, "own": 0.5}
    assert verdict("equivariance", "equivariance", largest=1e-11, **equal) == measures.HOLDS
    assert verdict("equivariance", "equivariance", largest=1e-3, **equal) == measures.FAILS
    assert verdict("weight gradient", "weight gradient", count=1, largest_error=0.01) == measures.FAILS


def test_a_thinned_history_keeps_the_extremes():
    from lieednn_sim.learning import TrainingOptions, train

    history = train(experiments.target(0), TrainingOptions(max_epochs=700), seed=0).history
    thin = experiments.thinned(history)
    assert len(thin["epoch"]) <= experiments.N_BINS
    assert thin["error_low"].min() == history.error.min()
    assert thin["error_high"].max() == history.error.max()
    assert (thin["error_low"] <= thin["error_median"]).all()
    assert thin["accuracy"][-1] == history.accuracy[-1]
    np.testing.assert_allclose(thin["equilibrium"][-1], history.equilibrium[-1], rtol=1e-6)


def test_a_bad_option_is_refused(capsys):
    with pytest.raises(SystemExit, match="2"):
        reproduce_paper.main(["--jobs", "0"])
    assert "must be at least 1, got 0" in capsys.readouterr().err
