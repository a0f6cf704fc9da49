"""One style for the figures of the studies: colours that the colour-blind tell apart, and two formats."""

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe & Ito (2008)
MARKERS = ("o", "s", "^", "D", "v", "P")
STYLE: dict[str, Any] = {
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.titlesize": 10,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.title_fontsize": 8,
    "lines.linewidth": 1.0,
    "lines.markersize": 5,
    "svg.fonttype": "none",
}
PANEL = (4.2, 3.4)  # [inch]
DPI = 120


def panels(lines: int, columns: int) -> tuple[Figure, np.ndarray]:
    """Make a figure and its axes `(lines, columns)`."""
    drawing = Figure(figsize=(PANEL[0] * columns, PANEL[1] * lines), layout="constrained")
    return drawing, drawing.subplots(lines, columns, squeeze=False)


def literal(words: str) -> str:
    """Return words as matplotlib draws them letter by letter: a dollar begins no formula."""
    return words.replace("$", r"\$")


def ticks(axes: Axes, axis: str, values: Sequence[float]) -> None:
    """Set plain numbers on an axis, logarithmic or not."""
    {"x": axes.set_xticks, "y": axes.set_yticks}[axis](values, [f"{value:.3g}" for value in values])
    axes.minorticks_off()


def render_figure(figure: Callable[[Sequence[Any]], Figure], rows: Sequence[Any], name: str) -> dict[str, bytes]:
    """Render a study's figure by format, the same bytes for the same rows."""
    pictures = {}
    with rc_context({**STYLE, "svg.hashsalt": name}):
        drawing = figure(rows)
        for kind in ("png", "svg"):
            buffer = io.BytesIO()
            metadata = {"Date": None} if kind == "svg" else None
            drawing.savefig(buffer, format=kind, dpi=DPI, metadata=metadata)
            pictures[kind] = buffer.getvalue()
    return pictures
