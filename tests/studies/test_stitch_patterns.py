"""The study of stitch patterns: tackles in closed form, the coupled system against them, what is said and refused."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from studies.figure import render_figure
from studies.stitch_patterns.study import (
    FITTED,
    PATTERNS,
    WOUND,
    Row,
    Way,
    ends,
    main,
    predicted_by_capstan,
    table,
)
from studies.study import StudyError, arguments, study
from studies.theory import bent_ratio, capstan
from tests.bounds import IDENTITY

STUDY = study("stitch_patterns")

LAW = 0.01  # of a tension: rings are sixteen √(EI/T) apart, and the knots resolve that
CLOSED = 0.01  # of the pull: a fit corrected once

# pull of a lip over the pull of each hand, r = exp(−μπ) for every hole that is passed
TACKLES = {
    "single": lambda r: 1.0 + r,
    "pulley": lambda r: (1.0 + r) ** 2,
    "vertical mattress": lambda r: 2.0 * r,
    "horizontal mattress": lambda r: 2.0 * r,
}


@cache
def rows() -> tuple[Row, ...]:
    return tuple(main(**arguments(STUDY, "quick")))


@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("throw", [180.0, 270.0])
def test_a_stitch_is_a_tackle(name: str, throw: float) -> None:
    """Independent check (capstan): two strands or four bear the wound, less at every hole, and at the throw."""
    for mu in (0.0, 0.1, 0.3):
        for rings in (1, 3):
            closing = Way.of(PATTERNS[name], throw, rings).closing(partial(capstan, mu))
            exact = TACKLES[name](np.exp(-mu * np.pi)) * np.exp(-mu * np.radians(throw))
            assert closing == pytest.approx(exact, rel=IDENTITY)


def test_the_thread_slides_by_the_law_of_one_that_bends() -> None:
    """Independent check (elastica): the lip is pulled across by what the law says, and every strand's tension has
    fallen by the law of the rings between it and its hand."""
    for last in ends(rows()):
        name, way = last.pattern, Way.of(last.stitch, last.throw, last.rings)
        law = partial(bent_ratio, last.mu)
        assert last.slides
        assert last.tension == pytest.approx(last.pull * way.closing(law), rel=LAW)
        strands = [row for row in rows() if row.kind == "strand" and row.pattern == name]
        assert len(strands) == len(way.on_right) - 1
        each = np.log(law(way.turns[0])) / way.turns[0]
        for row in strands:
            fallen = np.exp(-each * np.radians(row.turn))
            assert row.tension == pytest.approx(row.pull * fallen, rel=2.0 * LAW)


def test_one_coefficient_meets_single_and_pulley() -> None:
    """Independent check (Marsidi et al. 2020): fitted to the single stitch, the pulley is within its deviation; the
    capstan with its own fit predicts the same."""
    single, pulled = ends(rows())
    assert (single.pattern, pulled.pattern) == (FITTED, "pulley") and single.throw == pulled.throw
    assert single.closing_pull == pytest.approx(PATTERNS[FITTED].published, rel=CLOSED)
    pulley = pulled.closing_pull
    assert abs(pulley - PATTERNS["pulley"].published) < PATTERNS["pulley"].spread
    assert pulley == pytest.approx(predicted_by_capstan("pulley", pulled.throw), rel=2.0 * CLOSED)
    assert predicted_by_capstan(FITTED, 180.0, 5.0) == pytest.approx(5.0, rel=IDENTITY)
    assert WOUND / pulley > 1.2


def test_what_was_found_is_said() -> None:
    """The prediction, what is open, and a thread that sticks are in the remarks; the figure is drawn."""
    said = "\n".join(STUDY.remarks(rows()))
    assert "pulley 3.4" in said and "agrees" in said and "LEFT OPEN" in said and "ASSUMED" in said
    assert "NOT slide" not in said
    assert [line[0] for line in table(rows()).lines] == ["single", "pulley"]
    stuck = [replace(row, slides=False) for row in rows()]
    assert "NOT slide" in "\n".join(STUDY.remarks(stuck))
    assert render_figure(STUDY.figure, rows(), "stitch_patterns")["png"][:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"patterns": ("double",)}, "'double' is refused"),
        ({"patterns": ("pulley",)}, "add it"),
        ({"throws": (400.0,)}, "up to 360"),
        ({"rings": 1}, "two or more rings"),
    ],
)
def test_refusals(given: dict[str, object], words: str) -> None:
    """What cannot be run is refused in words."""
    with pytest.raises(StudyError, match=words):
        next(main(**given))  # type: ignore[arg-type]
