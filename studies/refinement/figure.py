"""The figure of a refinement: each number over the levels, and its distance from the limit.

The first panel shows limit and interval, the second the theoretical order.
"""

from collections.abc import Sequence
from math import isnan

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.figure import COLOURS, Item, band, curve, draw, level, literal, panel
from studies.refinement.ladder import KINDS, Ladder, Refined


def figure(found: Sequence[Refined], rungs: Ladder) -> Figure:
    """Return the figure with a row of panels for each quantity.

    A row shows its numbers, and their distance from the limit if there is one.
    """
    what = KINDS[rungs.kinds[0]].words if len(rungs.kinds) == 1 else "cells, steps and spans"
    label, limits = f"{what}, over the coarsest", any(map(has_limit, found))
    shown = (numbers, errors) if limits else (numbers,)
    return draw([drawn(label, one) for one in found for drawn in shown], len(shown))


def has_limit(one: Refined) -> bool:
    """Return whether a quantity has a limit."""
    return one.verdict is not None and not isnan(one.verdict.limit)


def numbers(label: str, one: Refined) -> Item:
    """Return the panel of the numbers over the refined size, with the limit and the interval."""
    items = [curve(1.0 / np.array(one.factors), one.numbers, None, "o-", COLOURS[0])]
    if one.verdict is not None and has_limit(one):
        items.append(level(one.verdict.limit, "limit", ":"))
    if one.interval is not None:
        items.append(band(*one.interval, "interval", COLOURS[0]))
    name = literal(f"{one.quantity} [{one.unit}]")
    return panel(label, name, *items, title=one.text, xlim=(0.0, 1.05))


def errors(label: str, one: Refined) -> Item:
    """Return the panel of the distance from the limit, with the theoretical order.

    It is empty without a limit.
    """
    if one.verdict is None or not has_limit(one):
        return Axes.set_axis_off
    size, error = 1.0 / np.array(one.factors), np.abs(np.array(one.numbers) - one.verdict.limit)
    kept = np.isfinite(error) & (error > 0.0)
    if not kept.any():
        return Axes.set_axis_off
    estimate = np.array(one.estimates) * abs(one.finest)
    estimated = [curve(size, estimate, "estimate for the compliance", "s--")] if one.estimates else []
    law = error[kept][0] * (size[kept] / size[kept][0]) ** one.theory
    return panel(
        label, f"distance from the limit [{one.unit}]",
        curve(size[kept], error[kept], f"order {one.verdict.order:.2f}", "o-", COLOURS[0]),
        curve(size[kept], law, f"theoretical order {one.theory:g}", ":"), *estimated, log="xy",
    )  # fmt: skip
