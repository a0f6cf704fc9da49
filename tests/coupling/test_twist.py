"""A thread with twist in holes of an organ: the whole matrix, two solves, every integrator, and what a hole lets by."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from coupling.errors import StepError
from coupling.integrators import BackwardEuler
from coupling.kernels.constraints import phi
from coupling.paper.assembled import Monolith, assemble, equation_of
from coupling.paper.linear_step import linear_step
from coupling.reports.audit import audit_step, initial_energies
from coupling.step import stepping
from coupling.step.newton import Iterate, allowed_share, correct, evaluate, solve
from coupling.step.stepping import Step, Take, advance, dynamic_problem, organ_answer, try_step
from coupling.system import Piercing, State, System
from tests.bounds import GAP, LINEAR, RESIDUAL, TWO_SOLVERS
from tests.coupling.test_derivatives import Setting
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    PP,
    RADIUS,
    X,
    Z,
    assert_slope,
    block_organ,
    hairpin,
    hairpin_sites,
    laid,
    line,
    uniform,
    without_organ,
)
from thread.ends import Clamped, Driven

DT = 2e-3
START, END = hairpin(RADIUS, LENGTH)(np.array([0.0, LENGTH]))
# The start is clamped; a hand draws the end up by 1 mm and turns it once, in 40 ms.
HAND = Driven(np.array([[0.0, *END], [0.04, *(END + 1e-3 * Z)]]), turn=np.array([[0.0, 0.0], [0.04, 2.0 * np.pi]]))


@cache
def scene(organ: str = "dynamic") -> tuple[System, State]:
    """The hairpin with twist through a block, or through two holes fixed in space."""
    body = hairpin_sites() if organ == "fixed" else block_organ("P1", organ == "dynamic")
    holes = (Piercing("entry"), Piercing("exit"))
    system = System(uniform(LENGTH, 40, twist=True), (Clamped(START, -Z), HAND), body, holes)
    return system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))


@cache
def steps(organ: str, take: Take = try_step) -> tuple[Step, ...]:
    """Twenty steps and the halves they took."""
    system, state = scene(organ)
    out: list[Step] = []
    for _ in range(20):
        out += advance(system, state, DT, take)
        state = out[-1].new
    return tuple(out)


def in_the_run() -> Setting:
    """A step of the run as a problem, at an iterate in no equilibrium."""
    system, _ = scene()
    state, organ = steps("dynamic")[9].new, system.organ
    scheme = BackwardEuler(DT)
    problem = dynamic_problem(system, state, DT, organ_answer(system, scheme, state))
    whole: Any = equation_of(problem)
    rng = np.random.default_rng(7)
    q = state.q + rng.standard_normal(state.q.shape) * [2e-4, 2e-4, 2e-4, 0.5]
    N = system.thread.EA * system.thread.points(q, problem.frame).strain
    U = organ.displacement(state.organ)[organ.elasticity.free]
    s = state.s + 0.3 * LENGTH / 37 * np.array([1.0, -1.0, 0.0])
    return Setting(system, problem, whole, Monolith(q, N, s, state.lam, state.y, state.sigma, U))


@pytest.mark.parametrize("coordinates", [[0, 1, 2], [3], [0, 1, 2, 3]])
def test_assembled_matrix_is_the_slope_of_the_residual(coordinates: list[int]) -> None:
    """Independent check: columns of places, of angles and of both, against central differences."""
    case = in_the_run()
    system, frame = case.system, case.problem.frame
    dq = np.random.default_rng(3).standard_normal(case.z.q.shape) * [2e-4, 2e-4, 2e-4, 0.3]
    dq[:, [k for k in range(4) if k not in coordinates]] = 0.0
    dq.ravel()[system.held] = 0.0

    def residual(h: float) -> np.ndarray:
        q = case.z.q + h * dq
        z = replace(case.z, q=q, N=system.thread.EA * system.thread.points(q, frame).strain)
        return np.asarray(-assemble(case.problem, z, evaluate(case.problem, z)).right)

    block = assemble(case.problem, case.z, evaluate(case.problem, case.z))
    exact = block.matrix @ np.concatenate([dq.ravel(), np.zeros(block.matrix.shape[1] - dq.size)])
    places = np.arange(dq.size)[np.arange(dq.size) % 4 < 3]
    for rows in (places, np.arange(3, dq.size, 4)):
        assert_slope(lambda h, rows=rows: residual(h)[rows], exact[rows])


def test_one_correction_by_two_roads() -> None:
    """Consistency check: the condensed Newton correction of a thread with twist is that of the assembled matrix."""
    case = in_the_run()
    r = evaluate(case.problem, case.z)
    block = assemble(case.problem, case.z, r)
    dq = splu(block.matrix).solve(block.right)[block.blocks["q"]].reshape(-1, 4)
    got = correct(case.problem, case.z, r)[1].q - case.z.q
    dq *= allowed_share(case.problem, dq)
    for part in (slice(0, 3), slice(3, 4)):
        assert np.abs(got[:, part] - dq[:, part]).max() <= TWO_SOLVERS * np.abs(dq[:, part]).max()


@pytest.mark.parametrize("organ", ["dynamic", "quasi-static", "fixed"])
@pytest.mark.parametrize("take", [try_step, stepping.bdf2_step], ids=["euler", "bdf2"])
def test_audit_and_constraints_while_the_needle_turns(organ: str, take: Take) -> None:
    """Independent check: the holes hold places and directions only, Φ = 0; the energy of every step, torsion and the
    work of the turning hand included, is accounted for."""
    system, state = scene(organ)
    energies = [initial_energies(system, state)]
    for step in steps(organ, take):
        energies.append(audit_step(system, energies[-1], step))
        violation = np.abs(phi(system.passage_of(step.new), step.new.lam, step.new.y))[:2]
        assert violation[:, :3].max() <= GAP * system.thread.section.diameter
    errors = np.diff([e.balance_error for e in energies])
    assert np.abs(errors).max() <= RESIDUAL * energies[-1].external_work


def test_a_hole_lets_the_torque_pass() -> None:
    """Independent check: no hole holds the section, so once the hand rests the torque is one all along, and what the
    ends take is equal and opposite."""
    system, _ = scene("fixed")
    state = steps("fixed")[-1].new
    for _ in range(20):
        state = advance(system, state, DT)[-1].new
    assert state.frame is not None
    torque = system.thread.torque(state.q, state.frame)
    mean = torque.mean()
    assert mean > 0.5 * system.thread.section.GJ * 2.0 * np.pi / LENGTH
    assert abs(state.reaction[:, 3].sum()) < LINEAR * mean
    assert np.abs(torque / mean - 1.0).max() < 0.02


def test_the_linear_step_twists_too() -> None:
    """Consistency check: the linear scheme, at a fifth of the step, ends where Newton's does."""
    system, state = scene("fixed")
    for _ in range(100):
        state = advance(system, state, DT / 5, linear_step)[-1].new
    other = steps("fixed")[-1].new
    assert np.abs(state.q - other.q)[:, :3].max() < 1e-2 * LENGTH
    assert np.abs(state.q - other.q)[:, 3].max() < 1e-2 * 2.0 * np.pi


def test_a_tangent_that_turns_too_far_in_a_step_is_refused() -> None:
    """Independent check: the smallest rotation is in doubt near 180°, so a step whose tangents end 150° from where they
    began (here: they rest, and are said to have begun elsewhere) is no step but a reason to halve it."""
    thread = uniform(LENGTH, 12, replace(PP, GJ=1e-30), twist=True)
    system = without_organ(thread)
    state = laid(system, [], line(START, X))
    assert state.frame is not None
    try_step(system, state, DT)
    began = np.cos(np.radians(150.0)) * X + np.sin(np.radians(150.0)) * Z
    elsewhere = replace(state.frame, t=np.broadcast_to(began, state.frame.t.shape))
    with pytest.raises(StepError, match="120°"):
        try_step(system, replace(state, frame=elsewhere), DT)


def test_a_try_without_tangents_is_refused_without_a_warning() -> None:
    """Independent check: a thread all of whose points lie in one has no direction for a frame to follow, its forces are
    no numbers, and the step says so in words; a warning would be an error here."""
    thread = uniform(LENGTH, 12, twist=True)
    system = without_organ(thread)
    state = laid(system, [], line(START, X))
    problem = dynamic_problem(system, state, DT, organ_answer(system, BackwardEuler(DT), state))
    gathered = Iterate(np.zeros_like(state.q), state.N, state.s, state.lam, state.y, state.sigma)
    with pytest.raises(StepError, match="a force is not finite"):
        solve(problem, gathered)
