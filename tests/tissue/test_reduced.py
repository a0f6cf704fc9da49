"""An organ in a small basis: what it keeps exactly, and the bound of what it leaves open."""

from collections.abc import Callable

import numpy as np
import pytest

import tissue
from coupling.integrators import BDF2, BackwardEuler, Equilibrium, Scheme
from meshes.block import block
from meshes.wound import Wound
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.tissue.pulled import DT, PULL, SITES, SOFT, organ_of, schemes
from tests.tissue.wounds import cut_block, gaps_on
from tissue.arrays import Array

BOTH = pytest.mark.parametrize("scheme", [BackwardEuler, BDF2])


def reduced(organ: tissue.DynamicOrgan, blocks: int = 2, modes: int = 0) -> tissue.ReducedOrgan:
    return tissue.ReducedOrgan(organ, tissue.reduce_organ(organ, blocks, modes))


def states(
    organ: tissue.DynamicOrgan | tissue.ReducedOrgan, kind: type[Scheme], steps: int, force: Callable[[float], Array]
) -> list[tissue.OrganState]:
    """The start, and the states after so many steps under the forces at their times."""
    out: list[tissue.OrganState] = [organ.start()]
    for n, scheme in enumerate(schemes(kind, steps)):
        answer = organ.answer(scheme, out[::-1][: len(scheme.coefficients)], (n + 1) * DT)
        out.append(answer.accept(force((n + 1) * DT)))
    return out


def apart(full: tissue.DynamicOrgan, small: tissue.ReducedOrgan, *pair: tissue.OrganState) -> Array:
    """Distances between the points of the sites, `(p,)` [m]."""
    y = full.site_variables(pair[0]) - small.site_variables(pair[1])
    return np.asarray(np.linalg.norm(y.reshape(-1, 9)[:, :3], axis=1))


@BOTH
@pytest.mark.parametrize(("ramp", "kept"), [(2.0e-3, 0.1), (2.0e-2, 0.01)])
def test_the_bound_holds_where_nothing_is_damped(scheme: type[Scheme], ramp: float, kept: float) -> None:
    """Independent check: the whole organ, of 40 kPa, pulled within a few of its slowest periods. At every step its
    sites are within the bound; the difference is the error within a half; and the basis keeps the motion."""
    full = organ_of()
    small = reduced(full)
    pairs = list(
        zip(*(states(organ, scheme, 150, lambda t: PULL * min(t / ramp, 1.0)) for organ in (full, small)), strict=True)
    )
    error = np.array([apart(full, small, *pair) for pair in pairs])
    bound = np.array([small.bound(state) for _, state in pairs])
    difference = np.array([small.difference(state) for _, state in pairs])
    way = np.abs(full.site_variables(pairs[-1][0]) - full.y0).max()
    assert np.all(error <= bound + IDENTITY * way)
    assert error.max() <= kept * way
    assert 0.67 <= difference.max() / error.max() <= 1.5


def test_more_blocks_leave_less_open() -> None:
    """Independent check: error and bound fall with each block, and modes help as well."""
    full = organ_of()
    whole = states(full, BDF2, 80, lambda t: PULL * min(t / 4e-3, 1.0))
    errors, bounds = [], []
    for blocks, modes in ((0, 0), (1, 0), (3, 0), (0, 40)):
        small = reduced(full, blocks, modes)
        own = states(small, BDF2, 80, lambda t: PULL * min(t / 4e-3, 1.0))
        errors.append(max(apart(full, small, *pair).max() for pair in zip(whole, own, strict=True)))
        bounds.append(small.bound(own[-1]).max())
    for falling in (errors, bounds):
        assert falling[2] < falling[1] < falling[0] and falling[3] < falling[0]


def test_what_is_static_is_exact() -> None:
    """Consistency check: the compliance of the sites, and what gravity and loads do, by the whole organ."""
    load = tissue.SurfaceLoad("right", (0.0, 0.0, -300.0))
    moving = organ_of(gravity=(0.0, 0.0, -9.81), loads=(load,))
    full = tissue.QuasiStaticOrgan(moving.elasticity, moving.sites, moving.gravity, loads=moving.loads)
    small = reduced(moving, blocks=0)
    one, other = (organ.answer(Equilibrium(), [organ.start()]) for organ in (full, small))
    still = one.y_free - full.y0
    assert np.abs(still).max() > 0.0
    assert np.abs(one.y_free - other.y_free).max() <= TWO_SOLVERS * np.abs(still).max()
    assert np.abs(one.C - other.C).max() <= TWO_SOLVERS * np.abs(one.C).max()
    U, eta = one.accept(PULL), other.accept(PULL)
    field = full.displacement(U)
    assert np.abs(field - small.displacement(eta)).max() <= TWO_SOLVERS * np.abs(field).max()
    assert np.allclose(small.bound(eta), 0.0, atol=TWO_SOLVERS * np.abs(still).max())


def test_a_basis_of_all_is_the_whole_organ() -> None:
    """Consistency check: a basis as large as the organ gives its motion, and a bound of round-off."""
    full = organ_of(9.0e-3, rayleigh=(5.0, 1e-3))
    small = reduced(full, blocks=12)
    assert small.reduction.size == full.size
    pairs = zip(*(states(organ, BDF2, 40, lambda t: PULL * np.sin(900.0 * t)) for organ in (full, small)), strict=True)
    way = np.abs(PULL).max() * np.abs(full.operator(0.5, 0.0).C).max()
    for U, eta in list(pairs)[1:]:
        assert apart(full, small, U, eta).max() <= TWO_SOLVERS * way
        assert small.bound(eta).max() <= TWO_SOLVERS * way
        assert np.abs(U.V - small.spread(eta, eta.V)).max() <= 1e4 * TWO_SOLVERS * way


@BOTH
def test_the_audit_is_exact(scheme: type[Scheme]) -> None:
    """Independent check: work of the site forces, gravity and loads = change of kinetic and elastic energy + viscous +
    numerical, at every step."""
    load = tissue.SurfaceLoad("right", (50.0, 0.0, -300.0), course=((0.0, 0.0), (4.0e-3, 1.0)))
    small = reduced(organ_of(gravity=(0.0, 0.0, -9.81), rayleigh=(5.0, 1e-3), loads=(load,)))
    old, *rest = states(small, scheme, 60, lambda t: PULL * np.sin(500.0 * t))
    scale, before = 0.0, small.energies(old, old)
    for new in rest:
        after = small.energies(old, new)
        work = after.load_work + new.f_y @ (small.site_variables(new) - small.site_variables(old))
        taken = after.kinetic + after.elastic - before.kinetic - before.elastic + after.viscous + after.numerical
        scale = max(scale, after.elastic + after.kinetic)
        assert abs(work - taken) <= RESIDUAL * scale
        old, before = new, after
    assert after.viscous > 0.0


def test_the_bound_holds_after_an_impulse_and_a_displacement() -> None:
    """Independent check: holes that begin strike the tissue and draw it to them between two steps; momentum is of the
    basis, whose holes are heavier than those of the mesh."""
    full = organ_of()
    small = reduced(full)
    heavy, light = (organ.impulse(organ.start()).C for organ in (small, full))
    assert np.linalg.eigvalsh(light - heavy).min() >= -TWO_SOLVERS * np.abs(light).max()
    ends = []
    for organ in (full, small):
        at = organ.impulse(organ.start()).accept(1e-5 * PULL)
        at = organ.displace(BackwardEuler(DT), at, organ.site_variables(at), 0.0 * PULL).accept(0.1 * PULL)
        own = [at]
        for _ in range(60):
            own.append(organ.answer(BackwardEuler(DT), own[-1:]).accept(0.1 * PULL))
        ends.append(own)
    for U, eta in zip(*ends, strict=True):
        assert np.all(apart(full, small, U, eta) <= small.bound(eta))


@BOTH
@pytest.mark.parametrize("damping", [0.0, 1e-2, 0.5, 3.0])
def test_a_body_let_go_swings_to_no_more_than_where_it_was(scheme: type[Scheme], damping: float) -> None:
    """Independent check: on this the bound stands, for any frequency, from the slowest to the stiffest, and either
    scheme, also where its first step is one of backward Euler."""
    w = np.logspace(-3, 4, 400)
    x, v = np.ones((2, w.size)), np.zeros((2, w.size))  # now and before, at rest
    for step in schemes(scheme, 300):
        n = len(step.weights)
        d = step.d * DT
        x_d, v_d = (np.tensordot(step.weights, past[:n], 1) for past in (x, v))
        new = (d * (d * x_d + v_d) + 2.0 * damping * w * d * x_d) / (d * d + 2.0 * damping * w * d + w * w)
        x, v = np.stack([new, x[0]]), np.stack([d * (new - x_d), v[0]])
        assert np.abs(new).max() <= 1.0 + IDENTITY


def test_organs_of_which_no_basis_is_made_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: lips that may touch, nothing that holds the organ, numbers that cannot be, and a want of
    memory."""
    body = tissue.elasticity(block((0.03, 0.02, 0.015), 5e-3), SOFT)
    floating = tissue.DynamicOrgan(body, tissue.build_sites(body, SITES))
    with pytest.raises(tissue.TissueError, match="not held"):
        tissue.reduce_organ(floating, 2)
    with pytest.raises(tissue.TissueError, match="blocks = -1"):
        tissue.reduce_organ(organ_of(9e-3), -1)
    monkeypatch.setattr("tissue.organs.reduced.free_memory", lambda: 1e5)
    with pytest.raises(tissue.TissueError, match="GB are available; take fewer blocks"):
        tissue.reduce_organ(organ_of(9e-3), 2)
    wound = Wound(0.01, 0.005)
    cut = tissue.elasticity(cut_block(wound), SOFT, "P1", ("bottom",))
    touching = tissue.DynamicOrgan(cut, tissue.build_sites(cut, []), gaps=gaps_on(cut, wound))
    with pytest.raises(tissue.TissueError, match="can touch"):
        tissue.reduce_organ(touching, 2)
