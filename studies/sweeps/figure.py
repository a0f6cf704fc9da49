"""The figure of a sweep: one column of its table over another, a line for each value of a third."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from studies.figure import COLOURS, MARKERS, panels, render_figure
from studies.output.files import write_bytes
from studies.sweeps.table import Column, SweepTable, drawn_columns


def write_figure(table: SweepTable, names: Sequence[str], folder: Path) -> None:
    """Draw columns into ``figure.png`` and ``figure.svg``. Raises `ScenarioError`."""
    drawn = drawn_columns(table, names)
    for kind, picture in render_figure(lambda rows: figure(drawn), (), "sweep").items():
        write_bytes(folder / f"figure.{kind}", picture)


def figure(drawn: Sequence[Column]) -> Figure:
    """Draw the second of two columns over the first, a line for each value of a third where there is one."""
    drawing, ((axes,),) = panels(1, 1)
    x, y, *by = drawn
    lines = list(dict.fromkeys(by[0].values)) if by else [None]
    for number, line in enumerate(lines):
        rows = [k for k in range(len(x.values)) if not by or by[0].values[k] == line]
        points = sorted((x.values[k], y.values[k]) for k in rows if x.values[k] is not None and y.values[k] is not None)
        style = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)]}
        label = f"{line:.4g}" if isinstance(line, float) else str(line)
        axes.plot([p[0] for p in points], [p[1] for p in points], label=label, **style)
    axes.set_xlabel(x.heading)
    axes.set_ylabel(y.heading)
    if by:
        axes.legend(title=by[0].heading)
    return drawing
