"""The study of adaptive refinement, small: adaptive meshes take fewer unknowns, and their estimate is the error."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from studies.adaptive_refinement.study import (
    ADAPTIVE,
    ASKED,
    EFFECTIVITY,
    GRADED,
    UNIFORM,
    Row,
    figure,
    main,
    needed,
    remarks,
)
from studies.figure import render_figure
from studies.study import StudyError
from tests.bounds import TWO_SOLVERS
from tests.tissue.layers import HALF_SPACE

SMALL: dict[str, Any] = {
    "footprints": (5e-4,),
    "cases": (),
    "uniform": (8e-3, 4e-3),
    "graded": (1.0, 0.5),
    "accuracies": (0.2, 0.05),
    "reference": 0.01,
}
E, NU = 1e5, 0.45  # of its scene
BLOCK = 0.05  # of the compliance: the bed and the sides of a block of 40 footprints in depth, and the mesh


@cache
def rows() -> tuple[Row, ...]:
    return tuple(main(**SMALL))


def test_every_mesh_is_too_stiff_and_adaptive_ones_least() -> None:
    """Independent check: Galerkin; uniform meshes, whose error falls with the unknowns as fast as the element lets any
    fall, would need more than twice the unknowns of an adaptive one."""
    assert all(row.error > 0.0 for row in rows())
    for element, order in (("P1", 2.0 / 3.0), ("P2", 4.0 / 3.0)):
        own = [row for row in rows() if row.element == element]
        best = min((row for row in own if row.mesh == ADAPTIVE), key=lambda row: row.error)
        uniform = min((row for row in own if row.mesh == UNIFORM), key=lambda row: row.error)
        assert best.unknowns < 0.5 * uniform.unknowns * (uniform.error / best.error) ** (1.0 / order)


def test_the_estimate_is_near_the_error() -> None:
    """Consistency check: to a finer mesh, of adaptive and of graded meshes."""
    for row in rows():
        if row.mesh in (ADAPTIVE, GRADED):
            assert EFFECTIVITY[0] <= row.effectivity <= EFFECTIVITY[1]


def test_a_small_footprint_is_on_a_half_space() -> None:
    """Independent check: its compliance along the normal in closed form, (1 − ν²)S/πE."""
    best = min(rows(), key=lambda row: row.error)
    exact = (1.0 - NU**2) * HALF_SPACE["parabolic"] / (np.pi * E * best.footprint)
    assert best.normal == pytest.approx(exact, rel=BLOCK)


def test_unknowns_for_an_error_are_read_between_meshes() -> None:
    """Independent check: of an error that falls like a power of the unknowns, a straight line on these axes."""
    row = rows()[0]
    planted = [replace(row, unknowns=n, error=1e5 / n**1.5) for n in (1_000, 10_000, 100_000)]
    assert needed(planted, "unknowns") == pytest.approx((1e5 / ASKED) ** (1 / 1.5), rel=TWO_SOLVERS)
    assert np.isnan(needed(planted[:1], "unknowns"))


def test_estimates_far_from_the_error_are_remarked() -> None:
    """Independent check: a planted row; the figure is drawn of an odd number of cases too."""
    (row, *_) = (row for row in rows() if row.mesh == ADAPTIVE)
    wrong = replace(row, estimate=2.0 * row.error)
    assert any("ESTIMATE 2 times" in text for text in remarks([wrong]))
    assert len(render_figure(figure, rows(), "adaptive_refinement")["png"]) > 5000


@pytest.mark.parametrize(
    "given", [{"cases": ("corner",)}, {"elements": ("P3",)}, {"footprints": (0.01,)}, {"reference": 0.1}]
)
def test_what_cannot_be_compared_is_refused(given: dict[str, Any]) -> None:
    """Independent check: before anything is computed."""
    with pytest.raises(StudyError):
        next(iter(main(**{**SMALL, **given})))
