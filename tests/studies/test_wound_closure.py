"""The study of wound closure, coarse: theory of a large sheet, stitches, lips, and what is held against print."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from coupling.joins.contact import observe_contact
from studies.study import StudyError, arguments, study
from studies.wound_closure.study import (
    CROSSED,
    IN_TURN,
    SOURCES,
    TOGETHER,
    Row,
    comparisons,
    main,
    remarks,
    row_with,
    table,
    turns,
)
from studies.wounds import NEAR, PRECISE, THICKNESS, Case, E, Hands
from tests.bounds import TWO_SOLVERS

STUDY = study("wound_closure")

NARROW, WIDE = SOURCES[0].wounds
COARSE = Case(*NARROW, sheet=0.1, size=2.5e-3, far=15e-3, pitch=5e-3, bite=4e-3)


@cache
def rows() -> tuple[Row, ...]:
    """The narrow wound, both ways."""
    return tuple(main((NARROW,), COARSE.sheet, COARSE.size, COARSE.far, checks=()))


@cache
def hands() -> Hands:
    """Its stitches, not drawn yet."""
    return Hands(COARSE)


def test_a_uniform_traction_closes_a_large_sheet() -> None:
    """Independent check: held edges are felt with the square of the wound's length over theirs, and far away the
    traction is EW/(4c), within 1 % of the mesh."""
    cases = [replace(COARSE, width=WIDE[1], sheet=sheet) for sheet in (0.1, 0.2)]
    near, far = (Hands(case).uniform_traction - 1.0 for case in cases)
    assert 0.1 < near < 0.3 and abs((4.0 * far - near) / 3.0) < 0.02  # the limit of both


def test_an_open_wound_answers_in_proportion() -> None:
    """Independent check: while its lips are open, the sheet is linear and the thread hardly stretched: a stitch that is
    drawn three times as far bears three times as much, and closes three times as much."""
    at, n = hands(), len(COARSE.places)
    once, thrice = (at.draw(at.straight_state, length * np.eye(n)[2]) for length in (1e-4, 3e-4))
    assert at.forces(thrice) == pytest.approx(3.0 * at.forces(once), rel=0.02, abs=1e-4 * at.forces(thrice).max())
    closing = [at.gaps(at.straight_state, COARSE.places) - at.gaps(state, COARSE.places) for state in (once, thrice)]
    assert closing[1] == pytest.approx(3.0 * closing[0], rel=0.02)
    assert at.forces(once)[2] > 0.0 > np.delete(at.forces(once), 2).max()  # what closes one slackens the others


@pytest.mark.parametrize("way", [TOGETHER, IN_TURN])
def test_lips_are_together_and_do_not_cross(way: str) -> None:
    """Independent check: every stitch holds the lips as near as was asked, no pair crosses, and contact only pushes."""
    row = row_with(rows(), NARROW, way)
    assert row is not None and row.closed and row.pushes
    assert row.smallest_gap >= -CROSSED * row.width
    assert row.complementarity <= TWO_SOLVERS * row.contact_force * row.width
    gaps = np.interp(row.places, row.along, row.gaps)
    assert np.all(gaps <= NEAR * COARSE.opening(COARSE.places) + PRECISE * row.width)


def test_forces_are_those_of_the_theory_and_more() -> None:
    """Independent check: stitches act at points and away from the lips, so they take more than the uniform traction,
    but not half as much again in the middle; both halves of the wound take the same."""
    row = row_with(rows(), NARROW, TOGETHER)
    assert row is not None and row.theory == pytest.approx(E * THICKNESS * row.width / 12.0)
    assert row.uniform < row.middle / row.theory < 1.5 * row.uniform
    assert sum(row.forces) / (len(row.forces) * row.theory) > row.uniform
    left, right = np.array(row.forces[:3]), np.array(row.forces[:2:-1])
    assert left[1:] == pytest.approx(right[1:], rel=0.1)


def test_stitches_not_tied_yet_are_slack() -> None:
    """Independent check: one after another, the first alone brings its lips together and the others bear nothing."""
    at, n = hands(), len(COARSE.places)
    (tying, slack), *_ = turns(n, IN_TURN)
    state, done = at.tighten(at.straight_state, tying, slack)
    forces, lips = at.forces(state), observe_contact(at.assembly.system, state)
    assert done and forces[0] > 0.0 and np.abs(forces[1:]).max() <= 1e-3 * forces[0]
    assert lips is not None and lips.gap.min() >= 0.0 - CROSSED * COARSE.width
    row = row_with(rows(), NARROW, IN_TURN)
    assert row is not None and row.tied[0] == pytest.approx(forces[0], rel=1e-3)
    assert row.tied[-1] == pytest.approx(row.forces[-1]) and row.forces[0] < row.tied[0]


def test_one_number_is_fitted_and_the_other_predicted() -> None:
    """Consistency check: the stiffness that is fitted gives back what it is fitted to; the other wound is scaled by it;
    what disagrees with print is said."""
    together = row_with(rows(), NARROW, TOGETHER)
    assert together is not None
    forces = tuple(3.0 * force for force in together.forces)
    wide = replace(together, length=WIDE[0], width=WIDE[1], forces=forces, uniform=1.05 * together.uniform)
    fitted, predicted = comparisons([together, wide])
    assert fitted.fitted == pytest.approx(E * THICKNESS * SOURCES[0].forces[0] / np.mean(together.forces[2:4]))
    in_turn = row_with(rows(), NARROW, IN_TURN)
    assert in_turn is not None and in_turn.comparable_force == max(in_turn.tied) > max(in_turn.forces)
    assert fitted.is_fit and fitted.predicted_force == pytest.approx(SOURCES[0].forces[0])
    assert not predicted.is_fit and predicted.predicted_force == pytest.approx(3.0 * SOURCES[0].forces[0])
    said = list(remarks([together, wide]))
    assert any("+5.0 % of it from the edges of the sheet; published: 1.5 N (+0 %)" in remark for remark in said)
    assert any("30 × 15 mm: closing turns the lips by up to 0.5 rad" in remark for remark in said)
    assert any("bearing strains" in remark and "BEYOND" in remark for remark in said)
    assert any(
        "NOT CONVERGED" in remark
        for remark in remarks([together, replace(wide, length=0.03, width=0.005, variant="x")])
    )
    assert {len(line) for line in table(rows()).lines} == {len(table(rows()).head)}


def test_lips_that_cross_are_said() -> None:
    """Consistency check: a run whose lips cross, or that was not closed, is not passed off as one that did."""
    row = rows()[0]
    assert any("CROSS" in remark for remark in remarks([replace(row, smallest_gap=-1e-6)]))
    pulled = list(remarks([row, replace(row, pushes=False)]))
    assert "some forces PULL" in pulled[-1] and any("CROSS" in remark for remark in pulled)
    assert "no force pulls" in list(remarks([row]))[-1]
    assert any("NOT BROUGHT TOGETHER" in remark for remark in remarks([replace(row, closed=False)]))
    assert not any("CROSS" in remark for remark in remarks([row]))


def test_refusals() -> None:
    """Independent check: a wound that does not fit its sheet is refused before anything is computed."""
    for wound in ((0.03, 0.04), (0.06, 0.01), (0.004, 0.001)):
        with pytest.raises(StudyError, match="in a sheet of"):
            next(main((wound,), sheet=0.1))
    for wrong in ({"pitch": 0.0}, {"bite": -1e-3}):
        with pytest.raises(StudyError, match="give lengths above 0"):
            next(main((NARROW,), **wrong))
    with pytest.raises(StudyError, match="allowed are finer mesh"):
        next(main((NARROW,), checks=("finest mesh",)))
    assert arguments(STUDY, "quick", ["bite=3e-3"])["bite"] == 3e-3
