"""The jobs to run, each a pure function of its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from paper.checks import CHECKS

INSIDE, OUTSIDE = (8, 10, 12, 16), (1, 4, 24, 40)
PERIODS = tuple(sorted(INSIDE + OUTSIDE))
BIAS = 0.125
TOLERANCE = 1e-5

# Trainings: name, named setting of the package, what is changed of it.
TRAININGS: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"P={period}": ("repaired", {"period": period}) for period in PERIODS},
    "literal": ("literal", {}),
    "loss E": ("repaired", {"loss": "norm"}),
    "alpha fixed": ("repaired", {"learn_alpha": False}),
    "no projection": ("repaired", {"projection": "none"}),
    "exact projection": ("repaired", {"projection": "exact"}),
    "scaled projection": ("repaired", {"projection": "scaled"}),
    "tracked, P=10": ("tracked", {"period": 10, "restarts": 0, "max_start_epochs": 10_000}),
    "tracked, one start": ("tracked", {"restarts": 0}),
    "tracked": ("tracked", {}),
}
RIEMANNIAN: dict[str, dict[str, Any]] = {
    "Riemannian gradient": {"direction": "gradient", "certified": False},
    "Riemannian Gauss-Newton": {"direction": "gauss-newton", "certified": False},
    "stability-aware": {"direction": "gauss-newton", "certified": True},
}


@dataclass(frozen=True)
class Plan:
    """The extent of the experiments."""

    name: str  # for the report
    targets: int  # random targets in comparisons
    some_targets: int  # of them for projection periods other than 10, and for other variants of the repaired algorithm
    slow_targets: int  # of them as printed and for the exact projection, whose epochs take milliseconds
    max_epochs: int  # of trainings with the gradient
    slow_epochs: int  # the same for the slow ones
    gradient_steps: int  # along the Riemannian gradient
    samples: int  # random matrices or states in each check of a formula


FULL = Plan("full", 100, 20, 4, 25_000, 10_000, 1000, 1000)
QUICK = Plan("quick", 6, 3, 1, 5000, 500, 200, 200)


@dataclass(frozen=True)
class Job:
    """A unit of work."""

    name: str  # of its group
    kind: str  # name of its function in `experiments.KINDS`
    parameters: dict[str, Any]  # arguments of that function, JSON values

    @property
    def key(self) -> str:
        """Name of the result's file."""
        return f"{self.name}-{self.parameters['seed']}" if "seed" in self.parameters else self.name


def jobs(plan: Plan) -> list[Job]:
    """Everything that is run, the longest first, so that no core waits for another at the end."""
    found = []
    for name, (algorithm, changes) in TRAININGS.items():
        count, limits = plan.targets, {}
        slow = name in ("literal", "exact projection")
        if slow:
            count = plan.slow_targets
        elif algorithm == "repaired" and name not in ("P=10", "no projection", "scaled projection"):
            count = plan.some_targets
        if algorithm != "tracked":
            limits = {"max_epochs": plan.slow_epochs if slow else plan.max_epochs}
        for seed in range(min(count, plan.targets)):
            options = {"algorithm": algorithm, "changes": {**changes, **limits}, "seed": seed}
            found.append(Job(name, "train", options))
    for name, settings in RIEMANNIAN.items():
        steps = {"max_start_epochs": plan.gradient_steps, "restarts": 0} if settings["direction"] == "gradient" else {}
        found += [Job(name, "riemannian", {**settings, **steps, "seed": seed}) for seed in range(plan.targets)]
    for seed in range(plan.targets):
        found.append(Job("certified synthesis", "synthesis", {"seed": seed}))
        found.append(Job("retargeting", "retarget", {"seed": seed}))
    found += [Job(name, "check", {"name": name, "samples": plan.samples}) for name in CHECKS]
    first = ("exact projection", "literal", "alpha fixed", "loss E")
    return sorted(found, key=lambda job: first.index(job.name) if job.name in first else len(first))
