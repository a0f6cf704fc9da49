"""The figure of a refinement: each number over the levels, its limit and its interval, and how far it is from the
limit beside the order of theory.
"""

from collections.abc import Sequence
from math import isnan

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.figure import COLOURS, literal, panels, render_figure
from studies.refinement.ladder import KINDS, Ladder
from studies.refinement.refined import Refined


def pictures(found: Sequence[Refined], rungs: Ladder) -> dict[str, bytes]:
    """Render the figure by format."""
    return render_figure(lambda rows: figure(rows, rungs), found, "refinement")


def figure(found: Sequence[Refined], rungs: Ladder) -> Figure:
    """Draw a line of panels for each quantity: its numbers, and where one has a limit how far they are from it."""
    drawing, axes = panels(len(found), 2 if any(map(has_limit, found)) else 1)
    what = KINDS[rungs.kinds[0]].words if len(rungs.kinds) == 1 else "cells, steps and spans"
    for one, row in zip(found, axes, strict=True):
        draw_numbers(row[0], one)
        for right in row[1:]:
            draw_errors(right, one)
        for each in row:
            each.set_xlabel(f"{what}, over the coarsest")
    return drawing


def has_limit(one: Refined) -> bool:
    """Tell whether a quantity has a limit."""
    return one.verdict is not None and not isnan(one.verdict.limit)


def draw_numbers(axes: Axes, one: Refined) -> None:
    """Draw the numbers over the size of what is refined, with the limit and the interval."""
    size = 1.0 / np.array(one.factors)
    axes.plot(size, one.numbers, color=COLOURS[0], marker="o")
    if one.verdict is not None and not isnan(one.verdict.limit):
        axes.axhline(one.verdict.limit, color="black", linestyle=":", label="limit")
    if one.interval is not None:
        axes.axhspan(*one.interval, color=COLOURS[0], alpha=0.15, label="interval")
    axes.set_xlim(0.0, 1.05)
    axes.set_ylabel(literal(f"{one.quantity} [{one.unit}]"))
    axes.set_title(one.text)
    if axes.get_legend_handles_labels()[0]:
        axes.legend()


def draw_errors(axes: Axes, one: Refined) -> None:
    """Draw how far the numbers are from the limit, and the order of theory; nothing without a limit."""
    if one.verdict is None or isnan(one.verdict.limit):
        axes.set_axis_off()
        return
    size, error = 1.0 / np.array(one.factors), np.abs(np.array(one.numbers) - one.verdict.limit)
    kept = np.isfinite(error) & (error > 0.0)
    if not kept.any():
        axes.set_axis_off()
        return
    axes.loglog(size[kept], error[kept], color=COLOURS[0], marker="o", label=f"order {one.verdict.order:.2f}")
    law = error[kept][0] * (size[kept] / size[kept][0]) ** one.theory
    axes.loglog(size[kept], law, color="black", linestyle=":", label=f"order {one.theory:g} of theory")
    axes.set_ylabel(f"distance from the limit [{one.unit}]")
    axes.legend()
