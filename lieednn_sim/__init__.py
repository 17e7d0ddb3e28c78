"""The front door: the names that most programs need, to plan, simulate, render and evaluate an arm's motion.

With ``import lieednn_sim as ls`` and ``arm = ls.Arm.load("telescopic_pr")``, ``plan = ls.plan(arm, "extended")`` plans
a motion and ``ls.simulate(arm, plan)`` simulates it. Each name is imported when it is first used. Everything else is in
the subpackages: `lie`, `stability`, `network`, `theory`, `synthesis`, `learning`, `arm`, `planning`, `policies`,
`simulation`, `rendering`, `evaluation`, `studies`, `environments`, `exports`, `live`, `cli`.
"""

from __future__ import annotations

from importlib import import_module

_SUBPACKAGES = (
    *("lie", "stability", "network", "theory", "synthesis", "learning", "arm", "planning", "policies", "simulation"),
    *("rendering", "evaluation", "studies", "environments", "exports", "live", "cli"),
)
# The stub beside this file says, also to type checkers, which module each name is in.
_stub = __spec__.loader.get_data(f"{__path__[0]}/__init__.pyi").decode().splitlines()
_lines = [line.split() for line in _stub if line.startswith("from lieednn_sim.")]
_MODULE_OF = {name: module.removeprefix("lieednn_sim.") for _, module, _, name, *_ in _lines}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("lieednn_sim.versions").installed("lieednn_sim") or "unknown"
    if name in _MODULE_OF:
        return getattr(import_module(f"lieednn_sim.{_MODULE_OF[name]}"), name)
    if name in _SUBPACKAGES:
        return import_module(f"lieednn_sim.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; names: {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBPACKAGES, "__version__"})
