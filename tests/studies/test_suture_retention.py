"""The study of suture retention, coarse: a strip between hole and clamp, the fits, what is said, what is refused."""

from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest

from studies.figure import render_figure
from studies.study import StudyError, study
from studies.suture_retention.study import LINEAR, TISSUES, Case, Row, main, run, runs_of, table, where

STUDY = study("suture_retention")

BALANCED = 1e-6  # of the force: what the clamp bears
MIDDLE = 0.05  # of the strain: the strip is twice as long as wide, and a point pulls at it
INCOMPRESSIBLE = 5e-3  # of the stress at a stretch of 1.2: the strip's J is 1.0008
SAME = 0.1  # of the force: a linear organ while the strip is drawn by a twentieth


@cache
def rows() -> tuple[Row, ...]:
    quick = Case(name="skin", footprint=0.9e-3, size=2e-3, load_steps=20)
    return tuple(row for case in (quick, replace(quick, variant=LINEAR)) for row in islice(run(case), 6))


@pytest.mark.parametrize("name", TISSUES)
def test_a_fit_has_both_points_of_its_curve(name: str) -> None:
    """Independent check: the slope at the start, the point where the strips broke, and in between what a strip of
    incompressible tissue bears by its closed form; the stretch is the inverse of the stress."""
    of = TISSUES[name]
    assert of.nominal(1.0 + of.strain) == pytest.approx(of.stress, rel=1e-9)
    assert of.nominal(1.0 + 1e-6) == pytest.approx(1e-6 * of.slope, rel=1e-4)
    closed = of.slope / 3.0 * (1.2 - 1.2**-2) * np.exp(of.law.stiffening * (1.2**2 + 2.0 / 1.2 - 3.0))
    assert of.nominal(1.2) == pytest.approx(closed, rel=INCOMPRESSIBLE)
    assert of.stretch(of.nominal(1.2)) == pytest.approx(1.2)


def test_the_strip_between_hole_and_clamp_is_a_uniaxial_test() -> None:
    """Independent check: the clamp bears the force, and the strip's middle is stretched as the closed form says."""
    for row in rows():
        assert row.clamp == pytest.approx(row.force, rel=BALANCED)
    last = runs_of(rows())["skin", 0.9e-3, ""][-1]
    assert last.drawn == pytest.approx(3e-3)
    assert last.uniaxial > 1.1
    assert last.middle - 1.0 == pytest.approx(last.uniaxial - 1.0, rel=MIDDLE)


def test_skin_holds_more_than_a_linear_organ_and_is_stretched_less() -> None:
    """Consistency check: the same at first, a fifth more force and less stretch when drawn by 3 mm."""
    curved, linear = runs_of(rows()).values()
    assert curved[0].force == pytest.approx(linear[0].force, rel=SAME)
    assert curved[-1].force > 1.2 * linear[-1].force
    assert curved[-1].stretch - 1.0 < 0.8 * (linear[-1].stretch - 1.0)


def test_what_was_found_is_said() -> None:
    """Published forces that are not reached are, and what broke is a prediction."""
    (first, *_), _ = runs_of(rows()).values()
    assert where([first], "force", 0.5 * first.force, "drawn") == pytest.approx(0.5 * first.drawn)
    assert np.isnan(where([first], "force", 2.0 * first.force, "drawn"))
    lines = table(rows()).lines
    assert len(lines) == 2 and "not reached" in lines[0]
    said = "\n".join(STUDY.remarks([*rows(), replace(rows()[0], failed="StepError: no")]))
    assert "Ní Annaidh" in said and "nothing TEARS" in said and "FAILED beyond, StepError" in said
    assert render_figure(STUDY.figure, rows(), "suture_retention")["svg"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"tissues": ("leather",)}, "leather"),
        ({"variants": ("softer",)}, "softer"),
        ({"footprints": (1e-3,)}, "below 1e-3"),
        ({"load_steps": 0}, "above 0"),
    ],
)
def test_other_arguments_are_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(StudyError, match=words):
        next(main(**given))  # type: ignore[arg-type]
