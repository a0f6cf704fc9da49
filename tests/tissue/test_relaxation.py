"""Tissue that relaxes: creep and relaxation against closed forms, the balance of energy, both organs as one."""

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import skfem
from scipy.integrate import quad

import tissue
from coupling.integrators import BDF2, BackwardEuler, Equilibrium
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.tissue.test_finite_organ import solved
from tissue.arrays import Array
from tissue.relaxation import Held, Prony

L, E, TRACTION = 0.01, 1e5, 10.0
G, TAU = 0.4, 2.0
SMALL = 5e-4  # of a displacement: strains are 1e-4, and an organ at finite strain is off by about that
STEPS = [0.05] * 40 + [0.1] * 20 + [0.2] * 10


def cube(nu: float) -> tissue.Elasticity:
    """A cube on rollers at three of its sides."""
    planes: dict[str, Any] = {f"{axis}0": lambda x, k=k: np.isclose(x[k], 0.0) for k, axis in enumerate("xyz")}
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, L, 3)] * 3)
    mesh = mesh.with_boundaries({**planes, "x1": lambda x: np.isclose(x[0], L)})
    return tissue.elasticity(mesh, tissue.Material(E, nu, 1000.0), "P1", roller=list(planes))


def organ_of(kind: str, body: tissue.Elasticity, relaxation: Prony, **more: Any) -> Any:
    sites = tissue.build_sites(body, [tissue.Site((0.5 * L, 0.5 * L, L), 3e-3, direction=None)])
    known = {"inertia": False, "relaxation": relaxation} | more
    if kind == "linear":
        return tissue.RelaxingOrgan(body, sites, **known)
    return tissue.FiniteOrgan(body, sites, **{"law": tissue.Hyperelasticity(body)} | known)


def creep(share: Array | float, t: float) -> Array:
    """The compliance over that of a sudden pull, of a spring of which a share relaxes with TAU."""
    left = 1.0 - np.asarray(share)
    return (1.0 - share * np.exp(-t * left / TAU)) / left


@pytest.mark.parametrize("nu", [0.3, 0.49])
@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_creep_under_a_traction(kind: str, nu: float) -> None:
    """Independent check: ε = σ (1/9κ + J(t)/3) with the creep compliance J of the relaxing shear modulus. The energy
    closes at every step."""
    body = cube(nu)
    organ = organ_of(kind, body, Prony([G], [TAU]), loads=(tissue.SurfaceLoad("x1", (TRACTION, 0.0, 0.0)),))
    end, shear, bulk = np.isclose(body.points[:, 0], L), E / 2 / (1 + nu), E / 3 / (1 - 2 * nu)
    state, t, none = organ.start(), 0.0, np.zeros(9)
    for dt in [0.0, *STEPS]:
        old, t = state, t + dt
        state = solved(organ, Equilibrium(dt), [state], none)
        strain = body.nodal(organ.displacement(state))[end, 0] / L
        assert strain == pytest.approx(TRACTION * (1 / (9 * bulk) + creep(G, t) / (3 * shear)), rel=SMALL)
        was, now = organ.energies(old, old), organ.energies(old, state)
        made = now.load_work - (now.elastic - was.elastic) - now.viscous - now.numerical
        moved = np.abs(organ.displacement(state) - organ.displacement(old)).sum()
        # no unknown is out of balance by more than RESIDUAL of the whole load
        assert abs(made) <= RESIDUAL * TRACTION * L**2 * moved


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_relaxed_tissue_is_as_soft_as_tissue_with_its_lasting_moduli(kind: str) -> None:
    """Independent check: after a long time a nearly incompressible organ is the one with the same κ and (1 − g) μ, on
    the same mesh, though its dilatation is averaged; the turn of a hole is most sensitive to cells that lock."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, L, 5)] * 3)
    mesh = mesh.with_boundaries({"z0": lambda x: np.isclose(x[2], 0.0)})
    nu, g, f = 0.499, 0.8, 1e-3 * np.eye(9)[0]
    mu, kappa = (1.0 - g) * E / 2 / (1 + nu), E / 3 / (1 - 2 * nu)
    soft = 9.0 * kappa * mu / (3.0 * kappa + mu)
    materials = tissue.Material(E, nu, 1e3, 1.0 - g), tissue.Material(soft, soft / (2.0 * mu) - 1.0, 1e3)
    bodies = [tissue.elasticity(mesh, material, "P1", ("z0",)) for material in materials]
    organs = organ_of(kind, bodies[0], Prony([g], [TAU])), organ_of(kind, bodies[1], Prony([0.0], [TAU]))
    relaxed, lasting = (
        organ.site_variables(solved(organ, Equilibrium(np.inf), [organ.start()], f)) - organ.y0 for organ in organs
    )
    assert np.abs(relaxed - lasting).max() <= TWO_SOLVERS * np.abs(lasting).max()


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_a_pull_at_a_hole_creeps_by_its_modes(kind: str) -> None:
    """Independent check: with K_d v = m K v each mode creeps as a spring of which m G relaxes, in any tissue."""
    body = cube(0.45)
    organ = organ_of(kind, body, Prony([G], [TAU]))
    plain = tissue.RelaxingOrgan(body, organ.sites, relaxation=Prony([1e-12], [TAU]))
    deviatoric = tissue.RelaxingOrgan(body, organ.sites, relaxation=Prony([0.5], [1.0])).branches[0] / 0.5
    m, v = scipy.linalg.eigh(deviatoric.toarray(), plain.K.toarray())
    pull = np.array([0.4, -0.2, 1.0, *np.zeros(6)]) * 1e-4
    by_mode = v.T @ (plain.Y.T @ pull)
    state, t = organ.start(), 0.0
    for dt in [0.0, *STEPS]:
        t += dt
        state = solved(organ, Equilibrium(dt), [state], pull)
        exact = plain.Y @ (v @ (creep(G * m, t) * by_mode))
        moved = organ.site_variables(state) - organ.y0
        assert np.abs(moved - exact)[:3].max() <= SMALL * np.abs(exact[:3]).max()


def test_stress_follows_the_hereditary_integral() -> None:
    """Independent check: Q = g ∫ e^(−(t−s)/τ) dS to round-off for a stress that rises, rests and falls evenly, in steps
    of any length; and nothing is left of it in the end."""
    series, corners = Prony([0.3, 0.2], [0.7, 40.0]), np.array([[0.0, 0.0], [1.3, 2.0], [2.0, 2.0], [2.9, -1.0]])
    rng = np.random.default_rng(3)
    times = np.sort(np.concatenate([rng.uniform(0.0, 2.9, 20), corners[:, 0]]))
    S = np.interp(times, *corners.T)
    Q = np.zeros((2, 1))
    for before, after, dt in zip(S, S[1:], np.diff(times), strict=False):
        Q = series.after(Q, np.array([after - before]), float(dt))
    slopes = np.diff(corners[:, 1]) / np.diff(corners[:, 0])
    for k, (g, tau) in enumerate(zip(series.shares, series.times, strict=True)):
        spans = zip(slopes, corners[:, 0], corners[1:, 0], strict=False)
        exact = sum(g * slope * quad(lambda s, tau=tau: np.exp(-(2.9 - s) / tau), a, b)[0] for slope, a, b in spans)
        assert Q[k, 0] == pytest.approx(exact, rel=1e-10)
    assert np.all(series.after(Q, np.zeros(1), np.inf) == 0.0)
    assert series.met(0.0) == 1.0 and series.met(np.inf) == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["linear", "finite"])
def test_the_work_of_the_stress_that_relaxes(kind: str) -> None:
    """Independent check: a pull that rests on tissue does f·Δy, of which ½ ΔUᵀK_∞ΔU is lost, by the balance of two
    equilibria. The work of the stress at the end of each step is of first order: half the step, half the error."""
    body, pull = cube(0.45), np.array([0.0, 0.0, 1e-4, *np.zeros(6)])
    organ = organ_of(kind, body, Prony([G], [TAU]))
    lasting = tissue.RelaxingOrgan(body, organ.sites, relaxation=Prony([G], [TAU]))
    K = lasting.K - lasting.branches[0]
    first = solved(organ, Equilibrium(0.0), [organ.start()], pull)
    last = solved(organ, Equilibrium(np.inf), [organ.start()], pull)
    dU = organ.field(last) - organ.field(first)
    lost, off = 0.5 * float(dU @ (K @ dU)), list[float]()
    for count in (40, 80):
        state, works = first, 0.0
        for dt in [10.0 * TAU / count] * count:
            old, state = state, solved(organ, Equilibrium(dt), [state], pull)
            works += organ.energies(old, state).viscous
        off.append(works / lost - 1.0)
    assert abs(off[1]) < 0.2 and 1.7 < off[0] / off[1] < 2.3


def test_both_organs_move_alike() -> None:
    """Consistency check: the linear organ and that at finite strain in motion, by BDF2, under a small pull that begins
    and ends; the energy closes at every step, and some is lost."""
    body, dt, swings = cube(0.45), 2e-4, list[list[float]]()
    for kind in ("linear", "finite"):
        organ, lost = organ_of(kind, body, Prony([G], [5e-3]), inertia=True), 0.0
        past, seen = [organ.start()], list[float]()
        for step in range(60):
            scheme = BDF2(dt, dt) if step else BackwardEuler(dt)
            pull = np.array([0.0, 0.0, 1e-4 if step < 20 else 0.0, *np.zeros(6)])
            old = past[0]
            past = [solved(organ, scheme, past[:2] if step else past, pull), old]
            was, now = organ.energies(old, old), organ.energies(old, past[0])
            given = pull @ (organ.site_variables(past[0]) - organ.site_variables(old))
            stored, lost = now.kinetic + now.elastic - was.kinetic - was.elastic, lost + now.viscous
            assert abs(given - stored - now.viscous - now.numerical) <= TWO_SOLVERS * (now.kinetic + now.elastic)
            seen.append(float((organ.site_variables(past[0]) - organ.y0)[2]))
        swings.append(seen)
        assert lost > now.kinetic + now.elastic
    assert np.allclose(*swings, rtol=0.0, atol=SMALL * np.abs(swings[0]).max())


def test_stress_at_the_nodes_relaxes() -> None:
    """Independent check: tissue between rollers under a pressure keeps its volume's stress; of the rest 1 − Σ g is left
    in the end: the stress of equilibrium under the same traction is the same at once and for good."""
    body = cube(0.3)
    organ = organ_of("linear", body, Prony([0.3, 0.2], [1.0, 9.0]), loads=(tissue.SurfaceLoad("x1", (10.0, 0, 0)),))
    recovery, state = tissue.stress_recovery(body), organ.start()
    for dt in (0.0, 0.5, 3.0, np.inf):
        state = solved(organ, Equilibrium(dt), [state], np.zeros(9))
        stress = recovery.stress(organ.displacement(state)) - organ.relaxed_stress(state)
        assert np.abs(stress - np.array([TRACTION, 0, 0, 0, 0, 0])).max() <= 1e-9 * TRACTION


def test_held_stress_and_its_derivatives() -> None:
    """Independent check: P and A by central differences of W, and no energy in the reference shape."""
    rng = np.random.default_rng(1)
    H = rng.standard_normal((3, 3, 2, 4))
    density, F = Held(H + H.swapaxes(0, 1)), np.eye(3)[:, :, None, None] + 0.2 * rng.standard_normal((3, 3, 2, 4))
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3, 1, 1))
        step[i, j] = 1e-5
        slope = (density.energy(F + step) - density.energy(F - step)) / 2e-5
        bend = (density.stress(F + step) - density.stress(F - step)) / 2e-5
        assert np.abs(density.stress(F)[i, j] - slope).max() < 1e-8
        assert np.abs(density.tangent(F)[:, :, i, j] - bend).max() < 1e-8
    assert np.abs(density.energy(np.broadcast_to(np.eye(3)[:, :, None, None], F.shape))).max() == 0.0


@pytest.mark.parametrize(
    ("shares", "times", "words"),
    [
        ([0.5, 0.5], [1.0, 2.0], "sum below 1"),
        ([-0.1], [1.0], "shares of 0"),
        ([0.1], [0.0], "positive"),
        ([], [], "one"),
    ],
)
def test_series_that_are_refused(shares: list[float], times: list[float], words: str) -> None:
    """Independent check: what would leave nothing, or go nowhere, is refused with what is allowed."""
    with pytest.raises(tissue.TissueError, match=words):
        Prony(shares, times)


def test_an_organ_that_nothing_holds_is_refused() -> None:
    """Independent check: without inertia it would be singular."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, L, 3)] * 3)
    body = tissue.elasticity(mesh, tissue.Material(E, 0.3, 1000.0), "P1")
    with pytest.raises(tissue.TissueError, match="rigid body"):
        organ_of("linear", body, Prony([G], [TAU]))
