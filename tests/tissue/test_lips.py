"""Lips that press on one another, without a thread: a cut block against the whole one, and against other solvers."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import skfem
from scipy.interpolate import LinearNDInterpolator
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import brentq, minimize, nnls
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

import tissue
from coupling.integrators import BackwardEuler, Equilibrium
from coupling.joins.contact import Contact, find_sets, misfits
from meshes.wound import Wound, lips
from tests.bounds import IDENTITY, ORDER, RESIDUAL, TWO_SOLVERS
from tests.tissue.wounds import (
    SIDES,
    SIZE,
    SOFT,
    Array,
    at_rest,
    contact_of,
    cut_block,
    forced,
    gaps_on,
    opened,
    organ_of,
    stretched,
    whole_block,
)
from tissue.materials.isotropic import Exponential
from tissue.organs.meshed import gap_compliance

THROUGH = Wound(SIZE[1], SIZE[2])
SQUEEZE = 0.02
ELEMENTS = ("P1", "P2")


def halves(element: str, h: float = 5e-3) -> tissue.QuasiStaticOrgan:
    """A block cut right through, its two halves held at their far ends."""
    body = tissue.elasticity(cut_block(THROUGH, h), SOFT, element, SIDES)
    return organ_of(body, gaps_on(body, THROUGH))


def over_unknowns(gaps: tissue.Gaps) -> csr_matrix:
    """Gaps of the pairs of the reference over the free unknowns, shape `(k, N)`."""
    return csr_matrix(gaps.sums(gaps.start) @ gaps.rows)


def uniaxial(strain: float) -> Array:
    """Displacement gradient of a bar that is stretched along x and free across."""
    return np.diag([strain, -SOFT.poisson_ratio * strain, -SOFT.poisson_ratio * strain])


@pytest.mark.parametrize("element", ELEMENTS)
def test_two_halves_pressed_together_are_one_bar(element: str) -> None:
    """Independent check: the patch test of contact. Held ends that follow U = ε·x press the halves together by −E ε,
    the same everywhere; the field is in the space, so it is met to round-off, at the lips too."""
    organ = halves(element)
    held = stretched(organ, uniaxial(-SQUEEZE))
    state = at_rest(organ)
    body = organ.elasticity
    U, exact = body.nodal(organ.displacement(state) + held), body.points @ uniaxial(-SQUEEZE)
    assert np.abs(U - exact).max() <= RESIDUAL * np.abs(exact).max()
    pressure, expected = organ.gaps.pressure(state.p), SOFT.youngs_modulus * SQUEEZE
    assert np.abs(pressure - expected).max() <= TWO_SOLVERS * expected
    assert state.p.sum() == pytest.approx(expected * SIZE[1] * SIZE[2], rel=RESIDUAL)
    assert state.p.min() >= 0.0
    assert np.abs(organ.gap(state)).max() <= IDENTITY * SQUEEZE * SIZE[0]


@pytest.mark.parametrize("element", ELEMENTS)
def test_two_halves_of_squeezed_tissue_are_one_bar(element: str) -> None:
    """Independent check: a bar of stiffening tissue whose reference shape is squeezed by 5 % between held ends, and
    free across, stays where it is, and its halves press on one another by the nominal stress, the same everywhere; it
    would buckle beyond 9 %. Without contact they go through one another."""
    body = tissue.elasticity(cut_block(THROUGH), SOFT, element, SIDES)
    law = Exponential(SOFT.lame_mu, 3.0)

    def nominal(across: float) -> Array:
        """First Piola stress of the reference shape, shape `(3, 3)` [Pa]."""
        shape = tissue.Hyperelasticity(body, law, (0.95, across, across))
        return np.asarray(shape.stress(shape.gradient(np.zeros(body.N)))[:, :, 0, 0])

    across = brentq(lambda stretch: float(nominal(stretch)[1, 1]), 1.0, 1.2, xtol=1e-15)
    hyper, gaps = tissue.Hyperelasticity(body, law, (0.95, across, across)), gaps_on(body, THROUGH)
    organ = tissue.FiniteOrgan(body, tissue.build_sites(body, []), gaps=gaps, law=hyper, inertia=False)
    apart = replace(organ, gaps=None).start().U
    assert (gaps.g0 + over_unknowns(gaps) @ apart).min() < -0.02 * SIZE[0]
    state = in_contact(organ, organ.start())
    assert np.abs(state.U).max() <= RESIDUAL * np.abs(apart).max()
    pressure = gaps.parts[0].vertex_pressure(state.p)
    assert np.abs(pressure + nominal(across)[0, 0]).max() <= RESIDUAL * abs(nominal(across)[0, 0])


def test_a_slit_in_stretched_tissue_gapes_by_itself() -> None:
    """Independent check: at small stretch the lips open as those of the linear organ do under the stress that the cut
    sets free, and the difference falls by 10 when the stretch does; no lip presses on the other."""
    wound, edges = Wound(0.012, 5e-3), (*SIDES, "front", "back", "bottom")
    body = tissue.elasticity(cut_block(wound, 3e-3), SOFT, "P1", edges)
    gaps, off = gaps_on(body, wound), []
    for stretch in (1e-2, 1e-3):
        hyper = tissue.Hyperelasticity(body, Exponential(SOFT.lame_mu, 3.0), (1.0 + stretch, 1.0, 1.0))
        organ = tissue.FiniteOrgan(body, tissue.build_sites(body, []), gaps=gaps, law=hyper, inertia=False)
        state = in_contact(organ, organ.start())
        freed = -(body.K @ body.flat(body.points * [stretch, 0.0, 0.0]))[body.free]
        linear = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, [])).operator(0.0, 0.0).factor.solve(freed)
        gape, expected = organ.lips(state)[0], gaps.g0 + over_unknowns(gaps) @ linear
        assert not state.p.any() and expected.max() > 0.1 * stretch * 0.012
        off.append(np.abs(gape - expected).max() / expected.max())
    assert abs(np.log10(off[0] / off[1]) - 1.0) < ORDER


def in_contact(organ: tissue.FiniteOrgan, state: tissue.OrganState) -> tissue.OrganState:
    """The equilibrium of a nonlinear organ without piercings whose lips press on one another."""
    none = np.zeros(0)
    answer = organ.answer(Equilibrium(), [state])
    for _ in range(30):
        after = answer.again(none, p := forced(answer.g_free, answer))
        if after is answer:
            return answer.accept(none, p)
        answer = after
    raise AssertionError("no equilibrium")


@pytest.mark.parametrize("element", ELEMENTS)
def test_two_halves_drawn_apart_part(element: str) -> None:
    """Independent check: nothing holds the halves, so each goes with its end as a rigid body (but for what its held
    face, which contracts, strains), and no pair has a force."""
    organ = halves(element)
    held = stretched(organ, np.diag([SQUEEZE, 0.0, 0.0]))
    state = at_rest(organ)
    U = organ.elasticity.nodal(organ.displacement(state) + held)
    side = np.sign(organ.elasticity.points[:, 0])
    far = side != 0.0
    assert np.abs(U[far] - np.outer(side[far], [SQUEEZE * SIZE[0] / 2, 0.0, 0.0])).max() <= RESIDUAL * SIZE[0]
    assert not state.p.any()
    assert organ.gap(state) == pytest.approx(SQUEEZE * SIZE[0], rel=RESIDUAL)


@pytest.mark.parametrize(("element", "h"), [("P1", 2.5e-3), ("P2", 5e-3)])
def test_a_beam_with_a_slit_in_its_pressed_side_is_as_stiff_as_the_whole_one(element: str, h: float) -> None:
    """Independent check: a beam held at both ends sags under its weight and presses its top together in the middle,
    where by symmetry nothing is sheared: a slit there is not felt, with P1 to round-off. With P2 a vertex's share of a
    pressure that is not uniform may be a pull, and then it lets go: the more the softer, by a thousandth of what the
    slit could. Under the opposite weight it opens, and the beam is softer than the whole one."""
    wound = Wound(SIZE[1], 5e-3)
    size = (0.04, SIZE[1], SIZE[2])
    cut = tissue.elasticity(cut_block(wound, h, size), SOFT, element, SIDES)
    whole = tissue.elasticity(whole_block(wound, h, size), SOFT, element, SIDES)
    sags = []
    for g in (-9.81, 9.81):
        weight = (0.0, 0.0, g)
        uncut, slit = organ_of(whole, gravity=weight), organ_of(cut, gaps_on(cut, wound), gravity=weight)
        state = at_rest(slit)
        works = [0.5 * x.load @ x.field(s) for x, s in ((uncut, uncut.start()), (slit, state))]
        sags.append((works[1] / works[0], state.p, slit.gap(state)))
    (pressed, p, gap), (open_, none, width) = sags
    assert open_ > 1.01
    assert not none.any() and width.max() > 0.0
    assert gap.min() >= -IDENTITY * width.max() and (p > 0.0).mean() > 0.5
    if element == "P1":
        assert abs(pressed - 1.0) <= TWO_SOLVERS and gap.max() <= IDENTITY * SIZE[2] and p.min() > 0.0
    else:
        assert -TWO_SOLVERS <= pressed - 1.0 <= 1e-3 * (open_ - 1.0)


def bent_open(h: float = 4e-3) -> tissue.QuasiStaticOrgan:
    """A block with a slit from its top, squeezed along x while it is bent to open and turned about z: a part of the
    pairs is pressed, a part is open."""
    wound = Wound(SIZE[1], 8e-3)
    body = tissue.elasticity(cut_block(wound, h), SOFT, "P1", SIDES)
    organ = organ_of(body, gaps_on(body, wound))
    x, y, z = body.points.T
    bend = np.column_stack([x * (-0.01 + 3.0 * y + 1.0 * z), 0.0 * x, 0.0 * x])
    held, field = np.zeros(body.N), body.flat(bend)
    held[body.clamped] = field[body.clamped]
    object.__setattr__(organ, "load", -(body.K @ held)[body.free])
    return organ


def test_the_answer_is_that_of_other_solvers() -> None:
    """Independent check: scipy's non-negative least squares on the dual, min ½pᵀC p + pᵀg over p ≥ 0; the body's own
    energy ½UᵀKU − fᵀU, minimised under g ≥ 0 by scipy's SLSQP on a tiny mesh, is no lower."""
    organ = bent_open()
    state, contact = at_rest(organ), contact_of(organ)
    root = cholesky(contact.C_cc)
    p, _ = nnls(root, -solve_triangular(root, contact.g_free, trans="T"))
    pressed = state.p > 0.0
    assert 0.2 < pressed.mean() < 0.8
    assert np.array_equal(p > 0.0, pressed)
    assert np.abs(p - state.p).max() <= TWO_SOLVERS * p.max()
    assert organ.gap(state).min() >= -IDENTITY * organ.gap(state).max()
    assert np.abs(organ.gap(state) * state.p).max() <= IDENTITY * organ.gap(state).max() * p.max()


def test_the_answer_is_the_least_energy_without_crossing() -> None:
    """Independent check: ½UᵀKU − fᵀU over all U that keep the lips apart, by scipy's SLSQP on a tiny mesh, which knows
    nothing of compliance or active sets. Its own precision is the bound."""
    organ = bent_open(1e-2)
    U, unit = organ.field(at_rest(organ)), 1e-4
    K, f, G = (unit * organ.K).toarray(), organ.load, organ.pairing(None).G.toarray()
    scale = np.abs(f @ U)

    found = minimize(
        lambda x: (0.5 * x @ K @ x - f @ x) * unit / scale,
        np.zeros(organ.size),
        jac=lambda x: (K @ x - f) * unit / scale,
        constraints={"type": "ineq", "fun": lambda x: G @ x, "jac": lambda x: G},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 500},
    )
    assert found.success and 0 < (at_rest(organ).p > 0.0).sum() < organ.pairs
    assert np.abs(unit * found.x - U).max() <= 1e-5 * np.abs(U).max()
    ours = 0.5 * U @ (organ.K @ U) - f @ U
    assert ours <= found.fun * scale + RESIDUAL * scale


def test_it_does_not_matter_where_the_search_begins() -> None:
    """Consistency check: from all pairs open, all pressed, the answer itself, its opposite and at random."""
    organ = bent_open(2.5e-3)
    right = at_rest(organ).p
    chance = np.random.default_rng(1)
    starts = [np.zeros(organ.pairs, bool), np.ones(organ.pairs, bool), right > 0.0, right <= 0.0]
    for start in [*starts, *(chance.random((8, organ.pairs)) < 0.5)]:
        assert np.array_equal(at_rest(organ, start).p > 0.0, right > 0.0)
        assert np.abs(at_rest(organ, start).p - right).max() <= IDENTITY * 1e2 * right.max()


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("width", [0.0, 1e-3])
def test_every_node_of_the_lips_has_its_pair(element: str, width: float) -> None:
    """Independent check: pairs are mirror images, with P2 at the middles of the edges too; each node that is on one lip
    only is in one pair, and G U is the difference of the nodes' displacements along n."""
    wound = Wound(0.012, 5e-3)
    closed = cut_block(wound)
    mesh = opened(closed, width) if width else closed
    body = tissue.elasticity(mesh, SOFT, element, ["bottom"])
    gaps = gaps_on(body, wound, closed)
    left, right = (body.points[side] for side in gaps.nodes.T)
    assert np.array_equal(left * [-1.0, 1.0, 1.0], right)
    assert np.abs(gaps.g0 - 2.0 * right[:, 0]).max() <= IDENTITY * SIZE[0]
    lip = {
        name: np.unique(body.basis.get_dofs(facets=mesh.boundaries[name]).all()) for name in ("lip_left", "lip_right")
    }
    alone = [np.setdiff1d(lip[a], lip[b]) for a, b in (("lip_left", "lip_right"), ("lip_right", "lip_left"))]
    for side, unknowns in zip(gaps.nodes.T, alone, strict=True):
        assert np.array_equal(np.sort(body.nodes[side].ravel()), unknowns)
    field = np.random.default_rng(3).standard_normal(body.N)
    field[body.clamped] = 0.0
    U = body.nodal(field)
    apart = (U[gaps.nodes[:, 1]] - U[gaps.nodes[:, 0]])[:, 0]
    assert np.abs(over_unknowns(gaps) @ field[body.free] - apart).max() <= IDENTITY


def test_columns_of_contact_are_solved_once_and_in_groups_of_the_pairs_that_press() -> None:
    """Independent check: G A⁻¹ Gᵀ by the inverse of a dense matrix, and the columns that go through the solver; the
    last group is shorter."""
    rng, solved = np.random.default_rng(7), []
    root, G = rng.standard_normal((30, 30)), csr_matrix(rng.standard_normal((8, 30)))
    A = root @ root.T + 30.0 * np.eye(30)

    def solve(b: Array) -> Array:
        solved.append(b.shape[1])
        return np.linalg.solve(A, b)

    columns, C = gap_compliance(SimpleNamespace(solve=solve), G, together=3), G @ np.linalg.inv(A) @ G.T
    for some in ([2, 5], [5, 7, 2], [7]):
        assert np.abs(columns.of(np.array(some)) - C[:, some]).max() <= IDENTITY * np.abs(C).max()
    p = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert np.abs(columns.times(p) - C @ p).max() <= IDENTITY * np.abs(C @ p).max()
    assert solved == [3, 3, 2]


def test_a_search_that_would_go_round_ends() -> None:
    """Independent check: with this matrix exchanging all wrong pairs at once comes back to where it was (found by
    trying random ones); one at a time it ends, with the answer of scipy's non-negative least squares."""
    C = np.array(
        [[23.0, 12.0, 0.0, -7.0], [12.0, 22.0, 12.0, -15.0], [0.0, 12.0, 10.0, -11.0], [-7.0, -15.0, -11.0, 17.0]]
    )
    g, none, sets = np.array([-2.0, -2.0, -1.0, 2.0]), np.zeros(0), [np.zeros(4, dtype=bool)]
    contact = Contact(g, np.zeros((4, 0)), SimpleNamespace(gaps_by_forces=lambda some: C[:, some]))
    while len({tuple(pressed) for pressed in sets}) == len(sets):
        sets.append(sets[-1] ^ misfits(contact, none, sets[-1]))
    assert misfits(contact, none, sets[-1]).any()
    root = cholesky(C)
    p, _ = nnls(root, -solve_triangular(root, g, trans="T"))
    assert np.abs(find_sets(contact, none, sets[0], contact.stuck)[2] - p).max() <= RESIDUAL * p.max()


def test_two_halves_that_collide_exchange_their_momentum() -> None:
    """Independent check: two halves of a free block fly at one another. What the contact forces give one they take from
    the other, Σ dt Σ p is the change of either's momentum, in every step; no energy is made, and they part again."""
    wound, speed, dt = Wound(SIZE[1], SIZE[2]), 0.05, 2e-4
    closed = cut_block(wound)
    body = tissue.elasticity(opened(closed, 1e-4), SOFT)
    organ = tissue.DynamicOrgan(body, tissue.build_sites(body, []), gaps=gaps_on(body, wound, closed))
    side = np.ones(len(body.points))
    side[np.unique(body.mesh.t[:, body.mesh.p[0][body.mesh.t].mean(axis=0) < 0.0])] = -1.0
    V = body.flat(np.outer(-speed * side, [1.0, 0.0, 0.0]))
    right = body.flat(np.outer(side > 0.0, [1.0, 0.0, 0.0]))
    state = tissue.OrganState(0.0 * V, V, 0.0 * V, np.zeros(0), np.zeros(organ.pairs))
    first = right @ (body.M @ V)
    momentum, stored, touched = first, 0.5 * V @ (body.M @ V), 0
    for _ in range(150):
        answer = organ.answer(BackwardEuler(dt), [state])
        p = forced(answer.g_free, answer)
        new = answer.accept(np.zeros(0), p)
        energies = organ.energies(state, new)
        assert organ.gap(new).min() >= -IDENTITY * SIZE[0]
        assert np.abs(organ.gap(new) * p).max() <= IDENTITY * p.max() * SIZE[0]
        assert abs(right @ (body.M @ new.V) - momentum - dt * p.sum()) <= RESIDUAL * abs(first)
        now = energies.kinetic + energies.elastic
        assert abs(stored - now - energies.numerical) <= RESIDUAL * stored
        assert energies.numerical >= -IDENTITY * stored
        momentum, stored, state, touched = right @ (body.M @ new.V), now, new, touched + bool(p.any())
    assert abs(body.flat(np.tile([1.0, 0.0, 0.0], (len(side), 1))) @ (body.M @ state.V)) <= RESIDUAL * abs(first)
    assert 10 < touched < 140 and momentum > 0.2 * abs(first) and not state.p.any()


# -- lips that slide ---------------------------------------------------------------------------------------------------

WAVE, HEIGHT = SIZE[1], 4e-4  # of the lips along y [m]


def wavy_halves(element: str = "P1") -> tissue.DynamicOrgan:
    """A block cut right through along a wave, its left half held; its own weight presses the right half on it."""
    wound = Wound(SIZE[1], SIZE[2])
    mesh = cut_block(wound, 2.5e-3)
    x, y, _ = mesh.p
    shift = HEIGHT * np.cos(2.0 * np.pi * y / WAVE) * (1.0 - 2.0 * np.abs(x) / SIZE[0])
    wave = skfem.MeshTet(mesh.p + np.outer([1.0, 0.0, 0.0], shift), mesh.t).with_boundaries(mesh.boundaries)
    body = tissue.elasticity(wave, SOFT, element, ["left"])
    sites = tissue.build_sites(body, [])
    return tissue.DynamicOrgan(body, sites, (-9.81, 0.0, 0.0), gaps=gaps_on(body, wound, mesh), rayleigh=(0.0, 2e-3))


def overlap(organ: tissue.DynamicOrgan, state: tissue.OrganState) -> float:
    """How far a vertex of either lip is inside the other one, along x, by the triangles that scipy makes of it [m].

    Those at its upper and lower rim are slivers: what lies there is left out.
    """
    body = organ.elasticity
    points, deepest = body.points + body.nodal(organ.displacement(state)), 0.0
    lip = [points[np.unique(organ.gaps.nodes[: body.mesh.nvertices, k])] for k in (0, 1)]
    for sign, one, other in ((1.0, *lip), (-1.0, *lip[::-1])):
        x, *along = one[np.abs(one[:, 2] + SIZE[2] / 2) < 0.4 * SIZE[2]].T
        faced = LinearNDInterpolator(other[:, 1:], other[:, 0])(*along)
        deepest = max(deepest, float(np.nanmax(sign * (x - faced))))
    return deepest


def test_lips_that_slide_stay_out_of_one_another_and_carry_their_load() -> None:
    """Independent check: the right half of a block, pressed on the left one along a wave by its weight, is sent along
    it by three cells. It rides over the wave's crests: neither lip is inside the other by more than twice the wave's
    slope times the way of a step, and in the mean the lips carry the weight. Every joule is accounted for, and what
    lifts it is its own motion: the integrator's share stays below a twentieth of the energy that it began with. Pairs
    that stay would overlap by nearly the height of the wave, forces along x would make a quarter of the energy."""
    organ, dt, speed = wavy_halves(), 1e-3, 0.15
    body = organ.elasticity
    right = body.points[:, 0] > 1e-9 + HEIGHT
    right[organ.gaps.nodes[:, 1]] = True
    V = body.flat(np.outer(right, [0.0, speed, 0.0]))[body.free]
    state = replace(organ.start(), V=V)
    weight = -organ.load @ body.flat(np.tile([1.0, 0.0, 0.0], (len(right), 1)) * right[:, None])[body.free]
    steep, carried, deepest, slid, taken = 2.0 * np.pi * HEIGHT / WAVE, [], 0.0, 0.0, [0.0]
    first = organ.energies(state, state).kinetic
    for _ in range(60):
        answer = organ.answer(BackwardEuler(dt), [state])
        new = answer.accept(np.zeros(0), forced(answer.g_free, answer))
        old, now = organ.energies(state, state), organ.energies(state, new)
        given = now.load_work - (now.kinetic + now.elastic - old.kinetic - old.elastic) - now.viscous - now.numerical
        assert abs(given) <= RESIDUAL * (now.kinetic + now.elastic)
        assert np.abs(organ.gap(new) * new.p).max() <= IDENTITY * new.p.max(initial=weight) * SIZE[0]
        state, slid = new, float(organ.lips(new)[2].max())
        deepest = max(deepest, overlap(organ, state))
        carried.append(state.p.sum())
        taken.append(taken[-1] + now.numerical)
    assert state.facing is not None and slid > 3 * 2.5e-3
    assert np.abs(taken).max() <= 0.05 * first
    assert deepest <= 2.0 * steep * speed * dt
    assert np.mean(carried) == pytest.approx(weight, rel=0.1)


@pytest.mark.parametrize("element", ELEMENTS)
def test_energies_while_the_pairs_change(element: str) -> None:
    """Consistency check: from one pairing to another, the elastic energy of a quasi-static organ, taken from its field,
    is that of its forces and compliances, its works balance, and its gaps are those of its equation."""
    organ = halves(element)
    rng = np.random.default_rng(1)
    object.__setattr__(organ, "load", rng.normal(size=organ.size))
    states = []
    for way in (0.0, 3e-3, 7e-3):
        moved = np.zeros((len(organ.elasticity.points), 3))
        moved[organ.gaps.nodes[:, 1], 1] = way
        facing = organ.gaps.facing(organ.elasticity.points, moved)
        assert (facing is None) == (way == 0.0)
        p = np.abs(rng.normal(size=organ.pairs))
        states.append(replace(organ.start(), p=p if facing is None else p * (facing[:, 0] >= 0.0), facing=facing))
    sagged, before = spsolve(organ.K.tocsc(), organ.load), organ.energies(states[0], states[0]).elastic
    for old, new in pairwise(states):
        now, pairing = organ.energies(old, new), organ.pairing(new.facing)
        by_forces = organ.operator(0.0, 0.0).by_pairs(pairing).times(new.p)
        elastic = 0.5 * organ.load @ sagged + new.p @ (pairing.G @ sagged + 0.5 * by_forces)
        assert now.elastic == pytest.approx(elastic, rel=TWO_SOLVERS)
        scale = abs(now.elastic) + abs(before) + abs(now.numerical)
        assert abs(now.elastic - before + now.numerical - now.load_work) <= TWO_SOLVERS * scale
        before, gap = now.elastic, pairing.g0 + pairing.G @ organ.field(new)
        assert np.abs(organ.gap(new) - gap).max() <= TWO_SOLVERS * np.abs(gap).max()


@pytest.mark.parametrize("element", ELEMENTS)
def test_what_a_lip_faces(element: str) -> None:
    """Independent check: a field that is linear (with P2: quadratic) along the lips is met at the point in front of
    every left node, wherever the right lip was moved to; past its edge by more than a cell a node faces nothing."""
    organ, way = halves(element), 6.2e-3
    body, gaps = organ.elasticity, organ.gaps
    moved = np.zeros((len(body.points), 3))
    moved[np.unique(gaps.facets), 1] = way
    facing = gaps.facing(body.points, moved)
    assert facing is not None
    nodes, weights = gaps.weights(facing)
    past = gaps.slides(moved)
    assert past == pytest.approx(way, rel=IDENTITY)

    def field(y: Array, z: Array) -> Array:
        return 1.0 + 30.0 * y - 20.0 * z + (0.0 if element == "P1" else 1.0) * (4e3 * y * z + 1e3 * y**2)

    _, y, z = body.points[gaps.nodes[:, 0]].T
    over = y > -SIZE[1] / 2 + way - IDENTITY
    carried = np.sum(weights * field(body.points[nodes, 1] + way, body.points[nodes, 2]), axis=1)
    assert np.abs(carried - field(y, z))[over].max() <= 1e3 * IDENTITY
    beyond = y < -SIZE[1] / 2 + way - 5e-3
    assert beyond.any() and (facing[beyond, 0] < 0.0).all() and (facing[over, 0] >= 0.0).all()
    assert not weights[beyond].any()


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_what_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refusals name the value and the remedy: lips that overlap, a normal of nothing, lips that are held, gaps of
    another body, more pairs than there is room for."""
    wound = Wound(0.012, 5e-3)
    closed = cut_block(wound)
    body = tissue.elasticity(opened(closed, 1e-3), SOFT, "P1", ["bottom"])
    pairs = lips(closed, wound)
    with pytest.raises(tissue.TissueError, match=r"overlap by 0\.001 m"):
        tissue.build_gaps(body, pairs.nodes, pairs.facets[:, 0], [-1.0, 0.0, 0.0])
    with pytest.raises(tissue.TissueError, match="normal"):
        tissue.build_gaps(body, pairs.nodes, pairs.facets[:, 0], [0.0, 0.0, 0.0])
    held = tissue.elasticity(closed, SOFT, "P1", ["lip_left", "lip_right"])
    with pytest.raises(tissue.TissueError, match="no pair of nodes that can move"):
        tissue.build_gaps(held, pairs.nodes, pairs.facets[:, 0], [1.0, 0.0, 0.0])
    other = tissue.elasticity(closed, SOFT, "P1", ["left"])
    with pytest.raises(tissue.TissueError, match="build them on it"):
        organ_of(other, gaps_on(body, wound, closed))
    monkeypatch.setattr("tissue.organs.meshed.free_memory", lambda: 1e3)
    with pytest.raises(tissue.TissueError, match=r"pairs of nodes on the lips take about .* coarser mesh at the lips"):
        organ_of(body, gaps_on(body, wound, closed))


@pytest.mark.parametrize("gain", [-3.0, -0.5, 0.5])
def test_pairs_come_to_a_place_that_answers_with_itself(gain: float) -> None:
    """Theory: an answer U = U* + g (V − U*) to pairs at the place V has the one fixed point U*. Pairs at U itself move
    away from it for g < −1; Aitken's share 1/(1 − g) is there with the second one. Shares above one are not taken."""
    organ = wavy_halves()
    state, rng = organ.start(), np.random.default_rng(5)
    goal, first = (1e-4 * rng.standard_normal(organ.size) for _ in range(2))
    last, off = replace(state, U=first), []
    for _ in range(4):
        now = replace(state, U=goal + gain * (organ.place(last) - goal))
        last = organ.paired_nearer(last, now)
        off.append(float(np.linalg.norm(organ.place(last) - goal) / np.linalg.norm(first - goal)))
    assert off[0] == pytest.approx(abs(gain))
    assert off[1] <= 1e-12 if gain < 0.0 else off[3] == pytest.approx(gain**4)
