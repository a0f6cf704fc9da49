"""The study of the three ways of solving, coarse: that it measures what its table says."""

import csv
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from studies.coupling_variants.study import (
    CREATED,
    DURATION,
    Row,
    error_at,
    largest_stable,
    main,
    runs_of,
    table,
)
from studies.study import StudyError, arguments, numbers, study, write

STUDY = study("coupling_variants")

SOFT, FIRM = 2e3, 2.5e5
COUNTS = (10, 40, 320)


@cache
def rows() -> tuple[Row, ...]:
    """The quick preset: two organs on the coarsest mesh."""
    return tuple(main(**arguments(STUDY, "quick")))


def test_every_run_is_there_once() -> None:
    keys = {(row.way, row.inertia, row.youngs_modulus, row.dt) for row in rows()}
    assert len(rows()) == len(keys) == 3 * 2 * 2 * len(COUNTS)
    assert {row.dt for row in rows()} == {DURATION / n for n in COUNTS}


def test_the_monolithic_way_neither_drifts_nor_creates() -> None:
    """Consistency check: at every step and stiffness; nor is there a step that it cannot take here."""
    for inertia in (True, False):
        for E in (SOFT, FIRM):
            runs = runs_of(rows(), "monolithic", inertia, E)
            assert all(row.stable for row in runs)
            assert max(row.drift for row in runs) <= 1e-9 * runs[0].moved
            assert max(abs(row.created) for row in runs) <= 1e-12
            assert largest_stable(runs) == DURATION / COUNTS[0]


def test_the_staggered_way_drifts_with_the_step() -> None:
    """Independent check (theory): the drift is the way of a hole in a step, so it falls with the step, and is below the
    whole way while the exchange is stable. A stable exchange that comes back to where it was destroys energy."""
    for runs in (runs_of(rows(), "staggered", True, FIRM), runs_of(rows(), "staggered", False, FIRM)):
        fine, middle = runs[0], runs[1]
        assert 0.0 < fine.drift < 0.8 * middle.drift < middle.moved
        assert -CREATED < fine.created < 0.0
        assert fine.stable and middle.stable


def test_softness_limits_the_step_of_the_staggered_way() -> None:
    """Independent check (theory): the exchange diverges where the thread's stiffness times the organ's compliance is
    above one: on the soft organ before the firm one, with inertia at long steps, without it at short ones too."""
    soft, firm = (largest_stable(runs_of(rows(), "staggered", True, E)) for E in (SOFT, FIRM))
    assert 0.0 < soft < firm
    broken = runs_of(rows(), "staggered", False, SOFT)
    assert largest_stable(broken) == 0.0
    assert max(row.created for row in broken) > 1.0


def test_every_error_falls_with_the_step() -> None:
    """Independent check (theory): the schemes are of first order. The reference has half the finest step, which hides
    up to half of the finest run's error and nothing that could turn the order of the runs."""
    for way, E in (("monolithic", SOFT), ("monolithic", FIRM), ("staggered", FIRM)):
        errors = [run.error for run in runs_of(rows(), way, True, E)]
        assert 0.0 < 2.0 * errors[0] < errors[1] < errors[2]


def test_the_linear_step_wants_short_ones() -> None:
    """Consistency check: on the softest organ with inertia it holds at 0.3 ms, drifts less than the staggered way for
    its constraints are second order in the step, and breaks off or lives on energy from nowhere at longer ones."""
    fine, *coarse = runs_of(rows(), "linear", True, SOFT)
    assert fine.stable and not any(run.stable for run in coarse)
    assert fine.drift < 0.1 * runs_of(rows(), "staggered", True, SOFT)[0].drift
    assert fine.solves == COUNTS[-1]


def test_error_at_equal_cost() -> None:
    """Between two stable runs, straight in logarithms; none beyond the ladder."""
    row = rows()[0]
    ladder = [replace(row, solves=n, error=e) for n, e in ((100, 1e-2), (10000, 1e-4))]
    assert abs(error_at(1000, ladder) - 1e-3) < 1e-12
    assert np.isnan(error_at(50, ladder)) and np.isnan(error_at(1000, ladder[:1]))


def test_steps_without_common_times_are_refused() -> None:
    with pytest.raises(StudyError, match="multiples of the smallest"):
        next(main(step_counts=(10, 25)))


def test_what_is_written(tmp_path: Path) -> None:
    """The table has a line for each organ, the numbers read back, and the figure is a picture in both formats."""
    write(STUDY, {"study": "coupling_variants"}, rows(), tmp_path)
    lines = [line for line in (tmp_path / "table.md").read_text().splitlines() if line.startswith("|")]
    assert len(lines) == 2 + 4 * 3
    assert len({line.count("|") for line in lines}) == 1
    assert "staggered" in lines[-5] and "broke off" in lines[-5] and "none" in lines[-5]
    back = list(csv.DictReader(numbers(rows()).splitlines()))
    assert [float(line["drift [m]"]) for line in back] == [row.drift for row in rows()]
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "figure.svg").read_text()
    assert "time step [ms]" in text and "250 kPa" in text


def test_what_is_not_supported_is_said() -> None:
    """Cells of 2.5 radii, and the soft organs beyond small strains; the firm ones are not."""
    said = list(STUDY.remarks(rows()))
    assert len(said) == 4
    assert "every run: cells of 2.5 footprint radii, TOO COARSE" in said[0]
    assert all("of 2 kPa" in line and "BEYOND" in line for line in said[1:3])


def test_the_largest_stable_step() -> None:
    """It is the end of an unbroken ladder: a coarse step that happens to hold does not count."""
    row = rows()[0]
    ladder = [replace(row, dt=dt, created=created) for dt, created in ((1.0, 0.0), (2.0, -1.0), (3.0, 0.2), (4.0, 0.0))]
    assert largest_stable(ladder) == 2.0
    assert largest_stable(ladder[2:]) == 0.0
    assert not replace(row, completed=False).stable
    assert np.isfinite([row.drift, row.created]).all()


@pytest.mark.parametrize("stable", ["all", "none"])
def test_the_table_tells_where_the_ladder_ends(stable: str) -> None:
    row = replace(rows()[0], way="staggered", created=0.0 if stable == "all" else 1.0)
    _, line, _ = table([replace(row, way=way) for way in ("monolithic", "staggered", "linear")]).lines
    assert line[4] == (f"≥ {1e3 * row.dt:.2g}" if stable == "all" else "none")
