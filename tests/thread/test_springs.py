"""The paper's springs: derivatives by slope, calibration against the continuous energies, and the order they tend to
them with; and that a wider band is all the coupling sees of them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from coupling.integrators import BackwardEuler
from coupling.kernels.constraints import phi
from coupling.paper.assembled import Monolith, assemble, equation_of
from coupling.reports.audit import audit_step, initial_energies
from coupling.step.newton import allowed_share, correct, evaluate
from coupling.step.stepping import advance, dynamic_problem, organ_answer, predict
from coupling.system import Piercing, System
from tests.bounds import GAP, IDENTITY, ORDER, RESIDUAL, TWO_SOLVERS
from tests.thread.test_statics import ALONG_X, cantilever, equilibrium, tip_error
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    PP,
    RADIUS,
    Strand,
    X,
    Z,
    assert_derivatives,
    bent,
    block_organ,
    greville,
    hairpin,
    laid,
    straight,
    thread_on,
    uniform,
)
from thread.ends import Clamped, Driven, Pulled
from thread.errors import ThreadError
from thread.knots import clamped_knots
from thread.quadrature import gauss_rule
from thread.thread import Thread

KNOTS = clamped_knots(np.array([0.0, 0.1, 0.18, 0.3, 0.3, 0.45, 0.5, 0.7, 0.9, 1.0]))
SECTION = Strand(EA=3.0, EI=0.02, GJ=0.03)


@pytest.mark.parametrize("twist", [False, True])
@pytest.mark.parametrize("more", [0, 1, 20])
def test_derivatives(more: int, twist: bool) -> None:
    """Independent check: force and tangent against central differences, whatever the springs' number; the tangent is
    symmetric, and the axial force of the next iterate is the linearised law."""
    n = len(KNOTS) - 4
    thread = thread_on(KNOTS, SECTION, twist=twist, springs=n - 1 + more)
    rng = np.random.default_rng(more)
    q = np.pad(bent(thread.spline), ((0, 0), (0, int(twist))))
    frame = thread.untwisted_frame(q)
    q, d = q + 0.02 * rng.standard_normal(q.shape), 0.01 * rng.standard_normal(q.shape)
    points = assert_derivatives(thread, frame, q, d)
    both = [thread.EA * thread.points(q + x * d, frame).strain for x in (1.0, -1.0)]
    change = thread.next_axial_force(points, d) - thread.EA * points.strain
    assert np.abs(0.5 * (both[0] - both[1]) - change).max() <= 10 * IDENTITY * np.abs(change).max()


def test_a_straight_thread_stretched_and_twisted() -> None:
    """Independent check: stretch λ and twist φ of a straight thread store ½EA L (½(λ² − 1))² and ½GJ φ²/L, whatever
    the spacing, and pull and turn at the ends only."""
    thread = thread_on(KNOTS, SECTION, twist=True, springs=17)
    q = np.column_stack([1.07 * straight(thread.spline), 5.0 * greville(thread.spline)])
    points = thread.points(q, thread.untwisted_frame(q))
    strain = 0.5 * (1.07**2 - 1.0)
    exact = 0.5 * SECTION.EA * strain**2 + 0.5 * SECTION.GJ * 25.0
    assert abs(thread.energy(points) / exact - 1.0) <= 10 * IDENTITY
    pull = np.zeros((thread.n, 4))
    pull[[0, -1], 0], pull[[0, -1], 3] = SECTION.EA * strain * 1.07 * np.array([-1, 1]), SECTION.GJ * np.array([-5, 5])
    assert np.abs(thread.gradient(points) - pull).max() <= 10 * IDENTITY * SECTION.EA


def exact_energies(thread: Thread, q: np.ndarray) -> np.ndarray:
    """½∫ε² ds and ½∫θ'² ds by a rule of six points a span [m, 1/m]."""
    rule = gauss_rule(thread.spline, 6)
    T = thread.spline.curve(q, rule.s.ravel()).reshape(*rule.s.shape, 4, 4)[:, :, 1]
    return 0.5 * np.array(
        [np.sum(rule.w * (0.5 * (np.sum(T[..., :3] ** 2, axis=-1) - 1.0)) ** 2), np.sum(rule.w * T[..., 3] ** 2)]
    )


def test_stretch_and_twist_tend_to_the_continuous_energies() -> None:
    """Independent check: on one curve ever more springs, error with the square of the spacing."""
    base = uniform(1.0, 40, SECTION, twist=True)
    q = np.column_stack([bent(base.spline), 3.0 * np.sin(4.0 * greville(base.spline))])
    exact = exact_energies(base, q) * [SECTION.EA, SECTION.GJ]
    errors = []
    for count in (78, 156, 312):
        thread = replace(base, section=replace(SECTION, EI=0.0), springs=count)
        points = thread.points(q, thread.untwisted_frame(q))
        got = [energy.energy(at) for energy, at in zip(thread.energies, points.at, strict=True)]
        errors.append(np.abs(np.array(got) / exact - 1.0))
    assert errors[-1].max() < 1e-3
    assert np.abs(np.log2(errors[1] / errors[2]) - 2.0).max() < ORDER


def test_bending_tends_to_the_continuous_energy() -> None:
    """Independent check: EI φ²/2L of an arc, with the square of the spacing; half a spacing left loose at each end
    would make it the first power."""
    thread = uniform(1.0, 200, replace(SECTION, EA=0.0))
    s = greville(thread.spline)
    arc = np.column_stack([np.sin(2.0 * s), 1.0 - np.cos(2.0 * s), 0.0 * s]) / 2.0
    q = np.linalg.solve(basis(thread, s), arc)
    errors = []
    for count in (199, 398, 796):
        sprung = replace(thread, springs=count)
        errors.append(abs(sprung.energy(sprung.points(q)) / (0.5 * SECTION.EI * 4.0) - 1.0))
    assert errors[-1] < 1e-4
    assert abs(np.log2(errors[0] / errors[1]) - 2.0) < ORDER


def basis(thread: Thread, s: np.ndarray) -> np.ndarray:
    """Basis functions at abscissae, as a full matrix."""
    first, b = thread.spline.basis(s)
    full = np.zeros((len(s), thread.n))
    np.put_along_axis(full, first[:, None] + np.arange(4), b[:, 0], axis=1)
    return full


@pytest.mark.parametrize("k", [1, 5])
def test_elastica_of_springs(k: int) -> None:
    """Independent check: as many springs as T has functions, the tip tends to the elastica's with the square of the
    spacing."""
    errors = []
    for n in (20, 40, 80):
        system = cantilever(n, Pulled(k * PP.EI / 0.1**2 * Z))
        system = replace(system, thread=replace(system.thread, springs=n - 1))
        errors.append(tip_error(equilibrium(system, ALONG_X, 4), k))
    assert errors[0] < 1e-3
    assert abs(np.log2(errors[1] / errors[2]) - 2.0) < ORDER


def test_too_few_springs_are_refused() -> None:
    """Independent check: with fewer springs than T has functions the thread could stretch unseen."""
    with pytest.raises(ThreadError, match="at least 11"):
        uniform(1.0, 12, springs=10)


def test_springs_have_a_mass_on_any_knots() -> None:
    """Independent check: on spans too unequal for the rule of stretch, springs have the mass of their length."""
    thread = thread_on(clamped_knots(np.array([0.0, 0.01, 0.5, 0.51, 1.0])), SECTION, springs=20)
    assert thread.mass_matrix.sum() == pytest.approx(thread.section.rhoA, rel=IDENTITY)
    with pytest.raises(ThreadError, match="differ too much"):
        replace(thread, springs=None).axial_rule  # noqa: B018


@pytest.mark.parametrize("twist", [False, True])
def test_springs_in_holes(twist: bool) -> None:
    """Consistency check: a thread of springs drawn through an organ; the condensed correction is the assembled one, the
    constraints hold, and the audit closes."""
    start, end = hairpin(RADIUS, LENGTH)(np.array([0.0, LENGTH]))
    way, turn = np.array([[0.0, *end], [0.04, *(end + 2e-3 * (X + Z))]]), np.array([[0.0, 0.0], [0.04, 6.0]])
    hand = Driven(way, turn=turn if twist else None)
    organ: Any = block_organ("P1", True)
    thread = uniform(LENGTH, 40, twist=twist, springs=39)
    system = System(thread, (Clamped(start, -Z), hand), organ, (Piercing("entry"), Piercing("exit")))
    state = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    energies = [initial_energies(system, state)]
    for _ in range(10):
        for step in advance(system, state, 2e-3):
            energies.append(audit_step(system, energies[-1], step))
        state = step.new
        violation = np.abs(phi(system.passage_of(state), state.lam, state.y))[:2, :3]
        assert violation.max() <= GAP * thread.section.diameter
    errors = np.diff([e.balance_error for e in energies])
    assert np.abs(errors).max() <= RESIDUAL * energies[-1].external_work
    scheme = BackwardEuler(2e-3)
    problem = dynamic_problem(system, state, 2e-3, organ_answer(system, scheme, state))
    whole = equation_of(problem)
    z = predict(problem, state)
    U = organ.displacement(state.organ)[organ.elasticity.free]
    y = np.concatenate([(whole.y0 + whole.Y @ U).reshape(-1, 9), system.clamp_frames])
    shaken = np.random.default_rng(1).standard_normal(z.q.shape) * [1e-5, 1e-5, 1e-5, 0.1][: thread.coordinates]
    z = Monolith(z.q + shaken, z.N, z.s, z.lam, y, z.sigma, U)
    r = evaluate(problem, z)
    block = assemble(problem, z, r)
    dq = splu(block.matrix).solve(block.right)[block.blocks["q"]].reshape(z.q.shape)
    dq *= allowed_share(problem, dq)
    got = correct(problem, z, r)[1].q - z.q
    for part in (slice(0, 3), slice(3, z.q.shape[1])):
        size = np.abs(dq[:, part]).max(initial=0.0)
        assert np.abs((got - dq)[:, part]).max(initial=0.0) <= TWO_SOLVERS * size
