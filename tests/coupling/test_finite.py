"""The coupled system with an organ at finite strain: two solves, quadratic convergence, frame indifference, energy."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import skfem

import tissue
from coupling.errors import StepError
from coupling.integrators import BackwardEuler, Equilibrium
from coupling.paper.assembled import Monolith, monolithic_solve
from coupling.reports.audit import audit_step, initial_energies
from coupling.step.newton import Iterate, Problem, Residual, correct, solve
from coupling.step.stepping import Step, dynamic_problem, organ_answer, predict
from coupling.system import System
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.coupling.test_answer import size
from tests.thread.threads import SITES, Array, X, last_by_newton, pulled_hairpin, taken
from tissue.materials.isotropic import Exponential
from tissue.organs import finite
from tissue.organs.finite import FiniteAnswer, Forces

DT, STEPS, E = 2e-3, 5, 2.0e4
FEWER = 0.9  # of the corrections; the steps of this scene are longer than a tangent serves
FIBRE = np.array([0.3, 0.1, 1.0])
PULL = np.array([0.1, 0.04, 0.4])
SQUARED = 10.0  # what a residual may be of the square of the one before it
TURNED = 1e-9  # of each number: the scene turned is rounded anew, and solved to 1e-10
CASES = {
    f"{element} {'dynamic' if inertia else 'quasi-static'} {'fibre' if direction is FIBRE else 'normal'}": (
        element,
        inertia,
        direction,
    )
    for element, inertia, direction in (
        ("P1", True, "normal"),
        ("P1", False, FIBRE),
        ("P1", True, FIBRE),
        ("P2", False, "normal"),
    )
}


def rotation(degrees: float, axis: Array) -> Array:
    """The rotation about an axis, shape `(3, 3)` (Rodrigues)."""
    a, angle = axis / np.linalg.norm(axis), np.radians(degrees)
    K = np.cross(np.eye(3), a)
    return np.asarray(np.eye(3) - np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def organ(element: str, inertia: bool, direction: Any, R: Array = np.eye(3), **options: Any) -> tissue.FiniteOrgan:  # noqa: B008
    """A small block of stiffening tissue, turned by R, held below, with the two sites of the hairpin on its top."""
    cells = (6, 4, 3) if element == "P1" else (3, 2, 2)
    lines = [
        np.linspace(*ends, n + 1) for ends, n in zip(((-0.015, 0.015), (-0.01, 0.01), (-0.01, 0.0)), cells, strict=True)
    ]
    mesh = skfem.MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: np.isclose(x[2], -0.01)})
    turned = skfem.MeshTet(R @ mesh.p, mesh.t, _boundaries=mesh.boundaries)
    body = tissue.elasticity(turned, tissue.Material(E, 0.46, 1070.0), element, ("bottom",))
    along = direction if isinstance(direction, str) else R @ direction
    sites = tissue.build_sites(body, [tissue.Site(R @ point, 2e-3, "parabolic", along) for point in SITES])
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, 3.0))
    return tissue.FiniteOrgan(body, sites, R @ (0, 0, -9.81), law=hyper, inertia=inertia, **options)


def scene(name: str, R: Array = np.eye(3), **options: Any) -> tuple[System, Any]:  # noqa: B008
    """The hairpin in that block: its start is held, its end drawn up and sideways within the run."""
    element, inertia, direction = CASES[name]
    made = organ(element, inertia, direction, R, **({"damping": 3.0} if inertia else {}) | options)
    return pulled_hairpin(made, PULL, STEPS * DT, R)


@cache
def steps(name: str) -> list[Step]:
    return taken(*scene(name), DT, STEPS)


def close(got: Array, exact: Array, bound: float = TWO_SOLVERS) -> bool:
    scale = np.abs(exact).max()
    return bool(scale > 0.0 and np.abs(got - exact).max() <= bound * scale)


@pytest.mark.parametrize("name", CASES)
def test_condensed_and_assembled_agree(name: str) -> None:
    """Consistency check: both solves of a step from the same state, in each unknown on its own scale."""
    step, problem, first, a = last_by_newton(steps(name), DT)
    made: Any = scene(name)[0]
    b = monolithic_solve(problem, first, step.old.organ.U)
    z = b.iterate
    assert isinstance(z, Monolith)
    assert close(a.iterate.q - step.old.q, z.q - step.old.q) and close(a.iterate.s, z.s)
    assert close(a.iterate.lam[:, :3], z.lam[:, :3]) and close(a.iterate.lam[:, 3:], z.lam[:, 3:])
    assert close(step.new.organ.U, z.U) and close(step.new.y, z.y)
    assert close(made.organ.site_variables(step.new.organ), step.new.y.ravel())


@pytest.mark.parametrize("name", CASES)
def test_the_organ_is_in_balance_with_the_holes(name: str) -> None:
    """Independent check, at every step: inertia, cells and weight leave what the holes push with, and the tissue is
    strained far beyond the linear range."""
    made: Any = scene(name)[0].organ
    for step in steps(name):
        old, new = step.old.organ, step.new.organ
        U, F = new.U, made.law.gradient(made.displacement(new))
        force, scale = made.law.forces(F)
        pull = made.map.Z.T @ made.map.slope(made.map.Z @ U).T @ new.f_y
        left = force[made.elasticity.free] - made.load - pull
        if made.inertia:
            V = (U - old.U) / DT
            left += made.M @ ((V - old.V) / DT + made.damping * V)
        assert np.abs(left).max() <= 2.0 * RESIDUAL * scale
    assert np.abs(tissue.principal_stretch(made.law, made.displacement(new))[0] - 1.0).max() > 0.2


@pytest.mark.parametrize("name", ["P1 quasi-static fibre", "P2 quasi-static normal"])
def test_newton_converges_quadratically(name: str) -> None:
    """Independent check: with every tangent fresh each of the last residuals above round-off, thread's, holes' and
    organ's over their scales, is within ten times the square of the one before; a kept factor converges linearly."""
    (system, _), old = scene(name, keep=0), steps(name)[-1].old
    made: Any = system.organ
    dt = 2.5 * DT
    problem = dynamic_problem(system, old, dt, organ_answer(system, BackwardEuler(dt), old))
    seen: list[float] = []
    answers: list[Any] = []

    def watched(problem: Problem, z: Iterate, r: Residual) -> tuple[Problem, Iterate]:
        answer: Any = problem.answer
        forces = Forces(r.f_y[:2].ravel(), np.zeros(made.size))
        point = answer.point
        if answers and answer is answers[-1]:  # it stood: the organ is where it takes it, not where it was linearised
            point, _ = made.go(answer.motion, point, answer.moved(forces.f_y, np.zeros(0)), forces)
        answers.append(answer)
        seen.append(max(size(problem, r), made.off_balance(point, forces) / point.scale))
        return correct(problem, z, r)

    solve(problem, predict(problem, old), watched)
    e = [x for x in seen if x > 1e-11][-3:]
    assert len(e) == 3 and e[2] < 1e-4, seen
    assert e[1] < SQUARED * e[0] ** 2 and e[2] < SQUARED * e[1] ** 2, seen


def test_going_ahead_of_an_old_tangent_saves_corrections(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: with a factor that is kept for good the same motion takes fewer corrections where each goes as
    far ahead as the two before say, than where it goes no further than by the tangent."""
    ahead = taken(*scene("P1 dynamic normal", keep=10**9), 0.25 * DT, 6)
    monkeypatch.setattr(FiniteAnswer, "after", lambda self, last: self)
    plain = taken(*scene("P1 dynamic normal", keep=10**9), 0.25 * DT, 6)
    assert close(ahead[-1].new.organ.U, plain[-1].new.organ.U) and close(ahead[-1].new.q, plain[-1].new.q)
    counts = [sum(step.solution.iterations for step in steps[1:]) for steps in (ahead, plain)]
    assert counts[0] < FEWER * counts[1]


def test_a_correction_takes_one_back_substitution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: of every residual of the organ once, also where the answer goes ahead of its tangent."""
    points: list[int] = []
    solves: list[int] = []
    point, solve = tissue.FiniteOrgan.point, finite.TangentSolver.solve

    def met(*given: Any) -> Any:
        points.append(1)
        return point(*given)

    def counted(factor: Any, b: Array, *given: Any, **options: Any) -> Array:
        solves.append(b.ndim)
        return solve(factor, b, *given, **options)

    monkeypatch.setattr(tissue.FiniteOrgan, "point", met)
    monkeypatch.setattr(finite.TangentSolver, "solve", counted)
    taken(*scene("P1 dynamic normal", keep=10**9), DT, STEPS)
    assert len(points) > 4 * STEPS and solves.count(1) <= len(points)


def test_a_kept_factor_gives_the_same_answer() -> None:
    """Consistency check: a run whose factors are kept while they serve, and one that makes each anew."""
    name = "P1 dynamic normal"
    anew = taken(*scene(name, keep=0), DT, STEPS)
    for kept, fresh in zip(steps(name), anew, strict=True):
        assert close(kept.new.organ.U, fresh.new.organ.U) and close(kept.new.lam, fresh.new.lam)
    made: Any = scene(name)[0].organ
    state = steps(name)[-1].new.organ
    assert state.linearised is not state.U
    one, other = (
        organ.answer(Equilibrium(), [state]) for organ in (made, steps(name)[-1].solution.problem.system.organ)
    )
    assert np.array_equal(one.C, other.C)  # by what the state remembers alone: a run that goes on is the same


@pytest.mark.parametrize("name", ["P1 quasi-static fibre", "P2 quasi-static normal"])
def test_columns_of_an_earlier_tangent_give_the_same_answer(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: tangents that use columns of an earlier one, and tangents that each have their own."""
    computed: list[int] = []
    compliance = finite.compliance

    def counted(*given: Any) -> Any:
        computed.append(1)
        return compliance(*given)

    monkeypatch.setattr(finite, "compliance", counted)
    lent = taken(*scene(name, keep=1), DT, STEPS)
    few = len(computed)
    monkeypatch.setattr(tissue.FiniteOrgan, "lent", lambda *given: None)
    own = taken(*scene(name, keep=1), DT, STEPS)
    assert any(step.new.organ.columns is not None for step in lent) and few < len(computed) - few
    for one, other in zip(lent, own, strict=True):
        assert close(one.new.organ.U, other.new.organ.U) and close(one.new.lam, other.new.lam)
    made: Any = scene(name)[0].organ
    state = next(step.new.organ for step in lent[::-1] if step.new.organ.columns is not None)
    again, before = (organ.answer(Equilibrium(), [state]) for organ in (made, lent[-1].solution.problem.system.organ))
    assert again.columns is not None
    assert np.array_equal(again.C, before.C)  # the state alone determines the columns: a resumed run is the same


@pytest.mark.parametrize(
    ("name", "axis"),
    # points of a half ball stand in a frame that is carried along by rotations across the normal, and by no other
    [("P1 dynamic normal", [1.0, 2.0, 3.0]), ("P1 quasi-static fibre", [1.0, 2.0, 0.0])],
)
def test_a_scene_turned_by_40_degrees_is_the_same(name: str, axis: list[float]) -> None:
    """Independent check (frame indifference): block, thread, loads and gravity turned, every number turns with them.
    (The fourth step of the fibre has two solutions, and round-off chooses.)"""
    R = rotation(40.0, np.array(axis))
    turned = taken(*scene(name, R), DT, 3)[-1].new
    here = steps(name)[2].new
    assert close(turned.q, here.q @ R.T, TURNED) and close(turned.s, here.s, TURNED)
    assert close(turned.lam[:, :3], here.lam[:, :3] @ R.T, TURNED)
    assert close(turned.organ.U.reshape(-1, 3), here.organ.U.reshape(-1, 3) @ R.T, TURNED)


@pytest.mark.parametrize("name", CASES)
def test_every_joule_is_accounted_for(name: str) -> None:
    """Independent check: what the hand and the weights do is stored, or taken by damping and the integrator, each by
    its own formula."""
    system, state = scene(name)
    energies = initial_energies(system, state)
    for step in steps(name):
        energies = audit_step(system, energies, step)
    assert abs(energies.balance_error) <= 1e-7 * energies.external_work
    assert energies.elastic_tissue > 0.1 * energies.external_work


def test_a_way_that_would_turn_a_cell_inside_out_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: an organ that may not take a part of the way cannot follow a force far beyond its strength."""
    monkeypatch.setattr(finite, "SHORTEST", 1.0)
    system, state = scene("P1 quasi-static fibre")
    made: Any = system.organ
    answer = made.answer(Equilibrium(), [state.organ])
    with pytest.raises(tissue.OrganError, match="a cell would be inverted"):
        answer.again(np.tile([1e3 * X, 0 * X, 0 * X], 2).ravel(), np.zeros(0))


def test_an_organ_without_an_answer_fails_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: its words are those of the step's error, which is then taken in halves."""
    system, state = scene("P1 quasi-static fibre")

    def lost(*_: Any) -> Any:
        raise tissue.OrganError("a cell would turn inside out")

    monkeypatch.setattr(tissue.FiniteOrgan, "go", lost)
    problem = dynamic_problem(system, state, DT, organ_answer(system, BackwardEuler(DT), state))
    with pytest.raises(StepError, match="a cell would turn inside out"):
        solve(problem, predict(problem, state))
