"""LieEDNN on a telescopic manipulator: certified neural planners on se(3), simulated and rendered in MuJoCo."""

from __future__ import annotations


def __getattr__(name: str) -> str:
    """``__version__``, read when it is asked for."""
    if name == "__version__":
        from importlib import metadata

        return metadata.version("lieednn_sim")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
