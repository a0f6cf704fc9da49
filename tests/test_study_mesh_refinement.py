"""The study of mesh refinement, quick: what must diverge does, at its rate, and what must converge does."""

from dataclasses import replace
from functools import cache

import pytest
from bounds import ORDER

from studies.figure import drawn
from studies.mesh_refinement import QUANTITIES, STUDY, VARIANTS, Row, judged, main, of, said
from studies.study import StudyError, arguments

BARE, POINTWISE, P2, SUBGRID = VARIANTS


@cache
def rows() -> tuple[Row, ...]:
    return tuple(main(**arguments(STUDY, "quick")))


@pytest.mark.parametrize("quantity", ["compliance_along", "compliance_normal"])
def test_what_has_no_limit_is_called_diverging_with_its_rate(quantity: str) -> None:
    """Independent check: 1/h for a bare point, 1/a for a footprint that shrinks; the verdict says so by itself."""
    for runs in (of(rows(), "cells", BARE), of(rows(), "footprint", SUBGRID)):
        found = judged(runs, quantity)
        assert found.kind == "diverging"
        assert abs(found.order + 1.0) < ORDER


def test_nothing_of_a_bare_point_is_called_converged() -> None:
    """Nor of a footprint that shrinks: what hangs on a hole without a limit has none."""
    for runs in (of(rows(), "cells", BARE), of(rows(), "footprint", SUBGRID)):
        assert not any(said(runs, quantity).startswith("converged") for quantity in QUANTITIES)


def test_footprint_and_sub_grid_converge_to_one_another() -> None:
    """Consistency check: their intervals of the compliance overlap; P1 alone is far from its limit and says so."""
    for quantity in ("compliance_along", "compliance_normal"):
        second, fine = (judged(of(rows(), "cells", variant), quantity) for variant in (P2, SUBGRID))
        assert (second.kind, fine.kind) == ("converged", "converged")
        a, b = (getattr(of(rows(), "cells", variant)[0], quantity) for variant in (P2, SUBGRID))
        assert abs(a - b) <= second.index * a + fine.index * b
        assert judged(of(rows(), "cells", POINTWISE), quantity).kind == "pre-asymptotic"
    assert all(judged(of(rows(), "cells", SUBGRID), quantity).kind == "converged" for quantity in QUANTITIES)


@pytest.mark.parametrize("quantity", ["displacement", "force", "drawn"])
def test_order_of_the_time_step(quantity: str) -> None:
    """Independent check: backward Euler."""
    assert abs(judged(of(rows(), "time step", SUBGRID), quantity).order - 1.0) < ORDER


def test_what_is_not_supported_is_said() -> None:
    """The bare point and the coarse cells at once; a far pull and a near edge when they come."""
    remarks = STUDY.remarks(rows())
    assert any(BARE in line and "NO LINEAR RANGE" in line for line in remarks)
    assert any(P2 in line and "TOO COARSE" in line for line in remarks)
    assert not any("BEYOND" in line or "TOO NEAR" in line for line in remarks)
    worse = [replace(row, displacement=1e-3, clear=False) for row in rows()]
    assert any("time step" in line and "BEYOND" in line for line in STUDY.remarks(worse))
    assert any("Δt = 0.5 ms" in line and "TOO NEAR" in line for line in STUDY.remarks(worse))


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
    assert len(shown.lines) == 4 * 5 + 5 + 2 * 3
    assert {len(line) for line in shown.lines} == {len(shown.head)}
    assert any(line[1] == BARE and line[-1].startswith("DIVERGING") for line in shown.lines)
    text = drawn(STUDY.figure, rows(), "sample")["svg"].decode()
    assert all(f"{name} [{unit}]" in text for name, unit in QUANTITIES.values())
