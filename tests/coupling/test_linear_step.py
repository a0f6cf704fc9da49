"""The paper's linear step: stability of Baumgarte's term, the velocity terms, ε, both solvers, and its order."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coupling.errors import CouplingError, CreatedEnergyError, StepError
from coupling.kernels.constraints import driving_force, passage, phi, pressing_force
from coupling.paper.elimination import elimination, solve_by_elimination, whole_matrix
from coupling.paper.linear_step import (
    CREATED,
    constrained,
    linear_step,
    linear_two_pass,
    phi_rate,
    pose,
    restoring_acceleration,
    solve_posed,
    velocity_terms,
)
from coupling.paper.two_pass import two_pass
from coupling.reports.audit import Energies, audit_step, initial_energies
from coupling.step.stepping import advance, try_step
from coupling.system import Friction, Piercing, State, System
from studies.scenario import ScenarioError, Solve, load
from studies.simulation import prepare
from studies.simulation.simulation import method
from tests.bounds import IDENTITY, ORDER, RESIDUAL, TWO_SOLVERS
from tests.coupling.multipliers import multiplier_imbalance
from tests.studies.samples import CONTRACT
from tests.thread.threads import (
    ABSCISSAE,
    FREE,
    LENGTH,
    ORIGIN,
    RADIUS,
    Strand,
    X,
    Y,
    Z,
    assert_slope,
    bent,
    block_organ,
    greville,
    hairpin,
    hairpin_sites,
    hairpin_system,
    laid,
    line,
    uniform,
    without_organ,
)
from thread.ends import Clamped, Driven, Fixed, Free, Pulled

Take = Callable[[System, State, float], Any]
PATH = hairpin(RADIUS, LENGTH)
START, END = PATH(np.array([0.0, LENGTH]))
GOLDEN = 0.5 * (1.0 + np.sqrt(5.0))


def bare_hairpin(*args: Any, **options: Any) -> System:
    """The hairpin's system on a spline as it is: the linear step knows no missing compliance."""
    system = hairpin_system(*args, **options)
    return replace(system, thread=replace(system.thread))


def drawn(way: float = 2e-3, time: float = 0.04) -> tuple[Fixed, Driven]:
    """The start held, the end driven up smoothly by `way` in `time`: from rest and to rest, in 64 pieces."""
    t = np.linspace(0.0, time, 65)
    rise = way * (t / time - np.sin(2 * np.pi * t / time) / (2 * np.pi))
    return Fixed(START), Driven(np.column_stack([t, END + rise[:, None] * Z]))


@cache
def scene(kind: str) -> tuple[System, State]:
    """A real suture through two directed holes, fixed in space or in an organ, about to be drawn."""
    options: dict[str, Any] = {"gravity": (0.0, 0.0, -9.81)} | ({"rayleigh": (3.0, 1e-4)} if kind == "dynamic" else {})
    organ = hairpin_sites() if kind == "fixed" else block_organ("P1", kind == "dynamic", **options)
    system = bare_hairpin(organ, drawn(), 40, gravity=-9.81 * Z)
    return system, laid(system, ABSCISSAE, PATH)


KINDS = ("fixed", "quasi-static", "dynamic")


def violation(system: System, state: State) -> np.ndarray:
    """Φ of all holds, `(m, 5)`."""
    return phi(passage(system.thread.spline, state.q, state.s), state.lam, state.y)


def run(system: System, state: State, dt: float, duration: float, take: Take = linear_step) -> list[Any]:
    """All steps; none may be halved."""
    out: list[Any] = []
    for _ in range(round(duration / dt)):
        out.append(take(system, state, dt))
        state = out[-1].new
    return out


# -- stability ---------------------------------------------------------------------------------------------------------


def violations(dt: float, evaluation: Any, count: int, size: float) -> np.ndarray:
    """Φ of a straight thread nothing acts on, started off its hole, turned, and moving; shape `(count, 5)`."""
    thread = uniform(0.1, 14)
    system = without_organ(thread, FREE, (Piercing("hole"),), [(np.array([0.04, 0.0, 0.0]), X)])
    state = laid(system, [0.04], line(ORIGIN, X))
    off = size * (Y + 0.3 * Z) + size * greville(thread.spline)[:, None] * (5.0 * Y + Z)
    drift = size / dt * (0.3 * Y - Z) * np.ones((thread.n, 1))
    state, out = replace(state, q=state.q + off, v=drift), []
    for _ in range(count):
        out.append(violation(system, state)[0])
        state = solve_posed(pose(system, state, dt, evaluation)).new
    return np.array(out)


@pytest.mark.parametrize("dt", [1e-5, 1e-4, 1e-3, 1e-2])
def test_a_violation_halves_at_every_step(dt: float) -> None:
    """Independent check: evaluated at the end of the step, (2E − 1)² Φ = 0 with E the shift by a step: a double root
    ½ for every Δt, of both kinds of constraint. The part of Φ along the thread is met by s, and stays round-off."""
    across = violations(dt, "end", 14, 1e-9)[:, 1:]
    left = across[2:] - across[1:-1] + 0.25 * across[:-2]
    assert np.all(np.abs(across[0]) > 0.0)
    assert np.all(np.abs(left).max(axis=0) <= TWO_SOLVERS * np.abs(across).max(axis=0))
    assert np.all(np.abs(across[-1]) < 14 * 0.5**11 * np.abs(across).max(axis=0))


@pytest.mark.parametrize("dt", [1e-4, 1e-3])
def test_the_literal_evaluation_diverges(dt: float) -> None:
    """Independent check: evaluated at the start of the step with implicit Euler, eq. 5 is E² + E − 1 = 0: the
    violation changes its sign and grows by the golden ratio, 1.618, a step."""
    across = violations(dt, "start", 24, 1e-13)[:, 1:3]
    left = across[2:] + across[1:-1] - across[:-2]
    assert np.all(np.abs(left).max(axis=0) <= 1e-6 * np.abs(across).max(axis=0))
    assert np.abs(across[-1] / across[-2] + GOLDEN).max() <= 1e-6
    assert np.all(np.abs(across[-1]) > 1e3 * np.abs(across[0]))


@pytest.mark.parametrize("dt", [1e-4, 1.0])
def test_the_map_of_an_error(dt: float) -> None:
    """Independent check: (Φ, ΔtΦ̇) → its next, from the formula alone; the roots by the quadratic's coefficients."""

    def characteristic(evaluation: Any) -> tuple[float, float]:
        columns = []
        for violation, rate in ((1.0, 0.0), (0.0, 1.0)):
            more = dt**2 * restoring_acceleration(np.array([violation]), np.array([rate / dt]), dt, evaluation)[0]
            columns.append([violation + rate + more, rate + more])
        return float(np.trace(columns)), float(np.linalg.det(columns))

    assert characteristic("end") == pytest.approx((1.0, 0.25), rel=IDENTITY)
    assert characteristic("start") == pytest.approx((-1.0, -1.0), rel=IDENTITY)


# -- velocity terms ----------------------------------------------------------------------------------------------------


def prescribed_motion() -> tuple[Any, ...]:
    """q, q̇, q̈, s, ṡ, s̈, y, ẏ, ÿ of two holes on a bent thread, in no special way, in units of the thread's length."""
    rng = np.random.default_rng(3)
    thread = uniform(1.0, 10)
    shapes = ((10, 3), (2,), (2, 9))
    starts = (bent(thread.spline), np.array([0.33, 0.71]), rng.normal(size=(2, 9)))
    rates = [(0.3 * rng.normal(size=shape), 0.3 * rng.normal(size=shape)) for shape in shapes]
    return thread, *((x, v, a) for x, (v, a) in zip(starts, rates, strict=True))


@pytest.mark.parametrize("row", range(5))
def test_rates_of_the_constraints(row: int) -> None:
    """Independent check: Φ̇ and Φ̈ along a prescribed motion against central differences, row by row; each velocity
    term is in it, since thread, abscissa and site all move and turn."""
    thread, *motion = prescribed_motion()

    def at(t: float, derivative: int) -> list[np.ndarray]:
        return [x + t * v + 0.5 * t**2 * a if derivative == 0 else v + t * a for x, v, a in motion]

    def rate(t: float) -> np.ndarray:
        (q, s, y), (v, s_dot, y_dot) = at(t, 0), at(t, 1)
        here, moving = passage(thread.spline, q, s), passage(thread.spline, v, s)
        return phi_rate(here, moving, y, s_dot, y_dot)[:, row]

    def value(t: float) -> np.ndarray:
        q, s, y = at(t, 0)
        return phi(passage(thread.spline, q, s), np.zeros((len(s), 5)), y)[:, row]

    (q, v, a), (s, s_dot, s_acc), (y, y_dot, y_acc) = motion
    here, moving = passage(thread.spline, q, s), passage(thread.spline, v, s)
    linear = phi_rate(here, passage(thread.spline, a, s), y, s_acc, y_acc)[:, row]
    w = velocity_terms(here, moving, y, s_dot, y_dot)[:, row]
    assert_slope(value, rate(0.0), 1e-2)
    assert_slope(rate, linear + w, 1e-2)
    assert np.abs(w).min() > 1e-3


def moving_scene() -> tuple[System, State]:
    """A slack thread that slides through a directed hole and turns about it, Φ = Φ̇ = 0, all terms of w at work."""
    section = Strand(diameter=1e-3, rhoA=1e-3, EA=1e-3, EI=1e-9)
    thread = uniform(0.1, 14, section)
    point = np.array([0.04, 0.0, 0.0])
    system = without_organ(thread, FREE, (Piercing("hole"),), [(point, X)])
    state = laid(system, [0.043], line(-0.003 * X, X))
    x = greville(thread.spline) / 0.1 - 0.43
    bow = (0.004 * x**2)[:, None] * (Y + 0.4 * Z)
    spin = (0.3 * x)[:, None] * Y + (0.2 * x**2)[:, None] * Z
    q, s_dot = state.q + bow, np.array([0.15])
    at = passage(thread.spline, q, state.s)
    state = replace(state, q=q + (point - at.P), v=spin, s_dot=s_dot, y_dot=np.zeros_like(state.y))
    frame = np.concatenate([point, *np.linalg.qr(np.column_stack([at.T[0], Y, Z]))[0].T[1:]])[None]
    return replace_site(system, frame), consistent(system, replace(state, y=frame, sense=np.zeros(1)))


def replace_site(system: System, y: np.ndarray) -> System:
    return replace(system, organ=replace(system.organ, y0=y.ravel()))


def consistent(system: System, state: State) -> State:
    """The velocity made to fit Φ̇ = 0 by a rigid motion and a turn of the thread's points."""
    spline = system.thread.spline
    at = passage(spline, state.q, state.s)
    x = greville(spline) - state.s[0]
    basis = [np.outer(f, e) for f in (np.ones_like(x), x) for e in np.eye(3)]

    def rate(v: np.ndarray) -> np.ndarray:
        return phi_rate(at, passage(spline, v, state.s), state.y, state.s_dot, 0.0 * state.y)[0]

    base = rate(0.0 * state.v)
    columns = np.column_stack([rate(v) - base for v in basis])
    more = np.linalg.lstsq(columns, -rate(state.v), rcond=None)[0]
    return replace(state, v=state.v + sum(c * v for c, v in zip(more, basis, strict=True)))


def rate_after(dt: float) -> float:
    """|Φ̇| after one step from a consistent start over |w|, the larger of point and direction."""
    system, state = moving_scene()
    spline, still = system.thread.spline, 0.0 * state.y
    at = passage(spline, state.q, state.s)
    w = velocity_terms(at, passage(spline, state.v, state.s), state.y, state.s_dot, still)
    new = linear_step(system, state, dt).new
    here = passage(spline, new.q, new.s)
    rate = phi_rate(here, passage(spline, new.v, new.s), new.y, new.s_dot, still)
    return max(float(np.abs(rate[:, part]).max() / np.abs(w[:, part]).max()) for part in (slice(0, 3), slice(3, 5)))


def test_a_consistent_motion_stays_consistent_to_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: from Φ = Φ̇ = 0 the step asks for Φ̈ = 0, so that Φ̇ after it is O(Δt²); without the velocity
    terms it is Δt w/4·4, of first order: the check fails without them."""
    system, state = moving_scene()
    at, rate = (passage(system.thread.spline, x, state.s) for x in (state.q, state.v))
    assert np.abs(phi(at, state.lam, state.y)).max() <= RESIDUAL
    assert np.abs(phi_rate(at, rate, state.y, state.s_dot, 0.0 * state.y)).max() <= RESIDUAL
    coarse, fine = rate_after(1e-4), rate_after(5e-5)
    assert abs(np.log2(coarse / fine) - 2.0) <= ORDER
    monkeypatch.setattr("coupling.paper.linear_step.velocity_terms", lambda *a: np.zeros((1, 5)))
    assert rate_after(5e-5) > 10 * fine
    assert abs(np.log2(rate_after(1e-4) / rate_after(5e-5)) - 1.0) <= ORDER


# -- ε, and the two solvers --------------------------------------------------------------------------------------------


EPSILONS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8)


def masses(epsilon: float) -> tuple[System, State]:
    """Half a kilogram and one over two holes, on a heavy thread (1 kg/m), so that ε [kg] is small beside them."""
    section = Strand(diameter=1e-3, rhoA=1.0, EA=50.0, EI=1e-5)
    thread = uniform(LENGTH, 24, section, point_masses=(0.5, 1.0))
    holes = (Piercing("a", directed=False), Piercing("b", directed=False))
    system = bare_hairpin(hairpin_sites(), (Free(), Free()), 24, holes, gravity=9.81 * Z, epsilon=epsilon)
    system = replace(system, thread=thread)
    return system, laid(system, ABSCISSAE, PATH)


def constraint_work(epsilon: float) -> tuple[float, list[Any], System]:
    """Σ|Φ_sᵀλ Δs| over 20 ms, the steps and the system."""
    system, state = masses(epsilon)
    steps = run(system, state, 1e-3, 0.02)
    work = sum(
        float(np.abs(driving_force(s.solution.residual.passage, s.new.lam, s.old.y) * (s.new.s - s.old.s)).sum())
        for s in steps
    )
    return work, steps, system


def test_the_work_of_the_constraint_tends_to_zero_with_epsilon() -> None:
    """Independent check: eq. 7 lets the constraint do the work ε s̈ Δs, linear in ε once ε is small beside the masses;
    eq. 6 (ε = 0) allows none."""
    work = {e: constraint_work(e)[0] for e in (*EPSILONS, 0.0)}
    order = np.diff(np.log([work[e] for e in EPSILONS])) / np.diff(np.log(EPSILONS))
    assert np.all(order > 0.5)
    assert np.all(np.abs(order[2:] - 1.0) < 0.03)
    assert work[1e-8] > 0.0
    assert work[0.0] <= IDENTITY * work[1e-1]


def test_condition_of_both_matrices() -> None:
    """Independent check: the whole matrix does not notice ε, zero included; that of the elimination holds 1/ε."""
    whole, reduced = {}, {}
    for epsilon in (*EPSILONS, 1e-10, 1e-12, 0.0):
        system, state = masses(epsilon)
        posed = pose(system, linear_step(system, state, 1e-3).new, 1e-3)
        whole[epsilon] = np.linalg.cond(whole_matrix(posed))
        if epsilon:
            reduced[epsilon] = np.linalg.cond(elimination(posed).matrix)
    assert max(whole.values()) < 1.1 * min(whole.values()) < 1e4
    assert reduced[1e-10] / reduced[1e-8] == pytest.approx(100.0, rel=0.01)
    assert reduced[1e-12] / reduced[1e-8] == pytest.approx(1e4, rel=0.01)


@pytest.mark.parametrize("epsilon", [1e-1, 1e-3, 1e-6, 1e-8])
def test_elimination_is_the_whole_solve(epsilon: float) -> None:
    """Consistency check: tendency and correction against the whole matrix, after 10 steps, one hole held and a force
    injected at the other."""
    system, state = masses(epsilon)
    state = run(system, state, 1e-3, 0.01)[-1].new
    posed = constrained(pose(system, state, 1e-3), np.array([True, False]), np.array([0.0, -0.7]))
    for case in (pose(system, state, 1e-3), posed):
        a, b = solve_posed(case).new, solve_posed(case, solve_by_elimination).new
        assert np.abs(a.q - b.q).max() <= TWO_SOLVERS * np.abs(a.q - state.q).max()
        assert np.abs(a.s - b.s).max() <= TWO_SOLVERS * np.abs(a.s - state.s).max()
        assert np.abs(a.lam - b.lam).max() <= TWO_SOLVERS * np.abs(a.lam).max()


@pytest.mark.parametrize("kind", KINDS)
def test_elimination_with_an_organ(kind: str) -> None:
    """Consistency check: both solvers on a real suture through a yielding organ, ε a hundredth of the thread's mass."""
    system, state = scene(kind)
    system = replace(system, epsilon=1e-2 * system.thread.mass_matrix.sum())
    state = run(system, state, 1e-3, 5e-3)[-1].new
    posed = pose(system, state, 1e-3)
    a, b = solve_posed(posed).new, solve_posed(posed, solve_by_elimination).new
    assert np.abs(a.q - b.q).max() <= TWO_SOLVERS * np.abs(a.q - state.q).max()
    for part in (slice(0, 3), slice(3, 5)):
        assert np.abs(a.lam - b.lam)[:, part].max() <= TWO_SOLVERS * np.abs(a.lam[:, part]).max()
    assert np.abs(a.y - b.y).max() <= TWO_SOLVERS * max(np.abs(a.y - state.y).max(), LENGTH * IDENTITY)


def test_the_whole_matrix_is_the_system_that_is_solved() -> None:
    """Consistency check: the dimensionless matrix times the solution of the banded solve is the right-hand side that
    its residuals give, a yielding organ and a clamped end included."""
    ends = (Clamped(START, -Z), drawn()[1])
    system = bare_hairpin(block_organ("P1", True), ends, 40, epsilon=1e-6)
    state = run(system, laid(system, ABSCISSAE, PATH), 1e-3, 3e-3)[-1].new
    dt, n, m = 1e-3, 40, system.holds
    posed = pose(system, state, dt)
    new, matrix = solve_posed(posed).new, whole_matrix(posed)
    mu = (dt**2 * np.abs(posed.problem.inertia + posed.tangent)).max()
    span = LENGTH / (n - 3)
    x = [(new.q - posed.guess.q).ravel() / dt**2, (new.s - posed.guess.s) / dt**2]
    x.append((new.lam / [1, 1, 1, span, span]).ravel() / mu)
    right = matrix @ np.concatenate(x)
    free = np.setdiff1d(np.arange(3 * n), system.held)
    force = -posed.r_q.ravel()[free] / mu
    wanted = (-posed.r[:, 1:] * [1, 1, 1, span, span] / dt**2)[posed.problem.rows]
    assert np.abs(right[: 3 * n][free] - force).max() <= TWO_SOLVERS * np.abs(force).max()
    got = right[3 * n + m :].reshape(m, 5)[posed.problem.rows]
    assert np.abs(got - wanted).max() <= TWO_SOLVERS * np.abs(wanted).max()
    assert np.abs(right[3 * n : 3 * n + m]).max() <= TWO_SOLVERS * np.abs(x[2]).max()


def test_elimination_needs_epsilon() -> None:
    """Independent check: it divides by ε, and says so; where its matrix is too bad the step is refused."""
    system, state = masses(0.0)
    with pytest.raises(CouplingError, match="epsilon = 0"):
        solve_posed(pose(system, state, 1e-3), solve_by_elimination)
    system, state = masses(1e-15)
    state = run(system, state, 1e-3, 5e-3)[-1].new
    with pytest.raises(StepError, match="raise epsilon"):
        solve_posed(pose(system, state, 1e-3), solve_by_elimination)


# -- a real suture, and the monolithic organ ---------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_linear_and_newton_have_one_limit(kind: str) -> None:
    """Consistency check: linear and Newton's step differ by O(Δt) after a motion, and the violation is O(Δt²), once the
    jump is over that an organ without inertia makes when the thread's bends first press on it."""
    system, start = scene(kind)
    gaps, away = [], []
    for dt in (2e-3, 1e-3, 5e-4, 2.5e-4):
        a, b = (run(system, start, dt, 0.02, take) for take in (linear_step, try_step))
        away.append(np.abs(a[-1].new.q - b[-1].new.q).max())
        gaps.append(max(np.abs(violation(system, step.new)[:, :3]).max() for step in a[len(a) // 2 :]))
    assert np.log2(away[-2] / away[-1]) > 1.0 - ORDER
    assert np.log2(gaps[-2] / gaps[-1]) > 2.0 - 2 * ORDER
    assert away[-1] < 0.02 * np.abs(a[-1].new.q - start.q).max()


@pytest.mark.parametrize("kind", KINDS)
def test_every_linear_step(kind: str) -> None:
    """Independent check, at every step: the audit closes, ideal holes take nothing, the multipliers' forces cancel and
    the organ's site variables are those of its own field."""
    system, state = scene(kind)
    energies: list[Energies] = [initial_energies(system, state)]
    for step in run(system, state, 1e-3, 0.02):
        energies.append(audit_step(system, energies[-1], step))
        new = step.new
        force, _ = multiplier_imbalance(system, new)
        assert force <= IDENTITY * np.abs(new.lam[:, :3]).max()
        sites = system.organ.site_variables(new.organ).reshape(-1, 9)
        assert np.abs(sites - new.y).max() <= IDENTITY
        change = (system.thread.mass_matrix @ (new.v - step.old.v)).sum(axis=0) / step.dt
        weight = system.thread.mass_matrix.sum() * system.gravity
        acting = new.reaction.sum(axis=0) + new.lam[:, :3].sum(axis=0) + weight
        assert np.abs(change - acting).max() <= TWO_SOLVERS * np.abs(new.lam[:, :3]).max()
    last = energies[-1]
    scale = max(abs(last.external_work), last.elastic_thread, last.elastic_tissue)
    assert scale > 0.0
    assert max(abs(e.balance_error) for e in energies) <= RESIDUAL * scale
    assert abs(last.friction_dissipation) <= IDENTITY * scale


def test_a_step_that_runs_away_is_halved() -> None:
    """Independent check: a load that throws the light thread further than its length in 8 ms is taken in shorter
    steps, never accepted."""
    holes = (Piercing("entry", directed=False), Piercing("exit", directed=False))
    system = bare_hairpin(hairpin_sites(), (Free(), Pulled(0.05 * Z)), 40, holes)
    state = laid(system, ABSCISSAE, PATH)
    with pytest.raises(StepError, match="ran away"):
        linear_step(system, state, 8e-3)
    assert len(advance(system, state, 8e-3, linear_step)) > 1


def test_a_thread_drawn_out_of_both_holes() -> None:
    """Independent check: drawn out at 1 m/s, some steps are refused and halved, none ends further than a diameter from
    where its linearisation has it, the thread leaves both holes and the audit closes."""
    way = 1.3 * LENGTH
    ends = (Free(), Driven(np.array([[0.0, *END], [way, *(END + way * Z)]])))
    system = bare_hairpin(hairpin_sites(), ends, 40)
    state = laid(system, ABSCISSAE, PATH)
    energies, sizes = initial_energies(system, state), []
    while state.time < way - 1e-9:
        for step in advance(system, state, 5e-4, linear_step):
            state, energies = step.new, audit_step(system, energies, step)
            sizes.append(step.dt)
            gap = np.abs(violation(system, state)[state.present][:, :3]).max(initial=0.0)
            assert gap <= 2.0 * system.thread.section.diameter
    assert not state.present.any()
    assert 0.0 < min(sizes) < max(sizes) == 5e-4
    assert abs(energies.balance_error) <= RESIDUAL * energies.external_work


def test_a_step_that_misses_its_hole_is_refused() -> None:
    """Independent check: turned so fast that the linearised thread misses the hole, the step names it."""
    system, state = moving_scene()
    fast = replace(state, v=40.0 * state.v, s_dot=40.0 * state.s_dot)
    linear_step(system, fast, 1e-3)
    with pytest.raises(StepError, match="misses a hole") as caught:
        linear_step(system, fast, 1e-2)
    assert caught.value.piercing == "hole"


# -- friction ----------------------------------------------------------------------------------------------------------


def test_held_and_injected() -> None:
    """Independent check: a held abscissa does not move; an injected force is the driving force Φ_sᵀλ/|T|, and the
    audit's friction is its work."""
    system, state = scene("dynamic")
    state = run(system, state, 1e-3, 5e-3)[-1].new
    held, force = np.array([True, False]), np.array([0.0, 0.02])
    step = solve_posed(constrained(pose(system, state, 1e-3), held, force))
    at = step.solution.residual.passage
    drive = driving_force(at, step.new.lam, state.y) / np.linalg.norm(at.T, axis=1)
    assert step.new.s[0] == state.s[0]
    assert step.new.s_dot[0] == 0.0
    assert abs(drive[0]) > 1e-6
    assert abs(drive[1] - 0.02) <= RESIDUAL * np.abs(step.new.lam).max()
    energies = audit_step(system, initial_energies(system, state), step)
    work = 0.02 * np.linalg.norm(at.T[1]) * (step.new.s[1] - state.s[1])
    assert abs(energies.friction_dissipation - work) <= TWO_SOLVERS * abs(work)
    assert abs(energies.balance_error) <= RESIDUAL * energies.elastic_thread


def test_friction_is_refused() -> None:
    """Independent check: a rough hole is not silently taken for an ideal one."""
    holes = (Piercing("entry"), Piercing("exit", friction=Friction(0.2, 0.1)))
    system = bare_hairpin(hairpin_sites(), drawn(), 40, holes)
    state = laid(system, ABSCISSAE, PATH)
    with pytest.raises(CouplingError, match=r"'exit'.*two passes"):
        linear_step(system, state, 1e-3)


def rough(mu: float, grip: float = 0.0) -> tuple[System, State]:
    """The two masses with friction at the second hole; they drive the thread one way."""
    system, state = masses(0.0)
    holes = (system.piercings[0], replace(system.piercings[1], friction=Friction(mu, mu, grip)))
    return replace(system, piercings=holes), replace(state, sigma=np.array([1.0, 0.0]))


def test_two_linear_passes_hold_and_let_slip() -> None:
    """Independent check: gripped by more than the weights the abscissa stays what it was, to the bit; else the thread
    slides under μ times the normal force of the pass before, against its motion, and the audit closes with what
    friction took."""
    mu = 0.1
    system, start = rough(mu, 100.0)
    stuck = run(system, start, 1e-3, 0.02, linear_two_pass)[-1].new
    assert stuck.s[1] == start.s[1]
    assert list(stuck.sigma) == [1.0, 0.0]
    system, state = rough(mu)
    energies, ratio, taken = initial_energies(system, state), [], [0.0]
    for step in run(system, state, 5e-4, 0.02, linear_two_pass):
        energies = audit_step(system, energies, step)
        taken.append(energies.friction_dissipation)
        at, lam = step.solution.residual.passage, step.new.lam
        f = driving_force(at, lam, step.old.y) / np.linalg.norm(at.T, axis=1)
        ratio.append(step.new.sigma[1] * f[1] / pressing_force(at, lam, step.old.y, np.zeros(2))[1])
    assert np.all(np.diff(taken)[5:] >= 0.0)  # once the thread bears on its corners
    assert taken[-1] > 1e-3 * energies.external_work
    assert abs(energies.balance_error) <= RESIDUAL * energies.external_work
    assert 0.0 < np.abs(np.array(ratio[5:]) - mu).max() < mu**2


def test_two_linear_passes_tend_to_those_of_newton() -> None:
    """Consistency check: the same algorithm on the linear and on Newton's step, O(Δt) apart."""
    system, start = rough(0.1)
    away = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        a, b = (run(system, start, dt, 0.02, take)[-1].new for take in (linear_two_pass, two_pass))
        away.append(np.abs(a.q - b.q).max())
    assert abs(np.log2(away[-2] / away[-1]) - 1.0) <= ORDER
    assert away[-1] < 0.02 * np.abs(a.q - start.q).max()


# -- the scenario ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (("solve.scheme='linear'",), ["solve.friction", "piercing.entry.friction", '"two-pass"']),
        (("solve.scheme='linear'", "solve.friction='two-pass'", "solve.kind='static'"), ["solve.scheme", "static"]),
    ],
)
def test_what_the_scenario_refuses(tmp_path: Path, override: tuple[str, ...], words: list[str]) -> None:
    """Independent check: no implicit friction, no statics, each told with the remedy."""
    path = tmp_path / "contract.toml"
    path.write_text(CONTRACT, encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load(path, override)
    assert all(word in str(caught.value) for word in words)


def test_the_scheme_of_a_scenario() -> None:
    """Independent check: the keys choose the step."""
    system, state = scene("fixed")
    for friction, take in (("implicit", linear_step), ("two-pass", linear_two_pass)):
        one = method(Solve.model_validate({"scheme": "linear", "friction": friction}))(system, state, 1e-4)
        assert np.array_equal(one.new.q, take(system, state, 1e-4).new.q)
    other = method(Solve())(system, state, 1e-4)
    assert not np.array_equal(other.new.q, linear_step(system, state, 1e-4).new.q)


def test_a_linear_run_that_creates_energy_ends() -> None:
    """Independent check: figure 1 of the paper by its linear scheme. At 1 ms a step creates as much energy as there is,
    and the run ends with the step, the hole and the remedy. At 0.2 ms no step comes near the bound."""
    overrides = ["solve.scheme='linear'", "solve.duration=0.05"]
    with pytest.raises(CreatedEnergyError, match=r"created .* J, .* take a smaller solve\.dt") as caught:
        list(prepare(load("paper_figure_1", overrides)).advance())
    assert caught.value.piercing in ("entry", "exit")
    assert caught.value.share > CREATED
    simulation = prepare(load("paper_figure_1", [*overrides, "solve.dt=2e-4"]))
    run = simulation.beginning()
    while run.number < simulation.steps:
        before, run = run, simulation.next(run)
        made = before.energies.numerical_dissipation - run.energies.numerical_dissipation
        assert made < 0.1 * CREATED * (run.energies.kinetic + run.energies.elastic)
