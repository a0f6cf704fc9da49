"""The paper's algorithm of friction (§4.3) against the exact one."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from coupling.paper.two_pass import two_pass
from coupling.reports.observation import observe
from coupling.step.stepping import try_step
from coupling.system import Friction, Piercing, State, System
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.coupling.multipliers import multiplier_imbalance
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    ORIGIN,
    RADIUS,
    Strand,
    X,
    Z,
    block_organ,
    hairpin,
    hairpin_system,
    laid,
    line,
    load_step,
    uniform,
    without_organ,
)
from thread.ends import Driven, Pulled

T, DT, MASS = 0.1, 3e-3, 1e-2
converged = partial(two_pass, passes=60)


def sliding_rod(friction: Friction, half: float, pull: float, speed: float = 0.05) -> tuple[System, State]:
    """A rod along x in a sleeve, gliding towards its end at `speed`, its ends pulled out of line by `half` each."""
    back, out = np.array([np.cos(half), 0.0, np.sin(half)]), np.array([np.cos(half), 0.0, -np.sin(half)])
    thread = uniform(0.02, 8, Strand(EA=1e5, EI=0.3, rhoA=MASS / 0.02))
    hole = (Piercing("sleeve", friction=friction),)
    system = without_organ(thread, (Pulled(-T * back), Pulled(pull * out)), hole, ((ORIGIN, X),))
    state = laid(system, [0.01], line(-0.01 * X, X))
    v = np.outer(np.ones(thread.n), speed * X)
    return system, replace(state, v=v, s_dot=-speed * np.ones(1), sigma=-np.sign(speed) * np.ones(1))


@pytest.mark.parametrize(("mu", "turn"), [(0.1, 90.0), (0.2, 90.0), (0.3, 60.0)])
def test_lagged_ratios(mu: float, turn: float) -> None:
    """Independent check (F9): the second pass injects μN₀, N₀ = 2T sin(θ/2) of a thread without friction, with the
    tension T on both sides. Across the hole the tension then changes by μN₀/cos(θ/2): T₁/T₂ = 1 + 2μt where T is that
    of the hold, 1/(1 − 2μt) where it is that of the pull, t = tan(θ/2). To 1e-3, what the rod bends by."""
    half = np.radians(turn) / 2
    system, state = sliding_rod(Friction(mu, mu), half, T)
    force = abs(two_pass(system, state, DT).new.lam[0, :3] @ X)
    change, t = force / np.cos(half), np.tan(half)
    assert abs((T + change) / T / (1 + 2 * mu * t) - 1.0) < 1e-3
    assert abs(T / (T - change) * (1 - 2 * mu * t) - 1.0) < 1e-3


@pytest.mark.parametrize(("mu", "turn"), [(0.1, 90.0), (0.2, 90.0), (0.3, 60.0)])
def test_exact_ratio_of_gliding(mu: float, turn: float) -> None:
    """Independent check (F1): under the pulls (1 + μt)/(1 − μt) a rod glides on at its speed; so say the implicit law
    and the passes iterated. The paper's single correction says so too, for here both pulls are given."""
    t = np.tan(np.radians(turn) / 2)
    system, state = sliding_rod(Friction(mu, mu), np.radians(turn) / 2, T * (1 + mu * t) / (1 - mu * t))
    for step in (try_step, converged, two_pass):
        new = step(system, state, DT).new
        assert abs(new.v[:, 0].mean() / 0.05 - 1.0) < 1e-3


def hairpin_scene(friction: Friction, directed: bool = False) -> tuple[System, State]:
    """The hairpin through two rough holes of an organ, its end drawn up by a hand, its start held by a dead load."""
    end = hairpin(RADIUS, LENGTH)(np.array([LENGTH]))[0]
    hand = Driven(np.array([[0.0, *end], [0.1, *(end + 4e-3 * Z)], [0.2, *(end + 4e-3 * Z)], [0.3, *end]]))
    holes = tuple(Piercing(name, directed=directed, friction=friction) for name in ("entry", "exit"))
    system = hairpin_system(block_organ("P1", False), (Pulled(0.05 * Z), hand), 40, holes)
    return system, laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))


def run_by(step, system: System, state: State, count: int = 60) -> list[State]:  # type: ignore[no-untyped-def]
    out = [state]
    for _ in range(count):
        out.append(step(system, out[-1], 5e-3).new)
    return out[1:]


def test_iterated_passes_reach_the_implicit_answer() -> None:
    """Consistency check: through sticking, drawing, resting and returning, step for step from the same state, every
    unknown to TWO_SOLVERS (without directions: where a sleeve lets the thread snap, the passes may end in another
    equilibrium); one lagged correction is far from it. Force and moment of the multipliers vanish in both."""
    system, state = hairpin_scene(Friction(0.2, 0.2))
    words, lag = set(), 0.0
    for _ in range(60):
        exact = try_step(system, state, 5e-3).new
        close, lagged = converged(system, state, 5e-3).new, two_pass(system, state, 5e-3).new
        words |= set(exact.sigma)
        force = np.abs(exact.lam[:, :3]).max()
        assert np.array_equal(exact.sigma, close.sigma)
        assert np.abs(exact.lam[:, :3] - close.lam[:, :3]).max() <= TWO_SOLVERS * max(force, 1e-3)
        assert np.abs(exact.q - close.q).max() <= TWO_SOLVERS * LENGTH
        assert np.abs(exact.s - close.s).max() <= TWO_SOLVERS * LENGTH
        lag = max(lag, np.abs(exact.lam[:, :3] - lagged.lam[:, :3]).max() / force)
        assert multiplier_imbalance(system, lagged)[0] <= RESIDUAL * max(force, 1.0)
        state = exact
    assert words == {-1.0, 0.0, 1.0}
    assert lag > 1e-3


def test_the_lag_shows_in_the_cone() -> None:
    """Independent check: the paper's run misses the cone, the exact one does not."""
    system, state = hairpin_scene(Friction(0.3, 0.3))
    worst = {}
    for step in (two_pass, try_step):
        seen = [observe(system, state, new) for new in run_by(step, system, state, 20)]
        worst[step] = max(o.cone_residual / max(np.linalg.norm(o.force), 1e-3) for each in seen for o in each)
    assert worst[two_pass] > 1e-3
    assert worst[try_step] < TWO_SOLVERS


def test_static_is_held_and_pseudo_static_breaks_loose() -> None:
    """Independent check: from rest, below μ_s N the point is held to the last bit; above it slides under μ_s N of the
    held pass, which for a rod is that of the pass itself."""
    half, friction = np.radians(30.0), Friction(0.3, 0.1)
    exact = (1 + 0.3 * np.tan(half)) / (1 - 0.3 * np.tan(half))
    system, state = sliding_rod(friction, half, 0.999 * exact * T, 0.0)
    held = two_pass(system, state, DT)
    assert held.new.s[0] == 0.01 and held.new.sigma[0] == 0.0
    pull = 1.2 * exact * T
    system, state = sliding_rod(friction, half, pull, 0.0)
    loose = two_pass(system, state, DT).new
    assert loose.sigma[0] == -1.0
    force = (pull - T) * np.cos(half) - 0.3 * (pull + T) * np.sin(half)
    assert abs(loose.v[:, 0].mean() / (DT * force / MASS) - 1.0) < 1e-2


def test_the_lagged_mass_shivers_where_the_exact_one_stops() -> None:
    """Independent check: gliding to rest the exact rod stops once for all; the lagged one overshoots, its friction
    driving it for a step, before V_t is null."""
    friction = Friction(grip=0.01)
    back = {}
    for step in (two_pass, try_step, converged):
        system, state = sliding_rod(friction, 0.0, T, 0.0105)
        back[step] = max(new.s[0] - old.s[0] for old, new in pairs(run_by_dt(step, system, state)))
    assert back[two_pass] > 1e-4 * DT
    assert back[try_step] == 0.0
    assert back[converged] == 0.0


def pairs(states: list[State]) -> list[tuple[State, State]]:
    """Each with the next."""
    return list(pairwise(states))


def run_by_dt(step, system: System, state: State) -> list[State]:  # type: ignore[no-untyped-def]
    out = [state]
    for _ in range(20):
        out.append(step(system, out[-1], DT).new)
    return out[1:]


def test_hysteresis() -> None:
    """Independent check: drawn out and let back, the hand's pull falls by the friction of both ways before the thread
    returns, and the work of the closed loop is lost."""
    system, state = hairpin_scene(Friction(0.2, 0.2))
    states = run_by(try_step, system, state)
    pulls = np.array([np.linalg.norm(s.reaction[1]) for s in states])
    slips = np.array([s.sigma[1] for s in states])
    out, back = slips[:20] == -1.0, slips[40:] == 1.0
    assert out.any() and back.any()
    assert pulls[:20][out][-1] > 1.2 * pulls[40:][back][-1]


def test_statics_with_friction() -> None:
    """Independent check: in load steps too a hole either keeps s to the last bit within its static cone, or moved with
    the kinetic friction against it."""
    friction = Friction(0.3, 0.2)
    system, state = hairpin_scene(friction)
    moved = set()
    for share in np.linspace(0.1, 1.0, 10):
        step = load_step(system, state, share, 0.1)[-1]
        for k, seen in enumerate(observe(system, state, step.new)):
            moved.add(seen.state)
            ds = step.new.s[k] - step.old.s[k]
            assert ds == 0.0 if seen.state == "stick" else ds * step.new.sigma[k] > 0.0
            assert seen.cone_residual <= TWO_SOLVERS * np.linalg.norm(seen.force)
        state = step.new
    assert moved == {"stick", "slip"}
