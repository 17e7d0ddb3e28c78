"""The arrangement of a Matplotlib figure, computed once."""

from __future__ import annotations

import matplotlib
from matplotlib.figure import Figure


def settle(figure: Figure, dpi: float) -> None:
    """Arrange a figure for a resolution ``dpi`` [1/inch] by its layout engine, and take the engine away.

    While a figure has one, even one that is spent, `Figure.savefig` draws everything twice, the first time for nothing
    but the layout.
    """
    figure.dpi = dpi
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    # Without an engine means without the one of the user's own settings, too.
    with matplotlib.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)
