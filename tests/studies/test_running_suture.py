"""The study of a running suture, coarse: three stitches in points fixed in space."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from studies.figure import render_figure
from studies.running_suture.study import (
    BACK,
    CALIBRATED,
    LEFT,
    ONE,
    PLACING,
    Row,
    calibrate,
    law_error,
    main,
    rows_at,
    runs,
    sequence,
)
from studies.study import StudyError, study
from studies.theory import tensions_by_law
from studies.verdicts import SETTLED
from tests.bounds import ADAPTED, IDENTITY

STUDY = study("running_suture")

MUS, HOLD = (0.1, 0.2), 0.4


@cache
def rows() -> tuple[Row, ...]:
    return tuple(main(MUS, stitches=3, holds=(HOLD,), fixed=True))


def test_law_of_segments() -> None:
    """Independent check (Coulomb): no hole passes more than its ratio, no more slips than must, and what a pull has
    reached stays when the same hand pulls again."""
    ratios = np.array([1.3, 1.2, 1.4, 1.1])
    laid = np.full(5, 0.1)
    pulled = tensions_by_law(laid, 1.0, ratios)
    assert pulled[-1] == 1.0 and pulled[0] == pytest.approx(1.0 / np.prod(ratios), rel=IDENTITY)
    back = tensions_by_law(pulled, 0.5, ratios)
    for tensions in (pulled, back):
        assert all(
            a / r * (1 - IDENTITY) <= b <= a * r * (1 + IDENTITY)
            for r, (b, a) in zip(ratios, pairwise(tensions), strict=True)
        )
    assert back[0] == pulled[0] and back[-2] == pytest.approx(0.5 * 1.1, rel=IDENTITY)
    np.testing.assert_array_equal(tensions_by_law(back, 0.5, ratios), back)


def test_a_pull_falls_off_by_the_law_of_a_ring() -> None:
    """Independent check: elastica at each hole with the turn measured there, two holes a stitch; at rest when seen."""
    (reference,) = runs(rows(), CALIBRATED)
    assert [run[0].mu for run in runs(rows(), ONE)] == [*MUS] and reference[0].mu == calibrate(rows())
    for run in (*runs(rows(), ONE), reference):
        assert 0.0 < law_error(run) < ADAPTED
        tensions = [row.tension for _, row in sorted(rows_at(run).items())]
        assert all(b < a / (1 + run[0].mu) ** 2 for a, b in pairwise(tensions))
    assert all(row.settled < SETTLED for row in rows())


def test_one_number_is_calibrated() -> None:
    """The coefficient found by interpolation leaves the published tension; more friction leaves less."""
    assert rows_at(runs(rows(), CALIBRATED)[0])[BACK].tension == pytest.approx(LEFT, rel=ADAPTED)
    more, mu, less = (calibrate(rows(), left) for left in (1.1 * LEFT, LEFT, 0.9 * LEFT))
    assert MUS[0] < more < mu < less < MUS[1]


def test_a_pull_let_back_leaves_tension() -> None:
    """Independent check (Coulomb): next to the hand the holes slip back, and more is left than the hand holds."""
    let = [row for row in rows() if (row.kind, row.moment) == (CALIBRATED, "let back")]
    last = {row.stitches_back: row for row in let}
    assert last[0].tension == pytest.approx(last[0].hand, rel=ADAPTED)
    assert last[1].tension == pytest.approx(last[1].law, rel=ADAPTED)
    assert last[1].tension > (1 + 2 * calibrate(rows())) * last[1].hand


def test_stitches_placed_one_after_the_other() -> None:
    """Independent check: what a pull reaches by slip obeys the law of a ring, whatever the stitches went through."""
    (placed,) = runs(rows(), PLACING)
    assert {row.stitches for row in placed} == {2, 3}
    assert law_error(placed) < ADAPTED
    assert rows_at(placed)[0].tension == pytest.approx(3.0, rel=ADAPTED)


def test_what_disagrees_is_said() -> None:
    run = rows_at(runs(rows(), CALIBRATED)[0])
    same = {**run, 3: replace(run[2], stitches=5)}
    assert "DISAGREES" not in sequence(same)
    assert "(DISAGREES)" in sequence({**same, 2: replace(run[2], tension=1.4)})
    assert sequence({**same, 3: replace(run[2], tension=0.6)}).endswith("SD 0.3 N: DISAGREES)")
    fast = [replace(row, settled=1e-3, mu=0.15) if row.mu == MUS[0] else row for row in rows()]
    said = list(STUDY.remarks([*rows(), *(row for row in fast if row.mu == 0.15)]))
    assert any("NOT SETTLED" in line for line in said)
    assert not any("NOT SETTLED" in line for line in STUDY.remarks(rows()))


@pytest.mark.parametrize("given", [{"stitches": 2}, {"mus": (-0.1,)}, {"mus": (0.1, 1.5)}, {"holds": (0.0,)}])
def test_what_cannot_be_calibrated_is_refused(given: dict[str, object]) -> None:
    with pytest.raises(StudyError, match="give more than 2 stitches"):
        next(main(**given))  # type: ignore[arg-type]


def test_coefficients_that_do_not_bracket_are_refused() -> None:
    with pytest.raises(StudyError, match="both more and less than"):
        calibrate(rows(), 2.9)


def test_table_and_figure() -> None:
    shown = STUDY.table(rows())
    assert len(shown.lines) == 1 + len(runs(rows(), ONE, CALIBRATED, PLACING)) == 1 + 3 + 1
    assert {len(line) for line in shown.lines} == {len(shown.head)}
    text = render_figure(STUDY.figure, rows(), "sample")["svg"].decode()
    assert all(label in text for label in ("stitches back from the pull [-]", "tension of stitch 2 [N]", "ring law"))
