"""An organ in its Krylov space: what it leaves of the equations of motion, and what is done where that is much."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import tissue
from coupling.integrators import BDF2, BackwardEuler, Equilibrium, Scheme
from meshes.block import block
from meshes.wound import Wound
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.tissue.wounds import cut_block, gaps_on
from tissue.arrays import Array
from tissue.organs import krylov
from tissue.organs.krylov import KrylovAnswer
from tissue.solvers.factor import RESIDUAL as OF_SOLVERS

SOFT = tissue.Material(4.0e4, 0.45, 1070.0)
SITES = [tissue.Site((x, 0.0, 0.0), 2.0e-3, direction="normal") for x in (-0.005, 0.005)]
PULL = np.zeros(18)
PULL[[0, 2, 11]] = 0.02, 0.05, 0.03  # N
SLOW = 2.0e-3  # s, a few steps a period of the slowest motion of the block
BOTH = pytest.mark.parametrize("scheme", [BackwardEuler, BDF2])
LOAD = tissue.SurfaceLoad("right", (50.0, 0.0, -300.0), course=((0.0, 0.0), (10 * SLOW, 1.0)))
KINDS = {
    "bare": {},
    "damped, loaded": {"rayleigh": (5.0, 1e-3), "gravity": (0.0, 0.0, -9.81), "loads": (LOAD,)},
}


def organ_of(h: float = 3.5e-3, **keys: object) -> tissue.DynamicOrgan:
    """A soft block, held at its bottom and pulled at two holes of its top."""
    body = tissue.elasticity(block((0.03, 0.02, 0.015), h), SOFT, "P1", ("bottom",))
    return tissue.DynamicOrgan(body, tissue.build_sites(body, SITES), **keys)  # type: ignore[arg-type]


def schemes(kind: type[Scheme], steps: int, dt: float) -> list[Scheme]:
    """BDF2 begins by a step of backward Euler."""
    return [BDF2(dt, dt) if kind is BDF2 and n else BackwardEuler(dt) for n in range(steps)]


def smooth(t: float) -> Array:
    return np.asarray(PULL * np.sin(30.0 * t) ** 2)


def shock(t: float) -> Array:
    return np.asarray(PULL * (1.0 if t < 10.5 * SLOW else -1.0))


def states(
    organ: tissue.DynamicOrgan | tissue.KrylovOrgan,
    kind: type[Scheme],
    steps: int,
    force: Callable[[float], Array],
    dt: float = SLOW,
    certified: bool = True,
) -> list[tissue.OrganState]:
    """The start, and the states after so many steps under the forces at their times."""
    out: list[tissue.OrganState] = [organ.start()]
    for n, scheme in enumerate(schemes(kind, steps, dt)):
        answer, f_y = organ.answer(scheme, out[::-1][: len(scheme.coefficients)], (n + 1) * dt), force((n + 1) * dt)
        if certified and isinstance(answer, KrylovAnswer):
            answer = answer.certified(f_y)
        out.append(answer.accept(f_y))
    return out


def left_of(full: tissue.DynamicOrgan, state: tissue.OrganState) -> tuple[Array, Array]:
    """What a state leaves of the equations of motion of all unknowns, and the forces at work, `(N,)` [N]."""
    alpha, beta = full.rayleigh
    inertia, stiff = full.M @ (state.A + alpha * state.V), full.K @ (state.U + beta * state.V)
    pulls = full.Y.T @ state.f_y + full.load_under(state.shares)
    return np.asarray(pulls - inertia - stiff), np.abs(inertia) + np.abs(stiff)


@BOTH
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_left_is_that_of_all_unknowns(scheme: type[Scheme], kind: str) -> None:
    """Independent check: at every step, of few blocks and so of much that is left, the norm by the small matrix R is
    that of the residual of all equations, by a solve with K."""
    full = organ_of(4.5e-3, **KINDS[kind])  # type: ignore[arg-type]
    organ = tissue.KrylovOrgan(full)
    factor = full.solver_of(full.K)
    for state in states(organ, scheme, 12, smooth, 0.1 * SLOW, certified=False)[1:]:
        r, _ = left_of(full, organ.whole(state))
        norm, scale = np.sqrt(r @ factor.solve(r)), state.tally
        assert norm >= 1e-6 * scale  # there is something to be seen
        assert abs(organ.residual(state) * scale - norm) <= TWO_SOLVERS * scale


@BOTH
@pytest.mark.parametrize("kind", KINDS)
def test_steps_are_those_of_the_whole_organ(scheme: type[Scheme], kind: str) -> None:
    """Consistency check: under the same smooth forces sites are within 1e-10 of the way, fields within the accuracy,
    and every step holds the bound of all solvers."""
    full = organ_of(**KINDS[kind])  # type: ignore[arg-type]
    organ = tissue.KrylovOrgan(full)
    pairs = list(zip(*(states(each, scheme, 40, smooth) for each in (full, organ)), strict=True))[1:]
    way = max(np.abs(full.site_variables(U) - full.y0).max() for U, _ in pairs)
    field = max(np.abs(U.U).max() for U, _ in pairs)
    stiffness = float(np.max(abs(full.K) @ np.ones(full.size)))
    for U, eta in pairs:
        assert organ.vectors(eta) > 0
        assert np.abs(full.site_variables(U) - organ.site_variables(eta)).max() <= RESIDUAL * way
        assert np.abs(U.U - organ.field(eta)).max() <= krylov.ACCURACY * field
        r, _ = left_of(full, organ.whole(eta))
        assert np.linalg.norm(r) <= OF_SOLVERS * stiffness * np.linalg.norm(U.U)


def test_what_is_static_is_exact() -> None:
    """Consistency check: the compliance of the sites, and what gravity and loads do, by the organ without inertia."""
    load = tissue.SurfaceLoad("right", (0.0, 0.0, -300.0))
    moving = organ_of(gravity=(0.0, 0.0, -9.81), loads=(load,))
    full = tissue.QuasiStaticOrgan(moving.elasticity, moving.sites, moving.gravity, loads=moving.loads)
    small = tissue.KrylovOrgan(moving)
    one, other = (organ.answer(Equilibrium(), [organ.start()]) for organ in (full, small))
    still = one.y_free - full.y0
    assert np.abs(still).max() > 0.0
    assert np.abs(one.y_free - other.y_free).max() <= TWO_SOLVERS * np.abs(still).max()
    assert np.abs(one.C - other.C).max() <= TWO_SOLVERS * np.abs(one.C).max()
    field = full.displacement(one.accept(PULL))
    assert np.abs(field - small.displacement(other.accept(PULL))).max() <= TWO_SOLVERS * np.abs(field).max()


@BOTH
def test_the_audit_is_exact(scheme: type[Scheme]) -> None:
    """Independent check: work of the site forces, gravity and loads = change of kinetic and elastic energy + viscous +
    numerical, at every step, whatever a step leaves of the equations of motion."""
    small = tissue.KrylovOrgan(organ_of(4.5e-3, **KINDS["damped, loaded"]))  # type: ignore[arg-type]
    old, *rest = states(small, scheme, 30, smooth, certified=False)
    scale, before = 0.0, small.energies(old, old)
    for new in rest:
        after = small.energies(old, new)
        work = after.load_work + new.f_y @ (small.site_variables(new) - small.site_variables(old))
        taken = after.kinetic + after.elastic - before.kinetic - before.elastic + after.viscous + after.numerical
        scale = max(scale, after.elastic + after.kinetic)
        assert abs(work - taken) <= RESIDUAL * scale
        old, before = new, after
    assert after.viscous > 0.0


def test_without_its_check_a_space_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: the agreement is the check's doing. One block alone, whose steps are not asked what they
    leave, misses the sites by more than ten thousand times the bound of those that are."""
    full = organ_of()
    monkeypatch.setattr(krylov, "START", 1)
    for certified in (True, False):
        organ = tissue.KrylovOrgan(full)
        pairs = list(
            zip(states(full, BDF2, 40, smooth), states(organ, BDF2, 40, smooth, certified=certified), strict=True)
        )
        off = max(np.abs(full.site_variables(U) - organ.site_variables(eta)).max() for U, eta in pairs)
        way = max(np.abs(full.site_variables(U) - full.y0).max() for U, _ in pairs)
        assert (off <= RESIDUAL * way) if certified else (off >= 1e4 * RESIDUAL * way)


def test_a_space_is_widened_as_far_as_it_takes() -> None:
    """Independent check: what a step needs it gets before it is accepted, and keeps; what the next steps need besides
    comes to that, and never less than there was."""
    organ = tissue.KrylovOrgan(organ_of())
    sizes = [organ.vectors(state) for state in states(organ, BDF2, 40, smooth)]
    assert sizes[-1] > sizes[0] > 0 and np.all(np.diff(sizes) >= 0)


def test_a_step_that_asks_for_many_blocks_is_solved_whole_at_once() -> None:
    """Independent check: a pull at once, in one step of a slow body, asks for a few blocks and gets them; in steps a
    third as long it asks for more than come at once, and one is made, by which that is seen, beside those at the start
    with the one behind them. A run of a hundred steps had paid for eighteen, and was solved whole after all."""
    full = organ_of(4.5e-3)
    slow, sharp = (tissue.KrylovOrgan(full) for _ in range(2))
    _, gentle = states(slow, BackwardEuler, 1, lambda t: PULL)
    _, sudden = states(sharp, BackwardEuler, 1, lambda t: PULL, 0.3 * SLOW)
    block = full.Y.shape[0]
    assert slow.vectors(gentle) > (krylov.FIRST + 1) * block and sharp.vectors(sudden) == 0
    assert sharp.space.vectors.shape[1] <= (krylov.START + 3) * block


@BOTH
def test_what_no_space_follows_is_solved_whole(scheme: type[Scheme]) -> None:
    """Consistency check: forces that turn round at once, in steps far shorter than the slowest period and without
    damping: from that step on fields are those of the whole organ to round-off of both, the state before it counts as
    its fields, and the audit closes over the change as over any step."""
    full = organ_of(4.5e-3)
    organ = tissue.KrylovOrgan(full)
    dt = 0.02 * SLOW
    one, other = (states(each, scheme, 30, lambda t: shock(50.0 * t), dt) for each in (full, organ))
    assert organ.vectors(other[0]) > 0 and organ.vectors(other[-1]) == 0
    way = max(np.abs(full.site_variables(U) - full.y0).max() for U in one)
    for U, eta in zip(one, other, strict=True):
        assert np.abs(full.site_variables(U) - organ.site_variables(eta)).max() <= RESIDUAL * way
    before = organ.energies(other[0], other[0])
    for old, new in pairwise(other):
        after = organ.energies(old, new)
        work = after.load_work + new.f_y @ (organ.site_variables(new) - organ.site_variables(old))
        taken = after.kinetic + after.elastic - before.kinetic - before.elastic + after.viscous + after.numerical
        assert abs(work - taken) <= RESIDUAL * (after.kinetic + after.elastic)
        before = after


def test_a_state_in_a_wider_space_and_whole_is_the_same() -> None:
    """Consistency check: field, velocity, sites and energies of a state are those of the whole organ's."""
    full = organ_of(rayleigh=(5.0, 1e-3))
    organ = tissue.KrylovOrgan(full)
    old, state = states(organ, BDF2, 6, smooth)[-2:]
    whole = organ.whole(state)
    assert organ.vectors(whole) == 0 and whole.U.size == full.size
    for of_one in (organ.field, lambda at: organ.spread(at, at.V), organ.site_variables):
        a, b = of_one(state), of_one(whole)
        assert np.abs(a - b).max() <= IDENTITY * np.abs(a).max() * full.size
    energies = [np.array(organ.energies(*pair)) for pair in ((old, state), (old, whole))]
    scale = energies[0][:2].sum()
    assert np.abs(energies[0] - energies[1]).max() <= RESIDUAL * scale


@BOTH
def test_a_space_as_large_as_its_organ_is_the_organ(scheme: type[Scheme], monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: where the blocks come to hold all unknowns of a coarse organ, it is solved whole; a state in
    as many vectors would be read as fields."""
    full = organ_of(9e-3)
    for name, value in (("ACCURACY", 1e-20), ("ROUNDED", 0.0), ("MOST", 1000)):  # widened until nothing is left
        monkeypatch.setattr(krylov, name, value)
    organ = tissue.KrylovOrgan(full)
    one, other = (states(each, scheme, 30, lambda t: shock(50.0 * t), 0.02 * SLOW) for each in (full, organ))
    assert organ.vectors(other[0]) > 0 and organ.vectors(other[-1]) == 0
    way = max(np.abs(full.site_variables(U) - full.y0).max() for U in one)
    for U, eta in zip(one, other, strict=True):
        assert np.abs(full.site_variables(U) - organ.site_variables(eta)).max() <= RESIDUAL * way


@pytest.mark.parametrize("kind", KINDS)
def test_how_far_compliances_fall_short_is_bounded(kind: str) -> None:
    """Theory: Galerkin's compliances never exceed those of all unknowns, and fall short by no more than the square of
    what their answers leave of the equations, from steps that a few blocks follow to those that none do."""
    full = organ_of(4.5e-3, **KINDS[kind])  # type: ignore[arg-type]
    organ = tissue.KrylovOrgan(full)
    short = []
    for dt in (0.3 * SLOW, 0.1 * SLOW, 0.03 * SLOW):
        scheme = BackwardEuler(dt)
        level, exact = organ.space.level(1), full.answer(scheme, [full.start()]).C.diagonal()
        own = level.modes.operator(scheme.a, scheme.d).C.diagonal()
        off = (exact - own) / own
        assert off.min() >= -TWO_SOLVERS
        assert off.max() <= level.shortfall(scheme) + TWO_SOLVERS
        short.append(level.shortfall(scheme) / off.max())
    assert min(short) <= 10.0  # where the step is slow, and inertia adds little to what K resists


def test_how_far_compliances_fall_short_is_what_answers_leave() -> None:
    """Independent check: where damping by mass is as large as inertia, of the answers to unit pulls of sites, the
    square of what they leave of all equations in the norm of K⁻¹, over the work of the pull."""
    scheme = BackwardEuler(0.1 * SLOW)
    full = organ_of(4.5e-3, rayleigh=(scheme.a / scheme.d, 1e-4))
    space = tissue.KrylovOrgan(full).space
    level, (alpha, beta) = space.level(1), full.rayleigh
    operator = level.modes.operator(scheme.a, scheme.d)
    X = space.vectors[:, : len(level.turn)] @ (level.turn @ operator.W)
    mass, stiffness = scheme.a + alpha * scheme.d, 1.0 + beta * scheme.d
    left = full.Y.T @ np.eye(X.shape[1]) - mass * (full.M @ X) - stiffness * (full.K @ X)
    norms = np.sum(left * full.solver_of(full.K).solve(left), axis=0)
    own = operator.C.diagonal()
    expected = float(np.max(norms[own > 0.0] / own[own > 0.0]))
    assert abs(level.shortfall(scheme) - expected) <= TWO_SOLVERS * expected


def test_an_answer_under_all_forces_is_that_of_the_whole_organ() -> None:
    """Consistency check: compliances are the whole organ's to what Newton sees of them, in a wider space or in none,
    also under no forces, which say nothing; an answer that has them is its own."""
    full = organ_of(4.5e-3)
    organ, kinds = tissue.KrylovOrgan(full), set()
    for dt in (10.0 * SLOW, 0.5 * SLOW, 0.01 * SLOW):
        answer = organ.answer(BackwardEuler(dt), [organ.start()])
        assert isinstance(answer, KrylovAnswer)
        faithful, exact = answer.faithful(), full.answer(BackwardEuler(dt), [full.start()]).C
        kinds.add("own" if faithful is answer else type(faithful).__name__)
        scale = np.sqrt(np.outer(exact.diagonal(), exact.diagonal()))
        assert np.abs((faithful.C - exact) / scale).max() <= 2.0 * krylov.SHORT
        assert answer.certified(np.zeros(len(full.y0))) is answer
    assert kinds >= {"own", "LinearAnswer"}


def test_what_strikes_is_answered_whole() -> None:
    """Consistency check: after an impulse and a displacement the motion is that of the whole organ, to round-off of
    what was there before."""
    full = organ_of()
    organ, ends = tissue.KrylovOrgan(full), []
    for each in (full, organ):
        at = states(each, BackwardEuler, 5, smooth)[-1]
        at = each.impulse(at).accept(1e-5 * PULL)
        at = each.displace(BackwardEuler(SLOW), at, each.site_variables(at), at.f_y).accept(0.9 * at.f_y)
        for _ in range(10):
            at = each.answer(BackwardEuler(SLOW), [at]).accept(0.9 * at.f_y)
        ends.append(each.site_variables(at) - full.y0)
    assert np.abs(ends[0] - ends[1]).max() <= RESIDUAL * np.abs(ends[0]).max()


def test_a_space_is_the_same_however_it_came_to_be() -> None:
    """Consistency check: a state that is taken up by an organ made anew goes on to the same bits, although the space
    was made in another order; a number of vectors that no blocks have is refused."""
    full = organ_of()
    first, second = tissue.KrylovOrgan(full), tissue.KrylovOrgan(full)
    old = states(first, BDF2, 12, smooth)
    scheme = schemes(BDF2, 2, SLOW)[1]
    ends = [organ.answer(scheme, old[:-3:-1], 0.03).accept(smooth(0.03)) for organ in (first, second)]
    assert np.array_equal(ends[0].U, ends[1].U) and ends[0].U.size > first.start().U.size
    with pytest.raises(tissue.TissueError, match="has 7 vectors"):
        first.site_variables(replace(old[0], U=np.zeros(7)))


def test_organs_without_a_space_are_refused() -> None:
    """Independent check: lips that may touch, and nothing that holds the organ."""
    body = tissue.elasticity(block((0.03, 0.02, 0.015), 5e-3), SOFT)
    with pytest.raises(tissue.TissueError, match="not held"):
        tissue.KrylovOrgan(tissue.DynamicOrgan(body, tissue.build_sites(body, SITES)))
    wound = Wound(0.01, 0.005)
    cut = tissue.elasticity(cut_block(wound), SOFT, "P1", ("bottom",))
    with pytest.raises(tissue.TissueError, match="can touch"):
        tissue.KrylovOrgan(tissue.DynamicOrgan(cut, tissue.build_sites(cut, []), gaps=gaps_on(cut, wound)))
