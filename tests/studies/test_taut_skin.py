"""The study of taut skin, coarse: the stress of the uncut sheet, a slit that gapes and is closed, what is compared."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from studies.figure import render_figure
from studies.study import StudyError, study
from studies.taut_skin.study import LINEAR_SHEET, PITCH, SLIT, Row, Skin, main, ratios, remarks, table
from studies.wounds import NEAR, NU, SOURCES, THICKNESS, E
from tests.bounds import TWO_SOLVERS

STUDY = study("taut_skin")

TENSION = 90.0  # of the uncut sheet [N/m]: the stitches' share of it is far above what they are drawn beyond it
STITCHED = 0.1  # of the uniform traction: what stitches beside the lips, and coarse cells, change in the middle


@cache
def slit() -> Row:
    """A slit that gaped, closed."""
    [row] = main((SLIT,), (TENSION,))
    return row


def test_a_sheet_that_is_stretched_little_bears_as_a_linear_one() -> None:
    """Independent check: σ₀ t = E t ε/(1 − ν) of equal strains in a plane, off by the second order of the strain; with
    a large strain and stiffening it is more."""
    for strain in (1e-3, 1e-4):
        linear = E * THICKNESS * strain / (1.0 - NU)
        skin = Skin(5.0, linear)
        assert skin.stretch - 1.0 == pytest.approx(strain, rel=10.0 * strain)
        assert (
            abs(skin.tissue.stress(skin.stretch, skin.stretch, skin.tissue.thinned(skin.stretch))[2, 2])
            <= TWO_SOLVERS * E
        )
    assert Skin(5.0, 0.0).tension_at(1.2) > 1.2 * Skin(1e-3, 0.0).tension_at(1.2)


def test_a_slit_gapes_and_its_stitches_bear_what_the_skin_bore() -> None:
    """Independent check: the middle stitch bears its share of σ₀ t L, whatever the law, and those at the ends more;
    what stiffens gapes by less than a crack in a linear sheet, 2 σ₀ L/E."""
    row = slit()
    assert row.closed and row.widest <= 1.1 * NEAR * row.opened
    assert row.middle == pytest.approx(row.tension * row.length / len(row.forces), rel=STITCHED)
    assert 1.0 < row.of_tension < 1.3
    assert 0.5 < row.opened / (2.0 * row.tension * row.length / (E * THICKNESS)) < 1.0
    assert np.array(row.forces) == pytest.approx(row.forces[::-1], rel=STITCHED)


def test_what_is_compared_with_print_is_the_ratio_of_a_pair() -> None:
    """Consistency check: forces of a pair of wounds by skin, the published ones and width over length; a wound that was
    not closed is said, and not compared."""
    source = SOURCES[1]
    first, second = (
        replace(slit(), length=length, width=width, places=(0.0,), forces=(force,), skin=LINEAR_SHEET, tension=0.0)
        for (length, width), force in zip(source.wounds, (1.0, 2.2), strict=True)
    )
    [found] = ratios([first, second])
    assert (found.source, found.found) == (source.name, 2.2)
    assert found.published == pytest.approx(3.2 / 1.1) and found.by_law == pytest.approx(13.0 / 46.0 * 36.0 / 5.0)
    said = "\n".join(remarks([slit(), first, second]))
    assert (
        "takes 2.20 times the first; published 2.91 (-24 %)" in said and "it gapes by" in said and "Ahmad 2019" in said
    )
    open_one = replace(second, closed=False)
    assert not list(ratios([first, open_one])) and any("NOT BROUGHT TOGETHER" in said for said in remarks([open_one]))
    assert {len(line) for line in table([slit(), first]).lines} == {len(table([slit()]).head)}
    assert render_figure(STUDY.figure, [slit(), first, second], "taut_skin")["svg"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"wounds": ((0.07, 0.01),)}, "in a sheet of"),
        ({"wounds": ((0.5 * PITCH, 0.0),)}, "in a sheet of"),
        ({"tensions": (-1.0,)}, "compression is not allowed"),
        ({"stiffening": 0.0}, "above 0"),
    ],
)
def test_other_arguments_are_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(StudyError, match=words):
        next(main(**given))  # type: ignore[arg-type]
