"""The coupled system solved condensed and assembled, and what must hold at the end of every step of a coupled run."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from coupling.integrators import BackwardEuler
from coupling.kernels.constraints import driving_force, phi
from coupling.paper.assembled import Monolith, equation_of, monolithic_solve
from coupling.reports.audit import Energies, audit_step, initial_energies
from coupling.step.newton import solve
from coupling.step.stepping import Step, dynamic_problem, organ_answer, predict, try_step
from coupling.system import State, System
from tests.bounds import GAP, IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.coupling.multipliers import multiplier_imbalance
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    RADIUS,
    X,
    Z,
    block_organ,
    hairpin,
    hairpin_system,
    laid,
    taken,
)
from thread.ends import Driven, Fixed, Pulled

DT, STEPS = 2e-3, 8
FIBRE = np.array([0.3, 0.1, 1.0])
START, END = hairpin(RADIUS, LENGTH)(np.array([0.0, LENGTH]))
ORGANS = {
    f"{element} {kind} {frame}": (
        element,
        kind == "dynamic",
        "normal" if frame == "normal" else FIBRE,
    )
    for element in ("P1", "P2")
    for kind in ("dynamic", "quasi-static")
    for frame in ("normal", "fibre")
}
# The end is drawn up and sideways by 0.2 N within the run; the start is held.
DRAWN = (Fixed(START), Pulled(np.array([0.05, 0.02, 0.2]), np.array([[0.0, 0.0], [STEPS * DT, 1.0]])))


@cache
def scene(name: str) -> tuple[System, State]:
    element, inertia, direction = ORGANS[name]
    options: dict[str, Any] = {"gravity": (0.0, 0.0, -9.81)} | ({"rayleigh": (3.0, 1e-4)} if inertia else {})
    organ = block_organ(element, inertia, direction, **options)
    system = hairpin_system(organ, DRAWN, 60, gravity=-9.81 * Z)
    return system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))


@cache
def steps(name: str) -> list[Step]:
    return taken(*scene(name), DT, STEPS)


def close(got: np.ndarray, exact: np.ndarray, scale: float | None = None) -> bool:
    """Within TWO_SOLVERS of the largest entry, or of a scale."""
    size = np.abs(exact).max() if scale is None else scale
    return bool(size > 0.0 and np.abs(got - exact).max() <= TWO_SOLVERS * size)


@pytest.mark.parametrize("name", ORGANS)
def test_condensed_and_assembled_agree(name: str) -> None:
    """Consistency check: both solves of a step, from the same state, in each unknown on its own scale; in the middle
    of the run and at its end."""
    system, _ = scene(name)
    organ: Any = system.organ
    for step in (steps(name)[4], steps(name)[-1]):
        scheme, state = BackwardEuler(DT), step.old
        problem = dynamic_problem(system, state, DT, organ_answer(system, scheme, state))
        whole = equation_of(problem)
        first = predict(problem, state)
        a = solve(problem, first)
        b = monolithic_solve(problem, first, organ.field(state.organ))
        z = b.iterate
        assert isinstance(z, Monolith)
        assert a.iterations > 0 and b.iterations > 0
        assert close(a.iterate.q, z.q) and close(a.iterate.s, z.s)
        assert close(a.iterate.q - state.q, z.q - state.q)
        assert close(a.iterate.lam[:, :3], z.lam[:, :3]) and close(a.iterate.lam[:, 3:], z.lam[:, 3:])
        assert close(organ.field(step.new.organ), z.U)
        assert close(step.new.y, z.y) and close(step.new.N, z.N)
        assert close(organ.site_variables(step.new.organ), step.new.y.ravel())
        assert (
            np.abs(whole.A @ z.U - whole.b - organ.Y.T @ step.new.organ.f_y).max()
            <= RESIDUAL * np.abs(abs(whole.A) @ np.abs(z.U)).max() + TWO_SOLVERS * np.abs(step.new.organ.f_y).max()
        )


@pytest.mark.parametrize("name", ORGANS)
def test_every_step_of_a_coupled_run(name: str) -> None:
    """Independent check, at every step: Φ = 0; the driving force Φ_sᵀλ of an ideal hole is zero, and so is its work;
    the multipliers' forces and moments cancel; the hole's force is what the thread's ends and inertia leave."""
    system, _ = scene(name)
    for step in steps(name):
        new = step.new
        at = system.passage_of(new)
        violation = np.abs(phi(at, new.lam, new.y))
        assert violation[:, :3].max() <= GAP * system.thread.section.diameter
        assert violation[:, 3:].max() <= GAP
        force, couple = np.abs(new.lam[:, :3]).max(), np.abs(new.lam[:, 3:]).max()
        terms = np.abs(new.lam[:, 3:]).max(axis=1) * np.linalg.norm(at.K, axis=1)
        assert np.abs(driving_force(at, new.lam, new.y)).max() <= TWO_SOLVERS * max(force, terms.max())
        left_force, left_moment = multiplier_imbalance(system, new)
        arm = np.abs(new.q).max()
        assert left_force <= IDENTITY * force
        assert left_moment <= IDENTITY * (arm * force + couple)
    assert np.abs(new.s - steps(name)[0].old.s).max() > 1e-3 * RADIUS
    plain = np.einsum("mi,mi->m", new.lam[:, :3], at.T)
    assert np.abs(plain).max() > 1e-3 * force  # the direction's share is no round-off: eq. 6 alone would be wrong


@pytest.mark.parametrize("name", ORGANS)
def test_momentum_of_the_thread(name: str) -> None:
    """Independent check: the thread's momentum changes by weight, ends and holes, in every step."""
    system, _ = scene(name)
    for step in steps(name):
        M = system.thread.mass_matrix
        change = (M @ (step.new.v - step.old.v)).sum(axis=0) / DT
        weight = M.sum() * system.gravity
        forces = step.new.reaction.sum(axis=0) + step.new.lam[:, :3].sum(axis=0) + weight
        scale = np.abs(step.new.lam[:, :3]).max()
        assert np.abs(change - forces).max() <= TWO_SOLVERS * scale


@pytest.mark.parametrize("name", ORGANS)
def test_audit_closes_at_every_step(name: str) -> None:
    """Independent check: external work = Δ kinetic + Δ elastic + friction + viscous + numerical, per step, each by a
    formula of its own; ideal holes take nothing and a dynamic organ's damping takes something. What is left open is
    the Newton residual times the motion, so the bound is that of a residual."""
    system, state = scene(name)
    energies: list[Energies] = [initial_energies(system, state)]
    for step in steps(name):
        energies.append(audit_step(system, energies[-1], step))
    last = energies[-1]
    scale = max(abs(last.external_work), last.elastic_thread, last.elastic_tissue)
    errors = np.diff([e.balance_error for e in energies])
    assert np.abs(errors).max() <= RESIDUAL * scale
    assert abs(last.friction_dissipation) <= TWO_SOLVERS * scale
    assert (last.viscous_dissipation > 1e-6 * scale) == ("dynamic" in name)
    assert last.numerical_dissipation > 0.0


def test_external_work_is_that_of_the_hand() -> None:
    """Independent check: the hand's work summed by the trapezium of its recorded force is the audit's to first order,
    and the sum of the audit's parts exactly; the end is driven, so its work is a reaction's."""
    organ = block_organ("P1", False)
    way = np.array([[0.0, *END], [0.1, *(END + 2e-3 * Z + 1e-3 * X)]])
    system = hairpin_system(organ, (Fixed(START), Driven(way)), 40)
    state = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    energies, work, count = initial_energies(system, state), 0.0, 50
    for _ in range(count):
        step = try_step(system, state, 0.1 / count)
        work += step.new.reaction[1] @ (step.new.q[-1] - state.q[-1])
        energies, state = audit_step(system, energies, step), step.new
    assert abs(energies.external_work / work - 1.0) <= IDENTITY * count
    stored = energies.kinetic + energies.elastic_thread + energies.elastic_tissue
    before = initial_energies(system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH)))
    gained = stored - before.kinetic - before.elastic_thread - before.elastic_tissue
    assert abs(work - gained - energies.numerical_dissipation) <= RESIDUAL * work
