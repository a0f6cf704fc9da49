"""A step whose solution is not near, on knots that came to the holes after they were loaded."""

from dataclasses import replace

import numpy as np
import pytest

from coupling.integrators import BackwardEuler
from coupling.run.adaptivity import Resolution, adapt, coarse_tree
from coupling.step.continuation import reach_in_spans, solve_downhill, solve_held
from coupling.step.newton import REACH, Iterate, Problem
from coupling.step.stepping import advance, dynamic_problem, organ_answer, predict
from coupling.step.tension import lengths_bent_over
from coupling.system import Piercing
from tests.bounds import GAP, IDENTITY, RESIDUAL
from tests.thread.threads import ABSCISSAE, LENGTH, RADIUS, Z, hairpin, hairpin_sites, hairpin_system, laid
from thread.catalogue import suture
from thread.ends import Driven, Pulled
from thread.thread import Thread

PULL = 0.2  # [N], at once
TIP = np.array([RADIUS, 0.0, ABSCISSAE[0]])
DT = 5e-4  # [s] of the step in which the load comes


def loaded(directed: bool, n: int, dt: float, compiled: bool = False, follow: bool = True) -> tuple[Problem, Iterate]:
    """The next step, of `dt` [s], and where it begins, of a 6-0 suture through two holes after a load at once on `n`
    points: on knots that are a tenth of what it bends over now, if they `follow`."""
    ends = Pulled(PULL * Z, 0.0), Driven(np.array([[0.0, *TIP], [1.0, *TIP]]))
    holes = Piercing("entry", directed=directed), Piercing("exit", directed=directed)
    system = hairpin_system(hairpin_sites(), ends, n, holes, compiled=compiled)
    system = replace(system, thread=Thread(system.thread.spline, suture("6-0 polyester"), damping=20.0))
    state = advance(system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH)), DT)[-1].new
    if follow:
        system, state, _ = adapt(Resolution(coarse_tree(0.0, LENGTH, n), 0.01), system, state, 4 * DT)
    scheme = BackwardEuler(dt)
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state), scheme)
    return problem, predict(problem, state)


def test_a_correction_downhill_goes_as_far_as_the_thread_bends_over() -> None:
    """Independent check: a quarter of a span where all spans are alike, and a quarter of √(EI/T) on finer ones at every
    hole, which at one of them it is."""
    assert reach_in_spans(*loaded(directed=False, n=40, dt=DT, follow=False)) == REACH
    problem, guess = loaded(directed=False, n=40, dt=DT)
    spline = problem.system.thread.spline
    spans = np.diff(spline.breaks)[spline.spans_of(guess.s)]
    layers = lengths_bent_over(problem.system, guess.s, guess.N, guess.lam, problem.rows[:, 0])
    assert np.all(spans < 0.2 * layers) and np.diff(spline.breaks).max() > layers.max()
    share = reach_in_spans(problem, guess) * spans / (REACH * layers)
    assert share.max() == pytest.approx(1.0, rel=IDENTITY)


@pytest.mark.parametrize("compiled", [False, True])
def test_a_thread_slides_to_where_nothing_drives_it_over_many_fine_spans(compiled: bool) -> None:
    """Independent check: what the coarse knots lacked moves the thread by many of the fine spans that come to its
    holes, further than corrections of a quarter of a span go; nothing drives it through smooth holes in the end. Loops
    and numpy take as many corrections."""
    problem, guess = loaded(directed=False, n=40, dt=0.5 * DT, compiled=compiled)
    solution = solve_downhill(problem, guess)
    spline = problem.system.thread.spline
    way = np.abs(solution.iterate.s - problem.law.s_old) / np.diff(spline.breaks)[spline.spans_of(guess.s)]
    assert way.max() > 50 * REACH
    assert np.abs(solution.residual.holds[:, 0]).max() <= RESIDUAL * PULL
    assert solution.iterations == solve_downhill(*loaded(False, 40, 0.5 * DT, not compiled)).iterations


def test_a_thread_that_is_held_is_bent_anew_by_small_turns() -> None:
    """Independent check: fine knots that come to a directed hole let the thread meet its direction, which it missed by
    what the coarse ones lacked; it does so where it is held, and ends in the holes and along their directions."""
    problem, guess = loaded(directed=True, n=20, dt=2e-6)
    solution = solve_held(problem, guess)
    z, r = solution.iterate, solution.residual
    assert np.array_equal(z.s, problem.law.s_held)
    assert np.abs(r.holds[:, 1:4]).max() <= GAP * problem.system.thread.section.diameter
    assert np.abs(r.holds[:, 4:]).max() <= RESIDUAL
