"""The study of mesh refinement, quick: what must diverge does, at its rate, and what must converge does."""

import math
from dataclasses import replace
from functools import cache

import pytest

from studies.figure import render_figure
from studies.mesh_refinement.study import (
    FITTED,
    FOOTPRINT,
    QUANTITIES,
    VARIANTS,
    Row,
    formal_order,
    main,
    runs_of_ladder,
    verdict_on,
    verdict_text,
)
from studies.study import StudyError, arguments, study
from tests.bounds import ORDER

STUDY = study("mesh_refinement")

BARE, POINTWISE, P2 = VARIANTS
REACHED = 0.3  # of an order on meshes that a test can afford, about the one of theory


@cache
def rows() -> tuple[Row, ...]:
    return tuple(main(**arguments(STUDY, "quick")))


@pytest.mark.parametrize("quantity", ["compliance_along", "compliance_normal"])
def test_what_has_no_limit_is_called_diverging_with_its_rate(quantity: str) -> None:
    """Independent check: 1/h for a bare point, 1/a for a footprint that shrinks; the verdict says so by itself."""
    for runs in (runs_of_ladder(rows(), "cells", BARE), runs_of_ladder(rows(), "footprint", FITTED)):
        found = verdict_on(runs, quantity)
        assert found.kind == "diverging"
        assert abs(found.order + 1.0) < ORDER


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_nothing_of_a_bare_point_or_a_shrinking_footprint_has_a_limit(quantity: str) -> None:
    """What hangs on a hole without a limit has none either, and the verdict finds that by itself."""
    for runs in (runs_of_ladder(rows(), "cells", BARE), runs_of_ladder(rows(), "footprint", FITTED)):
        assert verdict_on(runs, quantity).kind == "diverging"


def test_what_hangs_on_a_diverging_hole_is_never_called_converged() -> None:
    """A number that the thread hardly lets move."""
    still = [replace(run, force=0.02) for run in runs_of_ladder(rows(), "cells", BARE)]
    assert verdict_on(still, "force").kind == "converged"
    assert verdict_text(still, "force").startswith("NOT CONVERGED")


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_orders_of_a_footprint(quantity: str) -> None:
    """Independent check: h⁴ ln(a/h) with P2, whose changes are of order 4 − 1/(ln(a/h) − ¼) between meshes that are
    nearly the same; with P1 the order comes nearer to two with every rung."""
    second = runs_of_ladder(rows(), "cells", P2)
    near = [replace(run, cells=cells) for run, cells in zip(second, (104, 100, 96), strict=True)]
    assert formal_order(near) == pytest.approx(4.0 - 1.0 / (math.log(FOOTPRINT / near[1].size) - 0.25), abs=1e-3)
    assert abs(verdict_on(second, quantity).order - formal_order(second)) < REACHED
    first = runs_of_ladder(rows(), "cells", POINTWISE)
    fine, coarse = (verdict_on(runs, quantity).order for runs in (first, first[1:]))
    assert 1.0 < coarse < fine < 2.0 + ORDER


def test_both_elements_converge_to_one_another() -> None:
    """Consistency check: what P1 and P2 converge to is one number."""
    for quantity in QUANTITIES:
        second = verdict_on(runs_of_ladder(rows(), "cells", P2), quantity)
        assert second.kind == "converged"
        assert verdict_on(runs_of_ladder(rows(), "cells", POINTWISE), quantity).limit == pytest.approx(
            second.limit, rel=0.02
        )


def test_order_of_all_refined_together() -> None:
    """Independent check: two, of P1 in h and of backward Euler in steps like h², which P1 comes near to on meshes that
    a test can afford; the thread adds less to what the tissue moves by. (Force and drawn length swing with where a hole
    is in a span of knots that stay.)"""
    runs = runs_of_ladder(rows(), "coupled", POINTWISE)
    assert [round(0.05 / run.dt) for run in runs] == [50, 32, 18]
    found = verdict_on(runs, "displacement")
    assert 1.0 + REACHED < found.order < 2.0 + ORDER and found.index < 0.1


@pytest.mark.parametrize("quantity", ["displacement", "force", "drawn"])
def test_order_of_the_time_step(quantity: str) -> None:
    """Independent check: backward Euler."""
    assert abs(verdict_on(runs_of_ladder(rows(), "time step", P2), quantity).order - 1.0) < ORDER


def test_what_is_not_supported_is_said() -> None:
    """The bare point at once; coarse cells, a far pull and a near edge when they come."""
    remarks = list(STUDY.remarks(rows()))
    assert any(BARE in line and "NO LINEAR RANGE" in line for line in remarks)
    assert not any("TOO COARSE" in line for line in remarks)
    assert [line.split(",")[0] for line in remarks if "BEYOND" in line] == ["footprint"]
    coarse = [replace(row, cells=4) for row in rows() if row.ladder == "cells"]
    assert any(P2 in line and "TOO COARSE" in line for line in STUDY.remarks(coarse))
    worse = [replace(row, displacement=1e-3) for row in rows()]
    assert any("time step" in line and "BEYOND" in line for line in STUDY.remarks(worse))


@pytest.mark.parametrize(
    ("ladder", "words"), [({"steps": (1e-3, 2e-3)}, "steps = [0.001, 0.002]"), ({"p1_cells": (8, 12, 16)}, "8, 16, 24")]
)
def test_ladders_without_a_verdict_are_refused(ladder: dict[str, tuple[float, ...]], words: str) -> None:
    with pytest.raises(StudyError) as caught:
        next(main(**ladder))  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_table_and_figure() -> None:
    """A line for every quantity of every ladder that can change it, and an axis with its unit for each."""
    shown = STUDY.table(rows())
    assert len(shown.lines) == 3 * 5 + 5 + 3 * 3
    assert {len(line) for line in shown.lines} == {len(shown.head)}
    assert any(line[1] == BARE and line[-1].startswith("DIVERGING") for line in shown.lines)
    text = render_figure(STUDY.figure, rows(), "sample")["svg"].decode()
    assert all(f"{name} [{unit}]" in text for name, unit in QUANTITIES.values())
