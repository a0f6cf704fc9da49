"""Branches of equilibria followed by arc length: a bow of thread that a soft spring presses through, and an arch of
tissue that a hand draws down by a thread of given length."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

import tissue
from coupling.errors import BranchError, EquilibriumError, SpentError, StepError
from coupling.kernels.bordered import S
from coupling.rest import branch, equilibrium
from coupling.rest.branch import Branch, follow, walk
from coupling.rest.laying import start
from coupling.run.run import Run, begin
from coupling.system import Piercing, State, System
from tests.bounds import ELASTICA_COARSE, TWO_SOLVERS
from tests.coupling.test_snapping import RISE, THICK, arch
from tests.thread.threads import Array, X, Z
from thread.catalogue import suture
from thread.ends import Driven, Fixed, Free
from thread.knots import uniform_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread
from tissue.organs.fixed import FixedAnswer
from tissue.organs.meshed import EMPTY, OrganState

PP = suture("4-0 polypropylene")
CHORD, SHORTER = 0.04, 0.02  # [m] between the pinned ends of the bow; what of it the thread is longer
SOFT, WAY = 3.0, 0.01  # m/N of the spring that presses on its middle; how far it would go without the bow [m]
SOFTER = 5e4  # times a suture: the thread then gives way by 20 mm/mN, and the arch beyond its maximum by 7
DRAWN = {
    1.0: 8e-3,
    SOFTER: 20e-3,
}  # m, by which the hand draws the arch down, twice its rise and what the thread gives way
TRAPEZOID = 5e-3  # of the work: steps of a fortieth of a curve with one maximum and one minimum


@dataclass(frozen=True)
class Press(tissue.FixedSites):
    """A linear organ: sites that give way downward alone, by a spring whose other end goes down with the loads."""

    def answer(
        self, scheme: object, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> FixedAnswer:
        free = self.y0 - share * WAY * np.eye(self.y0.size)[2]
        C = SOFT * np.diag(np.eye(self.y0.size)[2])
        return FixedAnswer(free, lambda: C, lambda f_y, p: OrganState(EMPTY, EMPTY, EMPTY, f_y))


def bow() -> tuple[Array, Array]:
    """Half a wave of a cosine over the chord, as long as the thread, with its arc length."""
    x = np.linspace(-0.5, 0.5, 2001)

    def drawn(height: float) -> tuple[Array, Array]:
        places = np.stack([CHORD * x, 0.0 * x, height * np.cos(np.pi * x)], axis=-1)
        return places, np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))

    length = CHORD * (1.0 + SHORTER)
    return drawn(brentq(lambda height: drawn(height)[1][-1] - length, 0.0, length))


def bowed() -> tuple[System[OrganState], State[OrganState]]:
    """The bow, held in its middle."""
    (places, s), length = bow(), CHORD * (1.0 + SHORTER)
    thread = Thread(Spline(uniform_knots(length, 40)), PP)
    fixed = tissue.fixed_sites([tissue.Site(tuple(places[1000]), direction=X)])
    system = System(thread, (Fixed(places[0]), Fixed(places[-1])), Press(fixed.y0), (Piercing("hole", slides=False),))
    at = gauss_rule(thread.spline, MASS_POINTS).s
    path = np.stack([np.interp(at, s, places[:, k]) for k in range(3)], axis=-1)
    return system, start(system, np.array([0.5 * length]), path, 1.0)


def force_of_elastica(height: float, near: Array) -> tuple[float, Array]:
    """Force [N] on the middle of a pinned elastica that keeps its middle level there, at a height [m]: of half of it,
    by shooting for (H, V, θ'(0)) from those near, in units of EI and half the length,

    x' = e cos θ, z' = e sin θ, θ'' = e (V cos θ − H sin θ), e = 1 + (V sin θ + H cos θ) EI/EA."""
    half = 0.5 * CHORD * (1.0 + SHORTER)
    give = PP.EI / (PP.EA * half**2)

    def bent(_: float, y: Array, H: float, V: float) -> list[float]:
        cos, sin = np.cos(y[2]), np.sin(y[2])
        e = 1.0 - (H * cos + V * sin) * give
        return [e * cos, e * sin, y[3], e * (V * cos - H * sin)]

    def missed(found: Array) -> list[float]:
        H, V, bend = found
        x, z, _, end = solve_ivp(bent, (0, 1), [0, 0, 0, bend], args=(H, V), rtol=1e-8, atol=1e-10).y[:, -1]
        return [x - 0.5 * CHORD / half, z + height / half, end]

    found = fsolve(missed, near, xtol=1e-9)
    return 2.0 * found[1] * PP.EI / half**2, found


def test_a_bow_that_is_pressed_through_is_the_elastica_beyond_its_limits_too() -> None:
    """Independent check (the pinned elastica, by shooting): under a soft spring the loads rise, fall and would have to
    rise from below nothing; at every point the bow presses back as an elastica of its height, also where its force
    falls and turns round, and the spring's length is that force's."""
    system, state = bowed()
    run = begin(system, state).load(0.05, 1.0)
    steps = list(islice(walk(Branch(system, run.state, 1.0, run.state), 1.0), 60))
    near, off, forces = np.array([-(np.pi**2) / 4.0, 0.0, -0.3]), [], []
    for step in steps:
        forces.append(step.new.lam[0, 2])
        pressed = step.new.time * WAY + SOFT * forces[-1]
        assert abs(state.y[0, 2] - step.new.y[0, 2] - pressed) <= TWO_SOLVERS * WAY
    for step in steps[::4]:
        exact, near = force_of_elastica(step.new.y[0, 2], near)
        off.append(step.new.lam[0, 2] - exact)
    times = np.array([step.new.time for step in steps])
    assert np.argmax(times) < len(times) - 20 and times[-1] < 0.6 * times.max()  # the loads fell
    assert min(forces) < -1e-3 and max(forces) > 1e-3  # its force has turned round
    assert np.abs(off).max() <= ELASTICA_COARSE * np.abs(forces).max()


def drawn_arch(softer: float = 1.0, loaded: bool = False) -> tuple[System[OrganState], Run]:
    """The arch, without its load or `loaded`, held by a thread in its middle whose other end a hand draws down, a tenth
    of the way; the thread is `softer` than a suture."""
    organ, at, length = arch(), np.array([0.0, 0.0, RISE + THICK]), 0.02
    organ = organ if loaded else replace(organ, loads=())
    thread = Thread(Spline(uniform_knots(length, 16)), replace(PP, youngs_modulus=PP.youngs_modulus / softer))
    below = at - length * Z
    hand = Driven(np.array([[0.0, *below], [1.0, *(below - DRAWN[softer] * Z)]]))
    system: Any = System(thread, (Free(), hand), organ, (Piercing("hole", slides=False, directed=False),))
    path = at - gauss_rule(thread.spline, MASS_POINTS).s[..., None] * Z
    run = begin(system, start(system, np.array([0.0]), path, 1.0))
    return system, run.load(0.1, 1.0)


def stored(run: Run) -> float:
    """Elastic energy of thread and tissue [J]."""
    return run.energies.elastic_thread + run.energies.elastic_tissue


@pytest.mark.parametrize("loaded", [False, True])
def test_a_branch_leads_where_load_steps_lead(loaded: bool) -> None:
    """Consistency check: two roads to one equilibrium, before the arch bears its most; with a load on the tissue too,
    which grows with the rest."""
    system, run = drawn_arch(loaded=loaded)
    exact = run.load(0.15, 1.0).state
    found = follow(Branch(system, run.state, 1.0, run.state), 0.15)[-1].new
    assert found.time == exact.time
    assert np.abs(found.q - exact.q).max() <= TWO_SOLVERS * RISE
    assert np.abs(found.organ.U - exact.organ.U).max() <= TWO_SOLVERS * RISE
    assert np.abs(found.reaction - exact.reaction).max() <= TWO_SOLVERS * np.abs(exact.reaction).max()


def test_a_branch_leads_past_the_limit_of_the_organ_alone_whatever_the_round_off() -> None:
    """Consistency check: at 12.9 % of the loads the tangent of the loaded arch alone is singular, and its compliance
    makes much of the round-off of forces. Starts that are 1e-13 m apart take the same steps past it."""
    system, run = drawn_arch(loaded=True)
    random = np.random.default_rng(0)
    starts = [run.state, *(replace(run.state, q=run.state.q + 1e-13 * random.standard_normal((16, 3))) for _ in "ab")]
    times = [[step.new.time for step in follow(Branch(system, state, 1.0, state), 0.15)] for state in starts]
    assert times[1:] == [pytest.approx(times[0], rel=TWO_SOLVERS)] * 2


@pytest.mark.parametrize(("softer", "share", "falls"), [(1.0, 0.8, False), (SOFTER, 0.9, True)])
def test_an_arch_is_drawn_down_beyond_what_it_bears(
    softer: float, share: float, falls: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent check (work is energy): where load steps give up, the thread of given length leads the arch on, from
    what it bears most to where it bears next to nothing and on; the tension over the way is what both have stored more,
    all along, and no joule of it is lost in a jump. The event says so, once. A hand passes the load's maximum without a
    step back, but by a thread softer than the arch is there, with which it would jump."""
    _, run = drawn_arch(softer)
    monkeypatch.setattr(equilibrium, "MOST_CORRECTIONS", 5)
    there = run.load(share, 1.0)
    assert there.state.time == share and [event.kind for event in there.events].count("branch") == 1
    assert there.fallen is not None and (there.fallen > 0.02) == falls and (there.fallen == 0.0) != falls
    states = [run.state, *(step.new for step in there.taken)]
    pull = np.array([-state.reaction[1, 2] for state in states])
    went = np.array([state.time for state in states]) * DRAWN[softer]
    assert pull.max() > 1.05 * pull[0] and pull.min() < 0.3 * pull.max() and pull[-1] > 2.0 * pull.min()
    work = np.trapezoid(pull, went)
    assert abs(stored(there) - stored(run) - work) <= TRAPEZOID * work
    audit = there.energies
    assert abs(audit.balance_error) <= TWO_SOLVERS * audit.external_work
    taken = audit.numerical_dissipation - run.energies.numerical_dissipation
    assert abs(taken) <= 0.05 * work  # by forces at the ends of 40 steps and more


def test_a_step_along_a_branch_counts_abscissae_and_stays_near() -> None:
    """Behaviour: what slides through a hole counts as long as what moves as far; an equilibrium much further away than
    was asked for lies on another branch, and a thread that has run out of a hole is on none."""
    system, run = drawn_arch()
    branch_here, step = Branch(system, run.state, 1.0, run.state), run.load(0.15, 1.0).taken[-1]
    way = branch_here.way_of(step)
    slid = np.zeros_like(way.z)
    slid[:, S] = way.scale
    assert replace(way, q=0.0 * way.q, z=slid, share=0.0).length == 1.0
    assert branch.near(branch_here, step, way.length) is step
    with pytest.raises(StepError, match="on another branch"):
        branch.near(branch_here, step, 0.1 * way.length)
    free = replace(system, piercings=[replace(system.piercings[0], slides=True)])
    beyond = replace(step, new=replace(step.new, s=step.new.s - way.scale))
    with pytest.raises(StepError, match="runs out of a hole"):
        branch.near(replace(branch_here, system=free), beyond, 10.0)


def test_a_branch_that_does_not_lead_there_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: the spring would have to be drawn back beyond its start. The error of the load steps is told
    with how far the branch led."""
    system, state = bowed()
    run = begin(system, state).load(0.05, 1.0)
    with pytest.raises(BranchError, match=r"equilibria, to 6\d.* leads back to no loads"):
        follow(Branch(system, run.state, 1.0, run.state), 1.0)

    def fails(*_: object) -> None:
        raise EquilibriumError(0.05, 0.0, "they fail", share=1.0)

    def is_spent(*_: object) -> None:
        raise SpentError(0.05, 1.0, 4000, "it slides")

    monkeypatch.setattr(branch, "load_steps", is_spent)
    with pytest.raises(SpentError, match=r"it slides; the branch beyond .* no loads at all; raise solve.load_steps"):
        run.load(1.0, 1.0)
    monkeypatch.setattr(branch, "load_steps", fails)
    with pytest.raises(
        EquilibriumError, match=r"100 % of the loads \(they fail; the branch beyond .* no loads at all\)"
    ):
        run.load(1.0, 1.0)
