"""The nine-number interface: compliance, steps, energies and the three organs."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshTet

import tissue
from coupling.integrators import BDF2, BackwardEuler, Equilibrium
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tissue.organs.dynamic import KEPT_OPERATORS
from tissue.organs.meshed import OrganEnergies

Array = NDArray[np.float64]
DT = 1.0e-3
NONE = np.zeros(0)
PIERCINGS = [
    tissue.Site([-0.01, 0.0, 0.0], 3e-3, "parabolic", "normal"),
    tissue.Site([0.01, 0.0, 0.0], 2e-3, "uniform", [1.0, 0.0, 0.5]),
    tissue.Site([0.0, 0.003, -0.009], 2e-3),
]


def body_of(element: str = "P1", clamp: tuple[str, ...] = ("bottom",)) -> tissue.Elasticity:
    lines = [np.linspace(a, b, n) for a, b, n in ((-0.03, 0.03, 8), (-0.02, 0.02, 6), (-0.02, 0.0, 5))]
    mesh = MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: x[2] < -0.02 + 1e-9})
    return tissue.elasticity(mesh, tissue.Material(1.0e4, 0.45, 1070.0), element, clamp)


def dynamic(body: tissue.Elasticity, gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tissue.DynamicOrgan:
    return tissue.DynamicOrgan(body, tissue.build_sites(body, PIERCINGS), gravity, rayleigh=(2.0, 1e-3))


def quasi_static(body: tissue.Elasticity) -> tissue.QuasiStaticOrgan:
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, PIERCINGS), (0.5, 0.0, -9.81))


def euler(organ: tissue.DynamicOrgan, state: tissue.OrganState, f_y: Array, dt: float = DT) -> tissue.OrganState:
    return organ.answer(BackwardEuler(dt), [state]).accept(f_y)


def site_forces(seed: int) -> Array:
    """Forces of 10 mN and couples of 10 mN mm, shape `(27,)`."""
    forces = np.random.default_rng(seed).standard_normal((3, 3, 3)) * 1e-2
    forces[:, 1:] *= 1e-3
    return forces.ravel()


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_compliance_is_the_dense_one_and_positive_definite(element: str) -> None:
    """Consistency check: C = Y A⁻¹ Yᵀ by dense algebra; W its field."""
    body = body_of(element)
    for organ in (dynamic(body), quasi_static(body)):
        operator = organ.operator(1.0 / DT**2, 1.0 / DT)
        Y, A = organ.Y.toarray(), operator.A.toarray()
        dense = Y @ np.linalg.solve(A, Y.T)
        assert operator.W.shape == (organ.size, 27)
        assert np.abs(operator.C - dense).max() <= 1e-8 * np.abs(dense).max()
        assert np.array_equal(operator.C, operator.C.T)
        scale = 1.0 / np.sqrt(np.diag(operator.C))
        assert np.linalg.eigvalsh(operator.C * np.outer(scale, scale))[0] > 1e-6


@pytest.mark.parametrize("rayleigh", [(0.0, 0.0), (2.0, 1e-3)])
def test_the_products_that_steps_leave_are_those_of_the_matrices(rayleigh: tuple[float, float]) -> None:
    """Consistency check: M U, M V and K U after 60 steps, and after a jump in velocity, which steps do not know of."""
    body = body_of()
    organ = tissue.DynamicOrgan(body, tissue.build_sites(body, PIERCINGS), (0.0, 0.0, -9.81), rayleigh=rayleigh)
    state, before = organ.start(), organ.start()
    for step in range(60):
        past = [state, before] if step else [state]
        scheme = BDF2(DT, DT) if step else BackwardEuler(DT)
        before, state = state, organ.answer(scheme, past).accept(site_forces(0) * np.cos(0.7 * step))
    assert state.KU is not None
    struck = organ.impulse(state).accept(1e-3 * site_forces(1))
    for here in (state, struck):
        made, exact = organ.products(here), (organ.M @ here.U, organ.M @ here.V, organ.K @ here.U)
        for one, other in zip(made, exact, strict=True):
            assert np.linalg.norm(one - other) <= IDENTITY * np.linalg.norm(other)


def test_a_force_that_drifts_is_noticed() -> None:
    """Consistency check: an error of 10⁻¹² of ‖K‖‖U‖ in K U is seen, and round-off passes."""
    organ = dynamic(body_of())
    U = euler(organ, organ.start(), site_forces(1)).U
    error = np.random.default_rng(1).standard_normal(organ.size)
    error *= 1e-12 * float(abs(organ.K).sum(axis=1).max()) * np.linalg.norm(U) / np.linalg.norm(error)
    assert organ.is_elastic_force(U, organ.K @ U)
    assert not organ.is_elastic_force(U, organ.K @ U + error)


def test_step_solves_the_full_equation() -> None:
    """Consistency check: A U⁺ = b + Yᵀ f_y, and y = y_free + C f_y is the y of the new state."""
    organ = dynamic(body_of(), (0.0, 0.0, -9.81))
    state = euler(organ, euler(organ, organ.start(), site_forces(1)), site_forces(2))
    answer = organ.answer(BackwardEuler(DT), [state])
    new, equation = answer.accept(site_forces(3)), answer.equation
    assert answer.again(site_forces(3), np.zeros(0)) is answer  # a linear organ answers with itself
    right = equation.b + organ.Y.T @ site_forces(3)
    assert np.linalg.norm(equation.A @ new.U - right) <= 1e-10 * np.linalg.norm(right)
    K, M = organ.K, organ.M
    forces = M @ new.A + 2.0 * (M @ new.V) + 1e-3 * (K @ new.V) + K @ new.U - organ.load - organ.Y.T @ site_forces(3)
    assert np.linalg.norm(forces) <= 1e-10 * np.linalg.norm(K @ new.U)
    y = organ.site_variables(new)
    assert np.abs(y - (answer.y_free + answer.C @ site_forces(3))).max() <= 1e-12
    assert np.abs(new.V * DT - new.U + state.U).max() <= 1e-12 * np.abs(new.U).max()
    assert np.abs(new.A * DT - new.V + state.V).max() <= 1e-9 * np.abs(new.V).max()


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_energy_balance_closes_at_every_step(element: str) -> None:
    """f_y·Δy + gravity = Δ(kinetic + elastic) + viscous + numerical, to round-off, under an oscillating load."""
    organ = dynamic(body_of(element), (0.0, 0.3, -9.81))
    state, scale = organ.start(), 0.0
    before = organ.energies(state, state)
    assert before == OrganEnergies(0.0, 0.0, 0.0, 0.0, 0.0)
    for step in range(20):
        f_y = site_forces(0) * np.cos(0.7 * step)
        new = euler(organ, state, f_y)
        after = organ.energies(state, new)
        given = f_y @ (organ.site_variables(new) - organ.site_variables(state)) + after.load_work
        stored = after.kinetic + after.elastic - before.kinetic - before.elastic
        assert min(after.viscous, after.numerical) > 0.0
        scale = max(scale, after.kinetic + after.elastic)
        assert abs(given - stored - after.viscous - after.numerical) <= 1e-12 * scale
        state, before = new, after


def test_quasi_static_energies_are_those_of_the_full_field() -> None:
    """Consistency check: 9p numbers against ½UᵀKU and fᵀΔU over the mesh; the balance closes."""
    body = body_of("P2")
    organ = quasi_static(body)
    answer = organ.answer(Equilibrium(), [organ.start()])
    old, new = (answer.accept(site_forces(k)) for k in (1, 2))
    audit, first = organ.energies(old, new), organ.energies(old, old)
    U, U_old = organ.displacement(new), organ.displacement(old)
    f = body.body_force(np.array([0.5, 0.0, -9.81]))
    elastic = 0.5 * U @ (body.K @ U)
    assert audit.elastic == pytest.approx(elastic, rel=1e-10)
    assert audit.load_work == pytest.approx(f @ (U - U_old), rel=1e-10)
    assert audit.numerical == pytest.approx(0.5 * (U - U_old) @ (body.K @ (U - U_old)), rel=1e-10)
    given = site_forces(2) @ (organ.site_variables(new) - organ.site_variables(old)) + audit.load_work
    assert abs(given - (audit.elastic - first.elastic) - audit.numerical) <= 1e-12 * elastic
    assert organ.site_variables(new) == pytest.approx(organ.y0 + organ.Y @ U[body.free], rel=1e-10, abs=1e-13)
    assert audit.kinetic == audit.viscous == 0.0


def test_reaction_of_the_clamp_balances_the_sites() -> None:
    """Action and reaction: the clamped boundary holds exactly the site forces and the weight."""
    body = body_of("P2")
    organ = quasi_static(body)
    state = organ.answer(Equilibrium(), [organ.start()]).accept(site_forces(4))
    reaction = body.nodal(body.K @ organ.displacement(state) - body.body_force(np.array([0.5, 0.0, -9.81])))
    held = np.isin(body.nodes[:, 0], body.clamped)
    forces = site_forces(4).reshape(3, 3, 3)
    weight = 1070.0 * 0.06 * 0.04 * 0.02 * np.array([0.5, 0.0, -9.81])
    assert np.abs(reaction[held].sum(axis=0) + forces[:, 0].sum(axis=0) + weight).max() <= 1e-10 * np.abs(weight).max()
    # Their moment on the nodes is the one taken on the site variables.
    y0 = organ.y0.reshape(3, 3, 3)
    loads = body.nodal(body.extended(organ.Y.T @ site_forces(4)))
    moment = np.cross(body.points, loads).sum(axis=0)
    assert (
        np.abs(moment - np.cross(y0, forces).sum(axis=(0, 1))).max()
        <= 1e-12 * np.abs(forces[:, 0]).max() * 0.06 + 1e-14
    )


def test_floating_organ_keeps_its_momentum() -> None:
    """A dynamic organ may float: without load its momentum is the impulse of the site forces, step by step."""
    body = body_of("P1", ())
    organ = tissue.DynamicOrgan(body, tissue.build_sites(body, PIERCINGS))
    state, impulse = organ.start(), np.zeros(3)
    for step in range(5):
        state = euler(organ, state, site_forces(step))
        impulse += DT * site_forces(step).reshape(3, 3, 3)[:, 0].sum(axis=0)
        momentum = body.nodal(body.M @ organ.whole(state.V)).sum(axis=0)
        assert np.abs(momentum - impulse).max() <= 1e-10 * DT * 1e-2


def test_dynamic_organ_comes_to_rest_in_the_quasi_static_sag() -> None:
    """Consistency check of two organs: long damped steps under gravity and constant site forces."""
    body = body_of("P1")
    still, moving = quasi_static(body), tissue.DynamicOrgan(body, quasi_static(body).sites, (0.5, 0.0, -9.81))
    rest = still.answer(Equilibrium(), [still.start()]).accept(site_forces(6))
    state = moving.start()
    for _ in range(8):
        state = euler(moving, state, site_forces(6), dt=10.0)
    exact = still.displacement(rest)
    assert np.abs(moving.displacement(state) - exact).max() <= 1e-8 * np.abs(exact).max()
    assert still.start().f_y @ still.start().f_y == 0.0


def test_operators_are_kept_for_the_time_steps_used_last() -> None:
    organ = dynamic(body_of())
    first = organ.operator(1.0, 1.0)
    assert organ.operator(1.0, 1.0) is first
    for a in range(2, 2 + KEPT_OPERATORS):
        organ.operator(float(a), 1.0)
    again = organ.operator(1.0, 1.0)
    assert again is not first
    assert np.array_equal(again.C, first.C)


def test_history_combines_earlier_states() -> None:
    """Second-order backward differences take two states: any U_a = Σ (α U + β V), U_d = Σ γ U."""
    organ = dynamic(body_of())
    one = euler(organ, organ.start(), site_forces(1))
    two = euler(organ, one, site_forces(2))
    scheme = SimpleNamespace(a=1.0, d=1.0, coefficients=((2.0, 0.5, 4.0), (-1.0, 0.25, -1.0)))
    history = organ.history(scheme, [two, one])
    assert history.inertia == pytest.approx(2.0 * two.U + 0.5 * two.V - one.U + 0.25 * one.V, rel=1e-14, abs=1e-18)
    assert history.damping == pytest.approx(4.0 * two.U - one.U, rel=1e-14, abs=1e-18)


def test_steps_do_not_change_the_states_they_start_from() -> None:
    organ = dynamic(body_of())
    state = euler(organ, organ.start(), site_forces(1))
    copies = [a.copy() for a in (state.U, state.V, state.A, state.f_y)]
    euler(organ, state, site_forces(2))
    assert all(np.array_equal(a, b) for a, b in zip(copies, (state.U, state.V, state.A, state.f_y), strict=True))


def test_sites_without_an_organ_stay_where_they_are() -> None:
    fixed = tissue.fixed_sites([tissue.Site([1.0, 2.0, 3.0]), tissue.Site([0.0, 0.0, 0.0], direction=[0.0, 2.0, 0.0])])
    answer = fixed.answer(BackwardEuler(1.0), [fixed.start()])
    state, equation = answer.accept(np.ones(18)), answer.equation
    frames = fixed.site_variables(state).reshape(2, 3, 3)
    assert np.array_equal(frames[0], [[1, 2, 3], [1, 0, 0], [0, 1, 0]])
    assert np.cross(frames[1, 1], frames[1, 2]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    assert fixed.size == equation.A.shape[0] == equation.b.size == 0
    assert not answer.C.any()
    assert fixed.energies(state, state) == OrganEnergies(0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(tissue.TissueError, match="without an organ"):
        tissue.fixed_sites([tissue.Site([0.0, 0.0, 0.0], direction="normal")])


def test_impossible_organs_are_refused() -> None:
    floating, held = body_of("P1", ()), body_of("P1")
    sites = tissue.build_sites(held, PIERCINGS)
    loose = tissue.build_sites(floating, PIERCINGS)
    for kind in (tissue.QuasiStaticOrgan, tissue.FloatingOrgan):
        with pytest.raises(tissue.TissueError, match=r"can still move along x, y, z and .*; clamp a boundary.*bottom"):
            kind(floating, loose)
    with pytest.raises(tissue.TissueError, match="rayleigh"):
        tissue.DynamicOrgan(held, sites, rayleigh=(-1.0, 0.0))
    with pytest.raises(tissue.TissueError, match="gravity"):
        tissue.DynamicOrgan(held, sites, gravity=(0.0, np.nan, 0.0))
    with pytest.raises(tissue.TissueError, match="build them on it"):
        tissue.DynamicOrgan(floating, sites)
    with pytest.raises(tissue.TissueError, match="positive time step"):
        tissue.DynamicOrgan(held, sites).operator(0.0, 1.0)


def test_an_organ_that_may_float_and_is_held_is_the_one_at_rest() -> None:
    """Consistency check: step by step it comes to the equilibrium of the quasi-static organ under weight and site
    forces, with its energy; what the drag leaves falls in each."""
    body, f_y = body_of(), site_forces(3)
    held = quasi_static(body)
    organ = tissue.FloatingOrgan(body, held.sites, (0.5, 0.0, -9.81))
    rest = held.answer(Equilibrium(), [held.start()]).accept(f_y, NONE)
    past = [organ.start()]
    for _ in range(7):
        past.insert(0, organ.answer(Equilibrium(), [past[0], past[-1]][: len(past)]).accept(f_y, NONE))
    dragged = [organ.dragged(state) for state in past[:-1]]
    assert dragged[0] <= RESIDUAL and all(after < 0.5 * before for after, before in pairwise(dragged[2:]))
    way = held.site_variables(rest) - held.y0
    assert np.abs(organ.site_variables(past[0]) - held.y0 - way).max() <= TWO_SOLVERS * np.abs(way).max()
    energies = [each.energies(each.start(), state).elastic for each, state in ((organ, past[0]), (held, rest))]
    assert energies[0] == pytest.approx(energies[1], rel=TWO_SOLVERS)
