"""Coulomb friction of surfaces that press on one another: the law and its tangent, a slope, patches, what is taken."""

from types import SimpleNamespace

import numpy as np
import pytest

import tissue
from coupling.joins import rubbing
from coupling.joins.contact import Contact, is_lawful
from coupling.joins.rubbing import Law, active_sets, find_forces, law_of_pairs, projected, rows_of, stuck
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.tissue.rubbed import at_rest_on, bear_uniform_strain, motion, on_slope, rough_cubes
from tests.tissue.test_lips import SQUEEZE
from tests.tissue.test_surfaces import SIDE
from tests.tissue.wounds import SOFT, Array
from tissue.errors import OrganError

MU, NEAR = 0.3, 1e-3
SHEAR = np.diag([0.3 * SQUEEZE, 0.3 * SQUEEZE, -SQUEEZE]) + 0.5 * SQUEEZE * np.outer([1.0, 0, 0], [0, 0, 1.0])
TRACTION = 0.5 * SQUEEZE * SOFT.lame_mu / (SOFT.youngs_modulus * SQUEEZE)  # along the surface over that across it

# Six points of a thread that is drawn round a cylinder: their compliance, the upper triangle row by row, and their gaps
# and slips without forces, in hundredths.
CHAIN = """
774 577 448 263 209 163 42 -18 1 -122 -9 -142 -14 -146 -9 -140 -5 -132 738 713 534 382 257 -9 97 -20 9 -29
-60 -21 -147 -3 -150 10 -141 891 801 536 321 -10 123 -31 60 -45 -25 -27 -176 6 -187 29 -174 895 715 554 -7
160 -20 154 -24 107 -7 -43 14 -93 27 -122 736 723 -4 171 1 176 13 162 19 75 12 17 6 -41 827 -3 171 16 178 38
185 35 155 10 105 -11 37 898 15 663 3 486 10 251 11 193 4 143 -2 1292 10 1105 19 1016 22 827 15 726 10 639
816 20 742 21 542 18 414 11 301 3 1240 25 1254 22 1105 14 940 9 797 869 31 803 34 607 23 435 10 1402 28 1339
14 1119 5 927 941 28 811 18 682 7 1447 6 1297 -8 1151 819 0 794 -4 1277 -11 1234 857 -9 1281
"""
CHAIN_OPEN = "-937 -1000 -960 -738 -579 -427 -1 -957 -1 -834 -1 -778 -1 -696 -1 -671 -1 -654"


def random_law(pairs: int, mu: float, seed: int) -> tuple[Law, Array]:
    """The law of pairs of any compliance, and where they would be without forces."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3 * pairs, 3 * pairs + 3))
    C = A @ A.T / (3 * pairs) + 2.0 * np.eye(3 * pairs)
    friction = np.where(np.arange(pairs) % 4 == 3, 0.0, mu)  # some of the pairs are smooth
    kept = np.concatenate([np.arange(pairs), pairs + np.arange(2 * np.count_nonzero(friction))])
    law = law_of_pairs(C[np.ix_(kept, kept)], friction)
    return law, rng.normal(size=len(kept)) - 1.0 * (kept < pairs)


@pytest.mark.parametrize("mu", [0.3, 0.6, 1.0])
def test_forces_obey_coulombs_law(mu: float) -> None:
    """Independent check: the law in its own words, pair by pair, whatever the active set it is sought from."""
    kinds: set[tuple[bool, bool]] = set()
    for seed in range(6):
        law, c_open = random_law(20, mu, seed)
        rng = np.random.default_rng(seed)
        m, found = len(law.rough), []
        for first in (np.zeros(20, bool), rng.random(20) < 0.5):
            P = find_forces(law, c_open, first, stuck(m))[2]
            found.append(P)
        assert np.abs(found[0] - found[1]).max() <= TWO_SOLVERS * np.abs(P).max()
        c, scale = c_open + law.C @ P, np.abs(P).max()
        p, g = P[:20], c[:20]
        tau, w = P[20:].reshape(m, 2), c[20:].reshape(m, 2)
        assert p.min() >= 0.0 and g.min() >= -RESIDUAL and np.abs(p * g).max() <= RESIDUAL * scale
        bound, size, way = mu * p[law.rough], np.linalg.norm(tau, axis=1), np.linalg.norm(w, axis=1)
        slips = way > 1e-6
        kinds |= set(zip(slips.tolist(), (bound > 0.0).tolist(), strict=True))
        assert (size <= bound + RESIDUAL * scale).all()
        assert np.abs(tau[slips] + bound[slips, None] * w[slips] / way[slips, None]).max() <= RESIDUAL * scale
    assert kinds == {(True, False), (True, True), (False, True)}


def test_the_tangent_of_the_law_is_its_slope() -> None:
    """Consistency check: central differences of the law by forces, gaps and slips, whose error falls a hundredfold."""
    law, c_open = random_law(8, 0.4, 5)
    rng = np.random.default_rng(7)
    P, c = rng.normal(size=(2, len(c_open)))
    P[:8] = np.abs(P[:8])
    pressed, rubbing = active_sets(law, P, c)
    assert rubbing.slips[pressed[law.rough]].any()
    (L_c, L_P), (dP, dc) = rows_of(law, pressed, rubbing), rng.normal(size=(2, len(P)))
    slope, errors = L_c @ dc + L_P @ dP, []
    for step in (1e-3, 1e-4):
        after, before = (P + s * dP - projected(law, P + s * dP, c + s * dc) for s in (step, -step))
        errors.append(np.abs((after - before) / (2.0 * step) - slope).max())
    assert errors[1] <= 0.02 * errors[0]


def test_from_pair_to_pair_is_the_same() -> None:
    """Independent check: each pair in turn obeys the law under constant forces of the others (Jourdan, Alart & Jean,
    Computer Methods in Applied Mechanics and Engineering 155, 1998), until nothing changes."""
    law, c_open = random_law(6, 0.3, 1)
    P = find_forces(law, c_open, np.zeros(6, bool), stuck(len(law.rough)))[2]
    other = np.zeros_like(P)
    for _ in range(3000):
        for pair in range(law.k):
            other[pair] = max(0.0, other[pair] - law.r_gap[pair] * (c_open + law.C @ other)[pair])
        for slip, pair in enumerate(law.rough):
            own = law.k + 2 * slip + np.arange(2)
            b = other[own] - law.r_slip[slip] * (c_open + law.C @ other)[own]
            other[own] = b * min(1.0, law.mu[slip] * other[pair] / np.linalg.norm(b))
    assert np.abs(other - P).max() <= 1e-6 * np.abs(P).max()


def test_points_in_a_row_are_solved_by_shortened_corrections(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: the forces obey the law. Whole corrections by its tangent do not arrive, because they return
    to the same active sets."""
    C = np.zeros((18, 18))
    C[np.triu_indices(18)] = np.array(CHAIN.split(), dtype=float) / 100.0
    C, c_open = np.triu(C) + np.triu(C, 1).T, np.array(CHAIN_OPEN.split(), dtype=float) / 100.0
    law, every = law_of_pairs(C, np.full(6, 0.2)), (np.ones(6, dtype=bool), stuck(6))
    P = find_forces(law, c_open, *every)[2]
    assert np.abs(P - projected(law, P, c_open + law.C @ P)).max() <= RESIDUAL * np.abs(P).max()
    monkeypatch.setattr(rubbing, "SHORTEST", 1.0)
    with pytest.raises(OrganError, match="obey Coulomb's law"):
        find_forces(law, c_open, *every)


@pytest.mark.parametrize("kind", [tissue.DynamicOrgan, tissue.FiniteOrgan])
def test_a_block_on_a_slope_sticks_and_slips(kind: type) -> None:
    """Independent check: under a thousandth less than μ it comes to rest, with the friction that the slope asks for;
    under a thousandth more it goes on with g (sin − μ cos), and friction takes μ N for every metre."""
    dt = 0.02
    for share in (1.0 - NEAR, 1.0 + NEAR):
        organ, acceleration = on_slope(MU, share * MU, kind=kind)
        states = motion(organ, dt, 14)
        lips, before = organ.lips(states[-1]), organ.lips(states[-2])
        N, T = lips.force.sum(), lips.friction.sum(axis=0)
        slid, taken = lips.slide - before.slide, organ.energies(states[-2], states[-1]).friction
        if share < 1.0:
            assert not lips.slips.any() and np.linalg.norm(T) == pytest.approx(share * MU * N, rel=1e-6)
            assert np.abs(slid).max() <= IDENTITY * SIDE and abs(taken) <= IDENTITY * N * SIDE
        else:
            assert lips.slips.all() and pytest.approx([MU * N, 0.0, 0.0], rel=1e-6, abs=1e-6 * N) == T
            gained = np.diff([(organ.M @ state.V)[::3].sum() for state in states[-2:]])[0]
            assert gained / dt == pytest.approx(SOFT.density * SIDE**3 * acceleration, rel=1e-5)
            assert taken == pytest.approx(MU * N * slid.mean(), rel=1e-4)


def test_sticking_surfaces_pass_the_patch_test() -> None:
    """Independent check: a uniform shear goes through surfaces that stick, matching or one grid in the other, to
    round-off. Other grids do not pass it, as without friction, and their error falls with the cells'."""
    for h in ((SIDE / 3, SIDE / 3), (SIDE / 4, SIDE / 2)):
        organ = rough_cubes(h, 2.0 * TRACTION)
        exact, lips = bear_uniform_strain(organ, SHEAR), organ.lips(state := at_rest_on(organ))
        body = organ.elasticity
        off = (organ.displacement(state) - exact)[body.free]
        assert np.abs(off).max() <= RESIDUAL * np.abs(exact).max() and not lips.slips.any()
        assert lips.friction.sum(axis=0)[0] == pytest.approx(TRACTION * lips.force.sum(), rel=RESIDUAL)
    errors = []
    for cells in ((6, 4), (12, 8)):
        organ = rough_cubes((SIDE / cells[0], SIDE / cells[1]), 2.0 * TRACTION)
        exact, lips = bear_uniform_strain(organ, SHEAR), organ.lips(at_rest_on(organ))
        expected = 0.5 * SQUEEZE * SOFT.lame_mu * SIDE**2
        errors.append(abs(lips.friction.sum(axis=0)[0] / expected - 1.0))
    assert errors[0] <= 3e-4 and errors[1] <= 0.7 * errors[0]


def test_surfaces_that_bear_too_little_slip_as_a_whole() -> None:
    """Independent check: under a shear above μ everything slips, and what is borne along the surface is μ times what is
    across it; what friction takes is what the held ends do not store."""
    organ = rough_cubes((SIDE / 3, SIDE / 3), 0.5 * TRACTION)
    bear_uniform_strain(organ, 0.1 * SHEAR)  # so little that each node faces what it faced
    state = at_rest_on(organ)
    lips = organ.lips(state)
    assert lips.slips.all()
    assert lips.friction.sum(axis=0)[0] == pytest.approx(0.5 * TRACTION * lips.force.sum(), rel=1e-4)
    again = organ.lips(at_rest_on(organ, (state,)))  # nothing moves on: what slipped sticks, and bears the same
    assert np.abs(again.friction - lips.friction).max() <= 1e-6 * np.abs(lips.friction).max()
    assert np.abs(again.slide - lips.slide).max() <= 1e-9 * lips.slide.max()


def test_open_surfaces_do_not_need_their_compliance() -> None:
    """Independent check: without forces no gap is negative by the law; the compliance would take solves."""
    nothing = SimpleNamespace()  # it has no compliance
    for gap, lawful in ((1e-6, True), (0.0, True), (-1e-6, False)):
        contact: Contact = Contact(np.array([1e-3, gap, 0.0, 0, 0, 0]), np.zeros((6, 0)), nothing, np.full(2, MU))
        assert is_lawful(contact, np.zeros(2, dtype=bool), contact.stuck, np.zeros(0)) is lawful


def test_without_friction_nothing_is_remembered() -> None:
    """Consistency check: a coefficient of zero has the very forces of surfaces without one, and none along them."""
    smooth, rough = (rough_cubes((SIDE / 3, SIDE / 3), mu) for mu in (0.0, 1e-9))
    for organ in (smooth, rough):
        bear_uniform_strain(organ, SHEAR)
    lips, other = (organ.lips(at_rest_on(organ)) for organ in (smooth, rough))
    assert smooth.contacts == smooth.pairs and not lips.friction.any() and not lips.slips.any()
    assert np.abs(other.force - lips.force).max() <= 1e-6 * lips.force.max()
