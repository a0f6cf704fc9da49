"""The study of friction, quick: its ratios are those of theory, and what locks or was not found is said."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from studies.figure import render_figure
from studies.friction.study import (
    Row,
    branches,
    coefficients,
    error,
    loops_of,
    main,
    order_in_number,
    rows_of_kind,
    two_passes,
)
from studies.study import StudyError, arguments, study
from studies.theory import point_ratio
from tests.bounds import ORDER

STUDY = study("friction")

RATIO = 1e-3  # of a ratio of pulls: as far on either side of the threshold it sticks and slips


@cache
def rows() -> tuple[Row, ...]:
    return tuple(main(**arguments(STUDY, "quick")))


@pytest.mark.parametrize("kind", ["one hole", "two passes, hold given", "two passes, pull given", "holes in a row"])
def test_ratios(kind: str) -> None:
    """Independent check: the balance at one hole, its product, and the closed forms of the lag; all settled."""
    for mu in coefficients(rows()):
        found = rows_of_kind(rows(), kind, mu)
        assert len(found) == 3 and all(row.settled for row in found)
        assert error(found) < RATIO


def test_the_law_at_one_hole_is_no_capstan() -> None:
    """Independent check: at 90° and μ = 0.3 the hole asks for 13/7, the capstan for 1.60, which rows of holes reach
    with the square of their number."""
    (seen,) = [row for row in rows_of_kind(rows(), "one hole", 0.3) if row.turn == 90.0]
    assert seen.ratio == pytest.approx(13.0 / 7.0, rel=RATIO)
    assert seen.ratio > 1.1 * np.exp(0.3 * np.pi / 2)
    for mu in coefficients(rows()):
        assert abs(order_in_number(rows_of_kind(rows(), "holes in a row", mu)) - 2.0) < ORDER


def test_loop_of_the_load() -> None:
    """Independent check (elastica): out at the ratio of a thread that bends, back at one over it, through two holes at
    the product; between them it sticks."""
    for mu, holes in loops_of(rows()):
        out, back = branches(rows_of_kind(rows(), "loop", mu, holes))
        assert all(row.settled and row.ratio > 1.0 for row in out)
        assert error(out) < RATIO and error(back) < RATIO
        assert not back[0].settled and all(row.settled and row.ratio < 1.0 for row in back[len(back) // 2 :])
    for mu in coefficients(rows()):
        one, two = (branches(rows_of_kind(rows(), "loop", mu, holes))[0][-1].ratio for holes in (1, 2))
        assert one**1.9 < two < one**2.1


def test_what_locks_and_what_was_not_found_is_said() -> None:
    """Two passes with the pull given lock at 2μt ≥ 1, before the exact law does at μt ≥ 1."""
    hold, pull = two_passes(0.3, 120.0)
    assert np.isinf(pull.ratio) and np.isinf(pull.theory) and not pull.settled
    assert (
        hold.settled
        and np.isfinite(point_ratio(0.3, np.radians(120.0)))
        and np.isinf(point_ratio(1.0, np.radians(91.0)))
    )
    said = list(STUDY.remarks([*rows(), pull]))
    assert any("LOCK at 120°" in line for line in said)
    assert not any("LOCK" in line or "NOT FOUND" in line for line in STUDY.remarks(rows()))
    lost = [replace(row, settled=False) if row.kind == "one hole" else row for row in rows()]
    assert sum("NOT FOUND" in line for line in STUDY.remarks(lost)) == 6


@pytest.mark.parametrize("given", [{"mus": (0.0,)}, {"turns": (180.0,)}, {"rows_of_holes": (1,)}, {"loop_holes": (0,)}])
def test_what_has_no_threshold_is_refused(given: dict[str, tuple[float, ...]]) -> None:
    with pytest.raises(StudyError, match="give coefficients"):
        next(main(**given))  # type: ignore[arg-type]


def test_table_and_figure() -> None:
    shown = STUDY.table(rows())
    assert len(shown.lines) == 2 * (3 + 6 + 3 + 4)
    assert {len(line) for line in shown.lines} == {len(shown.head)}
    text = render_figure(STUDY.figure, rows(), "sample")["svg"].decode()
    assert all(label in text for label in ("turn θ [°]", "holes in a row N [-]", "way of the hand [mm]"))
