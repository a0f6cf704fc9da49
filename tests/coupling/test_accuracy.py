"""Steps that are taken in parts where one is off by more than is asked for."""

import tomllib
from itertools import pairwise

import numpy as np
import pytest

from coupling.integrators import BDF2, BackwardEuler, Scheme
from coupling.run.run import Run, begin
from coupling.step.stepping import REFINED, Take, bdf2_step, local_error, try_step
from studies.scenario import ScenarioError, parse
from tests.bounds import IDENTITY
from tests.studies.samples import CONTRACT
from tests.thread.threads import LENGTH, ORIGIN, X, laid, line, uniform, without_organ

DT = 4e-3  # [s]
GRAVITY = 9.81  # [m/s²]


def off_by(scheme: Scheme, times: list[float]) -> tuple[float, float]:
    """What one step of an oscillator x'' = −x adds to the error of position, from exact values at `times` up to its end
    at zero, and what is estimated of it."""
    t = np.array(times)
    x, v = np.cos(1.0 + t), -np.sin(1.0 + t)
    past = [value for pair in zip(x, v, strict=True) for value in pair]
    found = scheme.a * scheme.inertia_reference(*past) / (scheme.a + 1.0)
    rate = scheme.d * (found - scheme.damping_reference(*x))
    return float(found - np.cos(1.0)), float(scheme.local_error(rate, *v))


@pytest.mark.parametrize("ratio", [0.0, 0.5, 1.0, 2.0])
def test_what_a_step_is_off_by_is_estimated(ratio: float) -> None:
    """Independent check: of an oscillator whose past is exact. The estimate is the leading part of the error, so what
    it misses halves with the step."""
    missed = []
    for dt in (0.02, 0.01):
        before = dt / ratio if ratio else 0.0
        scheme = BDF2(dt, before) if ratio else BackwardEuler(dt)
        true, estimated = off_by(scheme, [-dt, -dt - before] if ratio else [-dt])
        missed.append(abs(estimated / true - 1.0))
    assert missed[1] <= 0.1
    assert 0.3 <= missed[1] / missed[0] <= 0.7


def falling(take: Take, tolerance: float) -> list[Run]:
    """The runs after each of four steps of a thread that falls from rest."""
    system = without_organ(uniform(LENGTH, 8), gravity=np.array([0.0, 0.0, -GRAVITY]))
    run, out = begin(system, laid(system, [], line(ORIGIN, X)), take, tolerance=tolerance), []
    for _ in range(4):
        run = run.step(DT)
        out.append(run)
    return out


@pytest.mark.parametrize(("tolerance", "parts"), [(1e-4, 1), (5e-5, 2), (1e-5, 4), (1e-9, 2**REFINED)])
def test_a_falling_thread_is_taken_in_the_parts_that_theory_asks_for(tolerance: float, parts: int) -> None:
    """Independent check (theory): backward Euler is off by ½ g Δt² in a step, and so at the end by ½ g t Δt; no part is
    smaller than dt/2⁶, however little is allowed."""
    runs = falling(try_step, tolerance)
    assert [len(run.taken) for run in runs] == [parts] * 4
    assert all(abs(local_error(step) / (0.5 * GRAVITY * step.dt**2) - 1.0) <= 1e-6 for step in runs[-1].taken)
    end = runs[-1].state
    assert end.time == pytest.approx(4 * DT, rel=IDENTITY)
    assert np.allclose(-end.q[:, 2], 0.5 * GRAVITY * 4 * DT * (4 * DT + DT / parts), rtol=1e-6)


def test_parts_are_as_long_again_as_the_motion_allows() -> None:
    """Independent check (theory): BDF2 is exact on a parabola, so only its beginning is in parts: a step of backward
    Euler, off by ½ g Δt², and none of those behind it, which look back at steps half as long and shorter."""
    runs = falling(bdf2_step, 1e-5)
    assert [round(DT / step.dt) for step in runs[0].taken] == [4, 4, 2]
    assert [len(run.taken) for run in runs[1:]] == [1, 1, 1]
    assert all(run.state.dt_before is not None for run in runs)
    assert all(one.state.time < other.state.time for one, other in pairwise(runs))


def test_the_key_is_of_steps_by_newton_in_time() -> None:
    """Invariant: it is refused where no step is halved."""
    table = tomllib.loads(CONTRACT)
    for other in ({"kind": "static"}, {"coupling": "staggered"}):
        with pytest.raises(ScenarioError, match=r"solve.tolerance = 1e-06 is refused"):
            parse(table | {"solve": table["solve"] | {"tolerance": 1e-6} | other})
    assert parse(table | {"solve": table["solve"] | {"tolerance": 1e-6}}).solve.tolerance == 1e-6
