"""The figure of a sweep: one column of its table over another, a line for each value of a third."""

import re
from collections.abc import Sequence
from math import ceil
from typing import Any

from matplotlib.figure import Figure

from studies.figure import COLOURS, MARKERS, literal, panels
from studies.sweeps.table import Column

DASHES = ("-", "--", ":", "-.")
WORDS, HIGH = 44, 36  # letters of a line along the axes and in the legend, and along the vertical axis
MOST = 16  # lines in a column of the legend
TICKS = 5  # intervals between labels below the axes, whose numbers can have six digits
MARGIN = 0.3  # around the legend [inch]


def figure(drawn: Sequence[Column]) -> Figure:
    """Return the figure of the second of two columns over the first.

    There is a line for each value of a third column. Points of which several have the same x are not
    joined.
    """
    drawing, ((axes,),) = panels(1, 1)
    x, y, *by = drawn
    lines = list(dict.fromkeys(by[0].values)) if by else [None]
    for number, line in enumerate(lines):
        rows = [k for k in range(len(x.values)) if not by or by[0].values[k] == line]
        points = sorted((x.values[k], y.values[k]) for k in rows if x.values[k] is not None and y.values[k] is not None)
        label = f"{line:.4g}" if isinstance(line, float) else str(line)
        joined = {} if len({p[0] for p in points}) == len(points) else {"linestyle": "none"}
        axes.plot(*zip(*points, strict=True), label=folded(label, WORDS), **style_of(number) | joined)
    axes.locator_params(axis="x", nbins=TICKS)
    axes.set_xlabel(folded(x.heading, WORDS))
    axes.set_ylabel(folded(y.heading, HIGH))
    if by:
        add_legend(drawing, folded(by[0].heading, WORDS), len(lines))
    return drawing


def style_of(number: int) -> dict[str, Any]:
    """Return the style of a line: colour and marker; repeated colours have other dashes."""
    turn, place = divmod(number, len(COLOURS))
    return {"color": COLOURS[place], "marker": MARKERS[place], "linestyle": DASHES[turn % len(DASHES)]}


def folded(words: str, width: int) -> str:
    """Wrap words into lines of at most `width` letters.

    Lines break at blanks, and at dots and underscores of names. A dollar sign in the words does not
    begin a formula.
    """
    lines = [""]
    for part in re.split(r"(?<=[._])(?=[^\W\d_])|(?<=\s)", words):
        if lines[-1] and len(lines[-1]) + len(part.rstrip()) > width:
            lines.append("")
        lines[-1] += part
    return literal("\n".join(map(str.rstrip, lines)))


def add_legend(drawing: Figure, title: str, lines: int) -> None:
    """Add a legend with this number of lines next to the axes, which keep their size."""
    legend = drawing.legend(title=title, loc="outside right upper", ncols=ceil(lines / MOST))
    box = legend.get_window_extent()
    width, height = drawing.get_size_inches()
    drawing.set_size_inches(width + box.width / drawing.dpi, max(height, box.height / drawing.dpi + MARGIN))
