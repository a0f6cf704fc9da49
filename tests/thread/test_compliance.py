"""The compliance that a spline lacks where a hole turns or bends it."""

import numpy as np
import pytest

from thread.compliance import POWERS, missing_on, patch_of
from thread.knots import clamped_knots
from thread.spline import FALLING, POWER, Spline

SPANS = 31
MIDDLE = 15
INTERPOLATED = 1e-6  # the rod's answer on a span by a polynomial
JUMP = 1e-3  # of what is lacked in a span, and of its slope over one
SPLINE = Spline(clamped_knots(np.linspace(0.0, 1.0, SPANS + 1)))


@pytest.mark.parametrize("ratio", [0.1, 1.0, 3.0, 20.0])
def test_spline_and_lack_are_a_rod_under_tension(ratio: float) -> None:
    """Independent check (both halves of a pinned rod under tension, in closed form): in the middle of a span that is
    `ratio` times √(EI/T), what the spline gives way and what it lacks are together what the rod does."""
    patch = patch_of(SPLINE, MIDDLE)
    layer, half = (patch.end - patch.start) / ratio, 0.5 * (patch.high - patch.low)
    x = 0.5 * (patch.end - patch.start)
    lack = missing_on(patch, layer)[0] @ x**POWERS
    values, slopes = ((FALLING[k] * x ** POWER[k]) @ patch.values for k in (0, 1))
    deflection, slope = (b @ patch.inverse(layer) @ b + c for b, c in ((values, lack[0]), (slopes, lack[2])))
    assert deflection == pytest.approx(0.5 * layer**2 * (half - layer * np.tanh(half / layer)), rel=INTERPOLATED)
    assert slope == pytest.approx(0.5 * layer * (1.0 / np.tanh(half / layer) - layer / half), rel=INTERPOLATED)


@pytest.mark.parametrize("layer", [np.inf, 0.03, 0.01, 1e-3])
def test_the_lack_goes_on_from_span_to_span(layer: float) -> None:
    """Independent check (the rod knows of no knots, so what a hole there stores cannot jump, nor the force along the
    thread by which it goes, the slope of c₀, c₂ and c₃): on spans that differ."""
    breaks = np.cumsum(np.append(0.0, 0.03 + 0.01 * np.sin(np.arange(30.0) ** 2)))
    spline = Spline(clamped_knots(breaks))
    of_spans = [missing_on(patch_of(spline, span), layer) for span in range(len(breaks) - 1)]
    lacks, slopes = ([each[k] for each in of_spans] for k in (0, 1))
    for k in range(3, len(breaks) - 4):
        h, middle = breaks[k + 1] - breaks[k], lacks[k] @ (0.25 * (breaks[k + 1] - breaks[k])) ** POWERS
        size = np.array([middle[0], np.sqrt(middle[0] * middle[2]), middle[2], middle[2]])
        assert (np.abs(lacks[k] @ h**POWERS - lacks[k + 1][:, 0]) <= JUMP * size).all()
        steeper = np.abs(slopes[k] @ h**POWERS - slopes[k + 1][:, 0])[[0, 2, 3]]
        assert (steeper * h <= JUMP * size[[0, 2, 3]]).all()
