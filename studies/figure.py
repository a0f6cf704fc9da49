"""The style of the studies' figures: colours for colour-blind readers, and two formats.

A figure has rows of panels (`draw`), and a panel has labels and items (`panel`). The labels of a
study's panels are in its `study.toml` (`described`). An item draws itself into axes: a `curve`, a
curve for each group of rows (`series`), a `level`, a `band`, or a function of the axes.
"""

import io
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import cycle
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.arrays import UNITS, Array
from studies.lists import list_of, study_list
from studies.output.files import write_bytes

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe & Ito (2008)
MARKERS = ("o", "s", "^", "D", "v", "P")
STYLE: dict[str, Any] = list_of(__file__, "figure.toml")["style"]
PANEL = (4.2, 3.4)  # [inch]
DPI = 120


def panels(lines: int, columns: int) -> tuple[Figure, np.ndarray]:
    """Return a figure and its axes `(lines, columns)`."""
    drawing = Figure(figsize=(PANEL[0] * columns, PANEL[1] * lines), layout="constrained")
    return drawing, drawing.subplots(lines, columns, squeeze=False)


Item = Callable[[Axes], object]
Value = str | int | Callable[[Any], float]


def draw(placed: Sequence[Item], columns: int = 2) -> Figure:
    """Return a figure of panels, row by row."""
    drawing, grid = panels(len(placed) // columns, columns)
    for axes, item in zip(grid.ravel(), placed, strict=True):
        item(axes)
    return drawing


def described(name: str, *items: Sequence[Any], **values: Any) -> list[Item]:
    """Return the panels that a study's `study.toml` describes, each with its items.

    The title of a panel can name `values`. Arguments of `panel` that depend on the rows are a dict
    among its items.
    """
    out = []
    for settings, own in zip(study_list(name)["panel"], items, strict=True):
        more = dict(pair for item in own if isinstance(item, dict) for pair in item.items())
        given = settings | {"title": settings.get("title", "").format(**values)} | more
        out.append(panel(given.pop("x"), given.pop("y"), *filter(callable, own), **given))
    return out


def panel(
    x: str,
    y: str,
    *items: Item,
    log: str = "",
    ticks: Mapping[str, Any] | None = None,
    above: float = 1.0,
    legend: Mapping[str, Any] | None = None,
    **limits: Any,
) -> Item:
    """Return a panel.

    It has labels with units, items, logarithmic axes ("x", "y" or "xy") and plain `ticks` by axis.
    `above` is a factor on the upper limit, for the room of the legend. `legend` are arguments of
    the legend, `limits` arguments of `Axes.set`.
    """

    def drawn(axes: Axes) -> None:
        for item in items:
            item(axes)
        axes.set(xlabel=x, ylabel=y, **{f"{axis}scale": "log" for axis in log}, **limits)
        for axis, values in (ticks or {}).items():
            set_ticks(axes, axis, values)
        if above != 1.0:
            axes.set_ylim(top=above * axes.get_ylim()[1])
        if axes.get_legend_handles_labels()[0]:
            axes.legend(**legend or {})

    return drawn


def curve(x: Any, y: Any, label: str | None = None, style: str = "-", colour: str = "black", **looks: Any) -> Item:
    """Return a curve in a style of matplotlib; `looks` are arguments of `Axes.plot`."""
    return lambda axes: axes.plot(x, y, style, color=colour, label=label, **looks)


def deviations(x: Any, mean: Any, deviation: Any, label: str) -> Item:
    """Return means with their standard deviations, as hollow markers."""
    looks: dict[str, Any] = {"fmt": "s", "markerfacecolor": "white", "capsize": 4, "zorder": 5, "color": "black"}
    return lambda axes: axes.errorbar(x, mean, deviation, label=label, **looks)


def value(of: Value) -> Callable[[Any], float]:
    """Return the function that reads a number of a row.

    `of` is the name of a field with its unit in the figure, for example "drift [mm]", the index in
    a tuple, or the function itself.
    """
    if callable(of):
        return of
    if isinstance(of, int):
        return itemgetter(of)
    name, _, unit = of.rstrip("]").partition(" [")
    return lambda row: getattr(row, name) / UNITS.get(unit, 1.0)


def series(
    groups: Mapping[str, Sequence[Any]],
    x: Value,
    y: Value,
    line: str = "-",
    markers: Sequence[str] = MARKERS,
    colours: Sequence[str] = COLOURS,
    **looks: Any,
) -> Item:
    """Return one curve for each group of rows, each with its colour, marker and name.

    A group whose name begins with "_" is not in the legend.
    """

    def drawn(axes: Axes) -> None:
        for k, (label, rows) in enumerate(groups.items()):
            marker = markers[(k + k // len(colours)) % len(markers)]  # another marker if colours are repeated
            values = [[value(of)(row) for row in rows] for of in (x, y)]
            axes.plot(*values, marker + line, color=colours[k % len(colours)], label=label, **looks)

    return drawn


def unnamed(groups: Mapping[str, Sequence[Any]]) -> dict[str, Sequence[Any]]:
    """Return groups of rows whose curves are not in the legend."""
    return {f"_{name}": rows for name, rows in groups.items()}


def several(rows: Sequence[Any], x: Value, values: Mapping[str, Value], **looks: Any) -> Item:
    """Return one curve for each of several values of the same rows."""
    pairs = {label: [(value(x)(row), value(y)(row)) for row in rows] for label, y in values.items()}
    return series(pairs, 0, 1, **looks)


def laws(functions: Iterable[Callable[[Array], Any]], x: Array, style: str = "-") -> Item:
    """Return the curve of each function over x, in the colours of a `series`."""

    def drawn(axes: Axes) -> None:
        for function, colour in zip(functions, cycle(COLOURS)):
            axes.plot(x, function(x), style, color=colour)

    return drawn


def both(*items: Item) -> Item:
    """Return several items as one."""
    return lambda axes: [item(axes) for item in items]


def level(value: float, label: str | None = None, style: str = "--", colour: str = "black") -> Item:
    """Return a level line through the panel at a value of y."""
    looks: dict[str, Any] = {"color": colour, "linestyle": style, "linewidth": 0.8}
    return lambda axes: axes.axhline(value, label=label, **looks)


def band(low: float, high: float, label: str, colour: str) -> Item:
    """Return a level stripe through the panel between two values of y."""
    return lambda axes: axes.axhspan(low, high, color=colour, alpha=0.12, label=label)


def literal(words: str) -> str:
    """Return words for matplotlib in which a dollar sign does not begin a formula."""
    return words.replace("$", r"\$")


def set_ticks(axes: Axes, axis: str, values: Sequence[float]) -> None:
    """Set plain numbers on an axis, logarithmic or not."""
    {"x": axes.set_xticks, "y": axes.set_yticks}[axis](values, [f"{value:.3g}" for value in values])
    axes.minorticks_off()


@contextmanager
def styled(**more: str) -> Iterator[None]:
    """Draw in the style. A letter that the font lacks is a box, without a warning."""
    with rc_context({**STYLE, **more}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        yield


def write_figure(figure: Callable[[Sequence[Any]], Figure], rows: Sequence[Any], name: str, folder: Path) -> None:
    """Write a study's figure into a folder, in each format."""
    for kind, picture in render_figure(figure, rows, name).items():
        write_bytes(folder / f"figure.{kind}", picture)


def render_figure(figure: Callable[[Sequence[Any]], Figure], rows: Sequence[Any], name: str) -> dict[str, bytes]:
    """Return a study's figure by format; equal rows give equal bytes."""
    pictures = {}
    with styled(**{"svg.hashsalt": name}):
        drawing = figure(rows)
        for kind in ("png", "svg"):
            buffer = io.BytesIO()
            metadata = {"Date": None} if kind == "svg" else None
            drawing.savefig(buffer, format=kind, dpi=DPI, metadata=metadata)
            pictures[kind] = buffer.getvalue()
    return pictures
