"""The report: figures, tables, claims, and how they were made."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np

from lieednn_sim import io
from lieednn_sim.evaluation.display import markdown_table
from lieednn_sim.studies.rows import wilson
from paper.checks import CHECKS
from paper.claims import judge
from paper.measures import FAILS, FEW, HOLDS, MOST, PART, UNKNOWN
from paper.plan import BIAS, PERIODS, TOLERANCE
from paper.results import Record, Results, column, fraction, quantiles, seeds

COMPARED = {
    "literal": "Algorithm 1 as printed",
    "alpha fixed": "repaired, alpha fixed",
    "loss E": "repaired, E in place of E^2/2",
    "P=10": "repaired",
    "exact projection": "repaired, exact projection",
    "no projection": "no projection (ablation)",
    "tracked": "tracked, up to 5 starts",
    "Riemannian gradient": "Riemannian gradient",
    "Riemannian Gauss-Newton": "Riemannian Gauss-Newton, up to 5 starts",
    "stability-aware": "stability-aware Gauss-Newton, up to 5 starts",
    "certified synthesis": "certified synthesis",
    "retargeting": "retargeting by the bias",
}
STEPS = {
    "P=10": "repaired",
    "scaled projection": "alpha projected with its block",
    "tracked, P=10": "Gauss-Newton direction, steps taken back",
    "tracked, one start": "projection every epoch",
    "tracked": "up to 5 starts",
}


def write(results: Results, figures: dict[str, str], command: str, directory: Path) -> Path:
    """Write ``report.md`` and ``claims.json``; returns the report's path."""
    claims = judge(results)
    verdicts = {claim.text: {"verdict": claim.verdict, "measured": claim.measured} for claim in claims}
    io.save_json(directory / "claims.json", {"plan": results.plan.name, "claims": verdicts})
    words = {HOLDS: "hold", PART: "hold in part", FAILS: "do not hold", UNKNOWN: "were not measured"}
    found = [claim.verdict for claim in claims]
    counts = [f"{found.count(kind)} {word}" for kind, word in words.items() if kind in found]
    parts = [
        "# What of the paper reproduces\n",
        _made(results, command),
        "## Claims\n",
        f"Verdicts follow from the numbers. A claim holds if its fraction is {MOST:.0%} or more, and does not hold if "
        f"it is below {FEW:.0%}. It holds in part if the fraction lies between, or if it needs a condition that the "
        "paper does not state.\n",
        f"Of {len(found)} claims {', '.join(counts)}.\n",
        *markdown_table(
            ("claim", "where", "measured", "verdict"),
            [(claim.text, claim.source, claim.measured, f"**{claim.verdict}**") for claim in claims],
        ),
        "\n## Comparison of algorithms\n",
        "All algorithms learn the same random targets, some of them only the first ones. The certificate is a diagonal "
        "Lyapunov proof of global stability; the column gives the fraction of the learned networks that have one. The "
        "column structure gives the largest relative distance to weights alpha Ad. Times are medians over all runs, "
        "other medians are over the successful runs.\n",
        *compared(results),
        "\n## What makes the tracked variant better\n",
        "Each row adds one change to the row above it.\n",
        *_table_of(results, STEPS, "change"),
        "\n## Projection periods (repaired)\n",
        *_table_of(results, {f"P={period}": str(period) for period in PERIODS}, "P"),
        "\n## Why runs failed\n",
        *reasons(results),
        "\n## Figures\n",
    ]
    for name, caption in figures.items():
        parts.append(f"![{Path(name).stem}]({name})\n\n{caption} ([PDF]({Path(name).stem}.pdf))\n")
    path = directory / "report.md"
    io.save_text(path, "\n".join(parts))
    return path


def compared(results: Results) -> list[str]:
    """Table of all algorithms."""
    head = ("algorithm", "learned (95 %)", "epochs", "CPU time", "certificate", "structure")
    sizes = ("median / max |t|", "||W||_1", "all 100 starts arrive")
    rows = []
    for name, label in COMPARED.items():
        records = results[name]
        rows.append(_compared(label, records, results.successes(name)) if records else (label, *["not run"] * 8))
        if name == "exact projection" and records:
            # With the targets and epochs that the slow ones have.
            same = [record for record in results["P=10"] if record.job.parameters["seed"] in seeds(records)]
            good = [record for record in same if record["success"] and record["epochs"] <= results.plan.slow_epochs]
            rows.append(_compared("repaired, as few targets and epochs", same, good))
    return markdown_table((*head, *sizes), rows)


def _compared(label: str, records: list[Record], good: list[Record]) -> tuple[str, ...]:
    typical = quantiles(column(good, "median_translation"), 0.5)[0]
    longest = quantiles(column(good, "largest_translation"), 1.0)[0]
    return (
        label,
        rate(len(good), len(records)),
        number(quantiles(column(good, "epochs"), 0.5)[0], "{:.0f}"),
        _duration(quantiles(column(records, "seconds"), 0.5)[0]),
        f"{fraction(good, 'certified'):.0%}" if good else "-",
        number(quantiles(column(records, "structure_error"), 1.0)[0], "{:.1g}"),
        f"{number(typical, '{:.2g}')} / {number(longest, '{:.2g}')}",
        number(quantiles(column(good, "one_norm"), 0.5)[0], "{:.3g}"),
        f"{np.mean(column(good, 'reached') == 1.0):.0%}" if good else "-",
    )


def _table_of(results: Results, names: dict[str, str], head: str) -> list[str]:
    rows = []
    for name, label in names.items():
        records = results[name]
        spent = [number(x, "{:.0f}") for x in quantiles(column(results.successes(name), "epochs"), 0.1, 0.5, 0.9)]
        each = 1e6 * column(records, "seconds") / np.maximum(1.0, column(records, "epochs"))
        rows.append(
            (label, rate(len(results.successes(name)), len(records)), *spent, number(quantiles(each, 0.5)[0], "{:.0f}"))
        )
    return markdown_table((head, "learned (95 %)", "epochs, 10 %", "median", "90 %", "time of an epoch [us]"), rows)


def reasons(results: Results) -> list[str]:
    """Table of how the runs that failed ended."""
    names = [name for name in results.groups if name not in CHECKS and any(not r["success"] for r in results[name])]
    kinds = sorted({record["reason"] for name in names for record in results[name] if not record["success"]})
    rows = []
    for name in names:
        ends = [record["reason"] for record in results[name] if not record["success"]]
        rows.append((COMPARED.get(name, name), *(str(ends.count(kind)) for kind in kinds)))
    return markdown_table(("run", *kinds), rows) if rows else ["", "None did."]


def rate(good: int, count: int) -> str:
    """Successes of all, with the interval in which the rate lies."""
    return "{} of {} ({:.0%} to {:.0%})".format(good, count, *wilson(good, count)) if count else "not run"


def number(value: float, form: str) -> str:
    """A number, or a dash for none."""
    return form.format(value) if np.isfinite(value) else "-"


def _duration(seconds: float) -> str:
    if not np.isfinite(seconds):
        return "-"
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def _made(results: Results, command: str) -> str:
    plan = results.plan
    spent = sum(float(record["job_seconds"]) for group in results.groups.values() for record in group)
    packages = ", ".join(f"{name} {version(name)}" for name in ("lieednn_sim", "numpy", "scipy", "matplotlib"))
    lines = [
        f"`{command}`, Python {platform.python_version()} on {platform.machine()}, {packages}.\n",
        f"Targets xi_d ~ U(-0.8, 0.8), four SE(3) neurons, b = {BIAS:g}, gamma = mu = 1, tau = {TOLERANCE:g}. Seed k "
        f"draws target k and the initial weights. There are {plan.targets} targets. The first {plan.some_targets} are "
        "used for projection periods other than 10, with fixed alpha and with E as the loss, and the first "
        f"{plan.slow_targets} as printed and with the exact projection. Gradient descent has at most {plan.max_epochs} "
        f"epochs ({plan.slow_epochs} as printed and with the exact projection), and the Riemannian gradient "
        f"{plan.gradient_steps} steps. Times are CPU times of one core; all experiments together took "
        f"{spent / 60.0:.1f} min.\n",
    ]
    if plan.name == "quick":
        lines.insert(
            0, "**A quick run: few targets and too few epochs. The verdicts are those of the full run only.**\n"
        )
    return "\n".join(lines)
