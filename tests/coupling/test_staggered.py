"""The staggered variant: what is held when, the drift, the energy of the lag, how it converges and how it runs away."""

import tomllib
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from coupling.errors import CouplingError, RunAwayError
from coupling.integrators import BackwardEuler
from coupling.kernels.constraints import phi, site_force
from coupling.kernels.steps.audit import REMAINDER
from coupling.paper import staggered
from coupling.reports.audit import audit_step, initial_energies, turned_over
from coupling.reports.observation import largest_gap, site_compliance
from coupling.step import stepping
from coupling.step.stepping import Step, Take, advance, organ_answer, try_step
from coupling.system import State, System
from studies.coupling_variants.study import scenario
from studies.scenario import ScenarioError, parse
from studies.simulation import prepare
from tests.bounds import GAP, IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.studies.samples import CONTRACT
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    RADIUS,
    X,
    Z,
    block_organ,
    hairpin,
    hairpin_sites,
    hairpin_system,
    laid,
)
from thread.ends import Driven, Fixed

PATH = hairpin(RADIUS, LENGTH)
START, END = PATH(np.array([0.0, LENGTH]))
REST, PULL = 0.1, 0.05  # s: the thread settles; then its end is drawn up by WAY
WAY = 2e-3
HAND = Driven(np.array([[0.0, *END], [REST, *END], [REST + PULL, *(END + WAY * Z + 0.5 * WAY * X)]]))
KINDS = {"dynamic": True, "quasi-static": False}


def organ_of(kind: str, E: float) -> Any:
    options: dict[str, Any] = {"rayleigh": (5.0, 5e-4)} if KINDS[kind] else {}
    return block_organ("P1", KINDS[kind], "normal", E, **options)


@cache
def scene(kind: str, E: float = 3e5) -> tuple[System, State]:
    """A hairpin at rest in two holes, before it is pulled."""
    system = hairpin_system(organ_of(kind, E), (Fixed(START), HAND), 30)
    state = laid(system, ABSCISSAE, PATH)
    for _ in range(50):
        state = advance(system, state, REST / 50)[-1].new
    return system, state


@cache
def run(kind: str, take: Take, n: int, E: float = 3e5) -> list[Step]:
    """The pull in `n` steps."""
    system, state = scene(kind, E)
    out: list[Step] = []
    for _ in range(n):
        out.append(take(system, state, PULL / n))
        state = out[-1].new
    return out


BDF2 = staggered.stagger(stepping.bdf2_step, stepping.scheme_of)
METHODS = {"euler": staggered.staggered_step, "bdf2": BDF2}


def lags(system: System, first: State, steps: list[Step]) -> list[float]:
    """Work of the lag of every step [J]."""
    met = [first.y, *(step.solution.iterate.y for step in steps)]
    return [staggered.work_of_the_lag(system, y, step) for y, step in zip(met[:-1], steps, strict=True)]


# -- what a step is --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_thread_meets_the_holes_where_they_were(kind: str) -> None:
    """Independent check (§4.4): P(s⁺) = x of the start and T ⟂ u, v of the start; so the drift after the organ's step
    is the way its holes went."""
    system, _ = scene(kind)
    for step in run(kind, staggered.staggered_step, 25):
        at = system.passage_of(step.new)
        violation = np.abs(phi(at, step.new.lam, step.old.y))
        assert violation[:, :3].max() <= GAP * system.thread.section.diameter
        assert violation[:, 3:].max() <= GAP
        drift = np.linalg.norm(at.P - step.new.y[:, :3], axis=1)
        way = np.linalg.norm((step.new.y - step.old.y)[:, :3], axis=1)
        assert np.abs(drift - way).max() <= GAP * system.thread.section.diameter
        assert largest_gap(system, step.new) == drift.max()
        assert drift.max() > 1e-4 * WAY / 25


@pytest.mark.parametrize("kind", KINDS)
def test_the_organ_takes_the_reaction(kind: str) -> None:
    """Independent check: action and reaction. The organ's own equation holds with Yᵀf_y, f_y = Φ_yᵀλ, and the force
    on its points is that on the thread, turned about."""
    system, _ = scene(kind)
    organ: Any = system.organ
    for step in run(kind, staggered.staggered_step, 25):
        scheme = BackwardEuler(step.dt)
        whole: Any = organ_answer(system, scheme, step.old)
        whole = whole.equation
        f_y = site_force(system.passage_of(step.new), step.new.lam, step.old.y).ravel()
        U = organ.displacement(step.new.organ)[organ.elasticity.free]
        right = whole.b + organ.Y.T @ f_y
        assert np.abs(whole.A @ U - right).max() <= RESIDUAL * (abs(whole.A) @ np.abs(U)).max()
        assert np.array_equal(f_y.reshape(-1, 9)[:, :3], -step.new.lam[:, :3])
        assert np.array_equal(organ.site_variables(step.new.organ), step.new.y.ravel())
        assert np.abs(step.new.lam[:, :3]).max() > 1e-3


def test_points_in_space_make_no_difference() -> None:
    """Consistency check: without an organ there is nothing to lag behind; both ways take the same step."""
    system = hairpin_system(hairpin_sites(), (Fixed(START), HAND), 30)
    state = laid(system, ABSCISSAE, PATH)
    one, other = try_step(system, state, 1e-3), staggered.staggered_step(system, state, 1e-3)
    assert np.array_equal(one.new.q, other.new.q) and np.array_equal(one.new.lam, other.new.lam)
    assert np.abs(one.new.y - other.new.y).max() <= GAP * system.thread.section.diameter
    assert staggered.work_of_the_lag(system, state.y, other) == pytest.approx(0.0, abs=GAP * WAY)


# -- energy ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_audit_closes_at_every_step(kind: str, method: str) -> None:
    """Independent check: every joule by its own formula, the lag's work among them; a monolithic step has none."""
    system, first = scene(kind)
    steps = run(kind, METHODS[method], 50)
    energies = [initial_energies(system, first)]
    for step in steps:
        energies.append(audit_step(system, energies[-1], step))
    scale = energies[-1].external_work
    assert np.abs(np.diff([e.balance_error for e in energies])).max() <= RESIDUAL * scale
    assert sum(np.abs(lags(system, first, steps))) > 1e-3 * scale
    last = steps[-1]
    assert staggered.work_of_the_lag(system, last.old.y, try_step(system, last.old, last.dt)) == pytest.approx(
        0.0, abs=IDENTITY * scale
    )


def test_the_work_of_the_lag_of_an_organ_that_follows_the_force() -> None:
    """Independent check: without inertia Δy = C Δf, so that a step creates f·C (Δf − Δf of the step before)."""
    system, first = scene("quasi-static")
    C = site_compliance(system, first)
    steps = run("quasi-static", staggered.staggered_step, 25)
    forces = [first.organ.f_y, *(step.new.organ.f_y for step in steps)]
    moves = [np.zeros_like(forces[0]), *(C @ (b - a) for a, b in pairwise(forces))]
    expected = [f @ (b - a) for f, (a, b) in zip(forces[1:], pairwise(moves), strict=True)]
    found = lags(system, first, steps)
    assert np.abs(np.subtract(found, expected)).max() <= TWO_SOLVERS * np.abs(expected).max()


def test_energy_that_is_created_shows_with_its_sign() -> None:
    """Independent check: an exchange that grows has its energy from nowhere but the lag. Kinetic and elastic energy
    rise beyond the hand's work; the numerical dissipation is negative by as much and the balance still closes."""
    system, first = scene("dynamic", 1e3)
    before = energies = initial_energies(system, first)
    state, steps = first, []
    with pytest.raises(CouplingError):
        for _ in range(200):
            steps.append(staggered.staggered_step(system, state, 2e-3))
            energies, state = audit_step(system, energies, steps[-1]), steps[-1].new
    gained = sum(
        getattr(energies, name) - getattr(before, name) for name in ("kinetic", "elastic_thread", "elastic_tissue")
    )
    assert energies.numerical_dissipation < 0.0
    assert gained > energies.external_work
    assert sum(lags(system, first, steps)) > -energies.numerical_dissipation
    assert sum(-turned_over(step)[REMAINDER] for step in steps) > -energies.numerical_dissipation
    assert abs(energies.balance_error) <= RESIDUAL * gained


# -- convergence -----------------------------------------------------------------------------------------------------


def test_drift_and_difference_are_of_first_order() -> None:
    """Independent check (theory): in a smooth pull the lag is one step, so the drift and what separates the holes'
    places from the monolithic ones fall with Δt. The ratio of halved steps is 2 within 15 %, in powers of two 0.2."""
    system, _ = scene("dynamic")
    drift, apart = [], []
    for n in (100, 200, 400):
        ours, exact = run("dynamic", staggered.staggered_step, n), run("dynamic", try_step, n)
        last = slice(n // 2, None)
        drift.append(max(largest_gap(system, step.new) for step in ours[last]))
        pairs = zip(ours[last], exact[last], strict=True)
        apart.append(max(np.abs(a.new.y - b.new.y)[:, :3].max() for a, b in pairs))
    assert largest_gap(system, exact[-1].new) <= GAP * system.thread.section.diameter < 1e-3 * drift[-1]
    assert np.log2(drift[1] / drift[2]) == pytest.approx(1.0, abs=0.2)
    assert np.log2(apart[1] / apart[2]) == pytest.approx(1.0, abs=0.2)


# -- running away ----------------------------------------------------------------------------------------------------


def test_a_run_that_grows_is_stopped_by_name() -> None:
    """Independent check: a soft organ without inertia answers each force with more way than the thread had given it.
    The error tells time, step, piercing and way; halving the step is no remedy and is not tried; the state stays."""
    system, state = scene("quasi-static", 5e3)
    kept = [x.copy() for x in vars(state).values() if isinstance(x, np.ndarray)]
    first = state
    with pytest.raises(RunAwayError) as caught:
        for _ in range(200):
            state = advance(system, state, 1e-3, staggered.staggered_step)[-1].new
    error = caught.value
    assert error.piercing in ("entry", "exit") and error.piercing in str(error)
    assert error.way > 0.1 * LENGTH
    assert error.time >= REST and 'coupling = "monolithic"' in str(error)
    assert np.isfinite(state.y).all()
    arrays = [x for x in vars(first).values() if isinstance(x, np.ndarray)]
    assert all(np.array_equal(a, b) for a, b in zip(kept, arrays, strict=True))


def test_what_is_no_number_is_stopped_too() -> None:
    """Independent check: a hole that is nowhere has run away."""
    system, state = scene("quasi-static")
    with pytest.raises(RunAwayError, match="entry"):
        staggered.refuse_runaway(system, state, np.full_like(state.y, np.nan), 1e-3)
    staggered.refuse_runaway(system, state, state.y, 1e-3)


# -- scenario --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["euler", "bdf2"])
def test_the_key_of_the_scenario(integrator: str) -> None:
    """A run by the scenario's key: the largest drift is recorded with the organ's new places, and is what no
    monolithic run has."""
    base = scenario(2.5e5, size=5e-3)
    gaps = {}
    for coupling in ("monolithic", "staggered"):
        solve = base.solve.model_copy(update={"coupling": coupling, "integrator": integrator, "duration": 0.14})
        records = [record for record, _ in prepare(base.model_copy(update={"solve": solve})).advance()]
        gaps[coupling] = max(record.constraint_max for record in records)
        last = records[-1].energy
        assert abs(last.balance_error) <= RESIDUAL * last.elastic_thread
    assert gaps["monolithic"] <= 1e-12
    assert 1e-6 < gaps["staggered"] < 1e-3


def test_a_static_solution_cannot_be_staggered() -> None:
    table = tomllib.loads(CONTRACT)
    table["solve"] |= {"kind": "static", "coupling": "staggered"}
    with pytest.raises(ScenarioError, match=r'solve\.coupling = "staggered" is refused'):
        parse(table)
