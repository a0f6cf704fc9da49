"""Steps that are found downhill: the slope along a correction, and a slack thread that is pulled taut in one solve."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.integrators import Equilibrium
from coupling.rest.equilibrium import static_problem
from coupling.step import newton
from coupling.step.configuration import GAP_TOLERANCE
from coupling.step.descent import Descent, Place, Way
from coupling.step.newton import Problem
from coupling.step.stepping import ask_organ, where_it_is
from coupling.system import Friction, Piercing, State, System
from studies.scenario import Scenario, parse
from studies.simulation import prepare
from tests.thread.threads import ABSCISSAE, LENGTH, RADIUS, block_organ, hairpin, laid
from thread.catalogue import suture
from thread.ends import Fixed, Pulled
from thread.packets import Hold, travelling
from thread.placed import Placed
from thread.thread import Thread

SLOPE = 1e-7  # of the largest slope: the error of central differences over STEP of a correction
STEP = 1e-4
PULLED = 2e-5  # of the pull: a spline of 40 control points, 1e-5 on packets made anew; h² of 1.3 times as coarse ones


def smooth_hairpin() -> tuple[System, State]:
    """A hairpin through two smooth holes of a block, its end pulled, on knots that travel."""
    path = hairpin(RADIUS, LENGTH)
    start, _ = path(np.array([0.0, LENGTH]))
    holes = tuple(Piercing(name) for name in ("entry", "exit"))
    travel = travelling(LENGTH, [Hold(k, s, True, 5e-4) for k, s in enumerate(ABSCISSAE)], 2, 2e-3, (None, None))
    spline = Placed(travel.knots, travel.places(np.array(ABSCISSAE)), travel)
    ends = Fixed(start), Pulled(np.array([0.05, 0.02, 0.2]))
    system = System(Thread(spline, suture("2-0 polypropylene")), ends, block_organ("P1", False), holes)
    return system, laid(system, ABSCISSAE, path)


def at_rest(system: System, state: State) -> Problem:
    """The problem of equilibrium under all of the loads."""
    answer = ask_organ(system, Equilibrium(), [state], 1.0, 1.0)
    return static_problem(system, state, 1.0, 1.0, answer, state, state)


def potential(at: Place) -> float:
    """Energy of thread and organ, and the loads'."""
    thread, f = at.r.configuration.thread, at.f.ravel()
    return float(thread.energy(at.r.points) - np.vdot(at.problem.load, at.z.q) + 0.5 * f @ at.problem.C @ f)


def test_the_work_along_a_correction_is_the_slope_of_the_potential() -> None:
    """Independent check: central differences of the energies of thread and organ and of the loads' potential, at the
    start of a correction and on its way, of Newton's own direction and of a thread tied to where it is."""
    system, state = smooth_hairpin()
    problem, descent = at_rest(system, state), Descent[Any]()
    z = replace(where_it_is(problem, state), sigma=np.ones(2))
    for _ in range(3):
        problem, z = descent(problem, z, newton.evaluate(problem, z))
    assert descent.there is not None
    start = replace(descent.there, problem=problem, r=newton.evaluate(problem, z))
    for tie in (0.0, 1e8):
        way = Way(start, *newton.direction(problem, z, start.r, tie))
        assert way.slope < 0.0
        for share in (0.0, 0.1, 0.3):
            plus, minus = (potential(way.after(share + sign * STEP)[0]) for sign in (1.0, -1.0))
            assert abs((plus - minus) / (2.0 * STEP) - way.after(share)[1]) <= SLOPE * abs(way.slope)


@pytest.mark.parametrize("sigma", [-1.0, 1.0])
def test_friction_drives_no_hole(sigma: float) -> None:
    """Independent check: whichever sense of sliding a way downhill begins with, no rough hole slides against it:
    friction takes work, and gives none. One that is stopped is where it began."""
    system, state = smooth_hairpin()
    rough = tuple(replace(hole, friction=Friction(0.2, 0.2)) for hole in system.piercings)
    problem, descent = at_rest(replace(system, piercings=rough), state), Descent[Any]()
    z = replace(where_it_is(problem, state), sigma=np.full(2, sigma))
    for _ in range(12):
        problem, z = descent(problem, z, newton.evaluate(problem, z))
        way = z.s - problem.law.s_old
        assert (z.sigma * way >= 0.0).all() and (np.abs(way[z.sigma == 0.0]) <= GAP_TOLERANCE * RADIUS).all()


def slack(seed: int) -> tuple[Scenario, float]:
    """A thread that a dead load pulls through a hole, with 5 to 30 bending lengths more of it behind the hole than the
    way to its held end, at rest in one load step; and the load [N]."""
    rng = np.random.default_rng(seed)
    name, turn = ("2-0 polypropylene", "4-0 nylon", "6-0 polypropylene")[seed % 3], np.radians(rng.uniform(-60.0, 60.0))
    section = suture(name)
    pull = float(section.EA * 10 ** rng.uniform(-3.5, -2.0))
    bend, side = float(np.sqrt(section.EI / pull)), np.array([-np.cos(turn), 0.0, np.sin(turn)])
    over, chord = rng.uniform(5.0, 30.0) * bend, 15.0 * bend
    height = brentq(lambda h: 2.0 * np.hypot(0.5 * chord, h) - chord - over, 0.0, 50.0 * bend)
    corners = np.array([[0.0, 0.0, 0.0], [0.5 * chord, 0.0, -height], [chord, 0.0, 0.0]])
    table = {
        "thread": {
            "suture": name,
            "path": [(20.0 * bend * side).tolist(), *corners.tolist()],
            "start": {"kind": "pulled", "force": (pull * side).tolist()},
            "end": {"kind": "fixed"},
        },
        "piercing": [{"name": "hole", "at": [0, 0, 0], "direction": "free"}],
        "solve": {"kind": "static", "load_steps": 1},
    }
    return parse(table), pull


@pytest.mark.parametrize("seed", range(6))
def test_a_slack_thread_is_pulled_taut_in_one_solve(seed: int) -> None:
    """Independent check: without friction the tension is the dead load on both sides of the hole, and the strand
    behind it is straight: all of the slack has gone through."""
    scenario, pull = slack(seed)
    *_, (last, _) = prepare(scenario).advance()
    assert np.linalg.norm(last.end_reaction) == pytest.approx(pull, rel=PULLED)
    assert last.piercings[0].tension_after == pytest.approx(pull, rel=PULLED)
