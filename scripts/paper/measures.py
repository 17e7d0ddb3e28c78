"""What is measured for each claim: a sentence with the numbers, and the verdict that follows from them."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from lieednn_sim.learning import StopReason
from lieednn_sim.studies.rows import wilson
from paper.plan import INSIDE, OUTSIDE, TOLERANCE
from paper.results import Missing, Record, Results, column, fraction, quantiles, seeds

HOLDS, PART, FAILS, UNKNOWN = "holds", "holds in part", "does not hold", "not measured"
# Fractions of targets or networks: from MOST on a claim holds, below FEW it does not.
MOST, FEW = 0.9, 0.1

# Reasons for which a run lost its network, rather than its epochs being spent.
_LOST = (str(StopReason.LOST_EQUILIBRIUM), str(StopReason.UNSTABLE))


def graded(rate: float) -> str:
    """Verdict on a fraction."""
    if math.isnan(rate):
        return UNKNOWN
    return HOLDS if rate >= MOST else PART if rate >= FEW else FAILS


def of(records: list[Record]) -> str:
    """The count of successes, of all."""
    return f"{sum(bool(record['success'] is True) for record in records)} of {len(records)}"


def _good(results: Results, *names: str) -> list[Record]:
    results.require(*names)
    records = [record for name in names for record in results.successes(name)]
    if not records:
        raise Missing(f"a success of {', '.join(names)}")
    return records


def _periods(values: tuple[int, ...]) -> list[str]:
    return [f"P={period}" for period in values]


def oscillating(results: Results) -> tuple[str, str]:
    records = results.require(*_periods(INSIDE))
    counts = "; ".join(f"{name}: {of(results[name])}" for name in _periods(INSIDE))
    rises = quantiles(column(records, "rises"), 0.5)[0]
    measured = f"{counts}; E rises in {rises:.0%} of the epochs (median)"
    return measured, graded(fraction(records)) if rises > 0.01 else FAILS


def small_periods(results: Results) -> tuple[str, str]:
    inside = results.require(*_periods(INSIDE))
    usual = _median_epochs(inside)
    names = _periods(tuple(p for p in OUTSIDE if p < min(INSIDE)))
    groups = [results.require(name) for name in names]
    slower = [_median_epochs(group) > usual for group in groups]
    parts = [f"{name}: {_pace(group)}" for name, group in zip(names, groups, strict=True)]
    measured = (
        f"{'; '.join(parts)}; P = 8 to 16: {_pace(inside)}. Judged by the medians of the runs that were not lost, "
        f"where one without end counts as longest: {', '.join(_epochs(_median_epochs(group)) for group in groups)} "
        f"against {_epochs(usual)}"
    )
    return measured, HOLDS if all(slower) else PART if any(slower) else FAILS


def _pace(records: list[Record]) -> str:
    """Speed of the runs that converged, and how the others ended."""
    good = [record for record in records if record["success"] is True]
    epochs, seconds = (quantiles(column(good, name), 0.5)[0] for name in ("epochs", "seconds"))
    ends = [record["reason"] for record in records if record["success"] is not True]
    kinds = ", ".join(f"{ends.count(kind)} {kind}" for kind in sorted(set(ends)))
    speed = f" in {epochs:.0f} epochs and {seconds:.2g} s (medians)" if good else ""
    return f"{of(records)}{speed}" + (f", {kinds}" if ends else "")


def large_periods(results: Results) -> tuple[str, str]:
    names = _periods(tuple(p for p in OUTSIDE if p > max(INSIDE)))
    groups = results.require(*names), results.require(*_periods(INSIDE))
    lost = [sum(record["reason"] in _LOST for record in group) for group in groups]
    apart = wilson(lost[0], len(groups[0]))[0] > wilson(lost[1], len(groups[1]))[1]
    measured = (
        f"{'; '.join(f'{name}: {of(results[name])}' for name in names)}; P = 8 to 16: {of(groups[1])}; lost or "
        f"unstable {lost[0] / len(groups[0]):.0%} against {lost[1] / len(groups[1]):.0%}"
    )
    return measured, HOLDS if fraction(groups[0]) < FEW else PART if apart else FAILS


def larger_is_faster(results: Results) -> tuple[str, str]:
    groups = [results.require(name) for name in _periods(INSIDE)]
    common = set.intersection(*(seeds(group) for group in groups))
    if not common:
        raise Missing("any target with every P in 8 to 16")
    middles = [_median_epochs([r for r in group if r.job.parameters["seed"] in common]) for group in groups]
    parts = [f"{_epochs(middle)} at {name}" for name, middle in zip(_periods(INSIDE), middles, strict=True)]
    measured = (
        f"medians over {len(common)} common targets without the runs that were lost; one without end counts as "
        f"longest: {', '.join(parts)}"
    )
    # All four in order, or at least the largest against the smallest.
    if all(later < earlier for earlier, later in pairwise(middles)):
        return measured, HOLDS
    return measured, PART if middles[-1] < middles[0] else FAILS


def _median_epochs(records: list[Record]) -> float:
    """Median epochs to converge, infinite for runs that did not; runs that lost their network are left out."""
    kept = [record for record in records if record["success"] or record["reason"] not in _LOST]
    spent = np.sort([record["epochs"] if record["success"] else np.inf for record in kept])
    return float(spent[len(spent) // 2]) if len(spent) else math.nan


def _epochs(count: float) -> str:
    return "all lost" if math.isnan(count) else f"{count:.0f} epochs" if math.isfinite(count) else "no end"


def accuracy(results: Results) -> tuple[str, str]:
    records = results.require("P=10")
    perfect = [record["accuracy"] == 1.0 for record in records]
    mean = float(np.mean(column(records, "accuracy")))
    return (
        f"P = 10: {sum(perfect)} of {len(records)} targets end with accuracy 1 (all coordinates within {TOLERANCE:g}), "
        f"mean {mean:.2f}"
    ), graded(float(np.mean(perfect)))


def structure(results: Results) -> tuple[str, str]:
    kept = column(results.require(*_periods(INSIDE)), "structure_error").max()
    lost = quantiles(column(results.require("no projection"), "structure_error"), 0.5)[0]
    measured = f"relative distance to the manifold: at most {kept:.1g} with projection, median {lost:.2f} without"
    return measured, HOLDS if kept < 1e-9 and lost > 0.1 else PART if kept < 1e-9 or lost > 0.1 else FAILS


def ablation(results: Results) -> tuple[str, str]:
    records = results.require("no projection")
    middle = quantiles(column(results.successes("no projection"), "epochs"), 0.5)[0]
    return f"{of(records)} targets, median {middle:.0f} epochs", graded(fraction(records))


def converging(results: Results) -> tuple[str, str]:
    records = _good(results, *_periods(INSIDE))
    zero = float(np.mean(column(records, "from_zero") < 1e-3))
    reached = column(records, "reached")
    everywhere = float(np.mean(reached == 1.0))
    measured = (
        f"of {len(records)} trained networks {zero:.0%} arrive from zero; from 100 random starts in (-2, 2) "
        f"{everywhere:.0%} arrive from all of them, worst network from {reached.min():.0%}"
    )
    return measured, HOLDS if min(zero, everywhere) >= MOST else graded(zero) if zero < MOST else PART


def norms(results: Results) -> tuple[str, str]:
    records = _good(results, *_periods(INSIDE), "tracked")
    met = float(np.mean((column(records, "one_norm") < 1.0) & (column(records, "infinity_norm") < 1.0)))
    least, middle, most = quantiles(column(records, "one_norm"), 0.0, 0.5, 1.0)
    targets = results.require("P=10")
    possible = float(np.mean(column(targets, "smallest_one_norm") < 1.0))
    lowest, typical = quantiles(column(targets, "smallest_one_norm"), 0.0, 0.5)
    measured = (
        f"{met:.0%} of {len(records)} trained networks meet them: ||W||_1 is {least:.2g} to {most:.2g} (median "
        f"{middle:.2g}), where below 1 is asked for; any network with these equilibria has at least {lowest:.2g} to "
        f"begin with (median {typical:.2g}), so that at most {possible:.0%} of the targets allow it"
    )
    return measured, graded(met)


def stable(results: Results) -> tuple[str, str]:
    records = _good(results, *_periods(INSIDE))
    certified = fraction(records, "certified")
    local = float(np.mean(column(records, "abscissa") < 0.0))
    arriving = float(np.mean(column(records, "reached") == 1.0))
    measured = (
        f"of {len(records)} trained networks {certified:.0%} have a diagonal Lyapunov certificate (global), "
        f"{local:.0%} are locally stable; for {arriving:.0%} all of 100 random starts arrive"
    )
    return measured, HOLDS if certified >= MOST else PART if min(local, arriving) >= FEW else FAILS


def curvature(results: Results) -> tuple[str, str]:
    records = _good(results, *_periods(INSIDE), "tracked", "certified synthesis", "retargeting")
    general = column(records, "acceleration") <= column(records, "acceleration_bound")
    applies = fraction(records, "closing_applies")
    below = float(np.mean(column(records, "acceleration") < column(records, "closing")))
    measured = (
        f"first inequality: {general.mean():.0%} of {len(records)} trajectories; the closing one needs ||W||_inf < "
        f"gamma/mu, which {applies:.0%} of the networks meet; numerically {below:.0%} of the trajectories lie below it"
    )
    return measured, FAILS if not general.all() else HOLDS if applies >= MOST else PART


def alpha(results: Results) -> tuple[str, str]:
    fixed, learned = results.require("alpha fixed"), results.require("P=10")
    measured = f"alpha fixed: {of(fixed)}; learned: {of(learned)}"
    before, after = fraction(fixed), fraction(learned)
    return measured, HOLDS if before < FEW <= after else PART if before < after else FAILS


def norm_loss(results: Results) -> tuple[str, str]:
    records = results.require("loss E")
    errors = quantiles(column(records, "error"), 0.0, 0.5)
    measured = f"{of(records)} targets with alpha learned; smallest error {errors[0]:.2g}, median {errors[1]:.2g}"
    return measured, graded(fraction(records))


def literal(results: Results) -> tuple[str, str]:
    records = results.require("literal")
    errors = quantiles(column(records, "error"), 0.0)[0]
    reasons = sorted({record["reason"] for record in records})
    measured = f"{of(records)} targets reach tau; smallest error {errors:.2g}; ends: {', '.join(reasons)}"
    return measured, graded(fraction(records))


def minutes(results: Results) -> tuple[str, str]:
    parts, times = [], []
    for name, label in (("literal", "as printed"), ("P=10", "repaired"), ("tracked", "tracked")):
        records = results.require(name)
        middle, most = quantiles(column(records, "seconds"), 0.5, 1.0)
        each = quantiles(1e6 * column(records, "seconds") / np.maximum(1.0, column(records, "epochs")), 0.5)[0]
        parts.append(f"{label}: median {middle:.2g} s, at most {most:.2g} s, {each:.0f} us an epoch")
        times.append(most)
    return "; ".join(parts) + " (a claim on the authors' code and machine)", HOLDS if max(times) <= 300.0 else FAILS
