"""A thread that turns at a hole with friction: when it slips, and which pull then holds which.

Balance at one hole, α and β the angles of pull T₁ and hold T₂ to the tangent (F1 where both are θ/2):

    along  T₁ cos α − T₂ cos β = f,   across  T₁ sin α + T₂ sin β = N,   slip: f = μN
    T₁/T₂ = (cos β + μ sin β)/(cos α − μ sin α)

So it is for a straight rod in a hole, whose tangent is where it is put. A thread that bends finds its own tangent: in a
ring M = √(2 EI T (1 − cos)) is the same on both sides (elastica), hence T₁ (1 − cos α) = T₂ (1 − cos β) and with the
balance T₁ − T₂ = f: sliding on, it gains T₁ − T₂ a metre and loses just f. Where a sleeve holds the tangent, M jumps
and its force (M₊² − M₋²)/2EI makes up the same: T₁ − T₂ = f for any α, β. So

    T₁/T₂ = (1 + μ sin β)/(1 − μ sin α)       a thread that bends
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.reports.observation import observe
from coupling.step.stepping import try_step
from coupling.system import Friction, Piercing, State, System
from tests.bounds import ORDER, RESIDUAL
from tests.thread.threads import ORIGIN, Array, Strand, X, laid, line, run, uniform, without_organ
from thread.ends import Driven, Pulled

HOLD = 0.1  # [N]
THRESHOLD = 1e-3  # of the ratio of pulls: what friction is to show
DT = 3e-3  # [s]; long, for the rod bends and that takes inertia in a first step


def along(angle: float) -> Array:
    """Unit vector at `angle` below x in the plane of x and z."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


# -- a straight rod: the tangent is where it is put --------------------------------------------------------------------


ROD = Strand(EA=1e5, EI=0.3, rhoA=1e-2)  # 0.2 g; under 1 N it bends by 1e-4


def rod(friction: Friction, alpha: float, beta: float, pull: float, hold: float = HOLD) -> tuple[System, State]:
    """A rod 20 mm long along x in a sleeve, at rest, its ends pulled out of line by the angles alpha and beta."""
    ends = (Pulled(-hold * along(-beta)), Pulled(pull * along(alpha)))
    hole = (Piercing("sleeve", friction=friction),)
    system = without_organ(uniform(0.02, 8, ROD), ends, hole, ((ORIGIN, X),))
    return system, laid(system, [0.01], line(-0.01 * X, X))


def slips(friction: Friction, alpha: float, beta: float, ratio: float, hold: float = HOLD) -> float:
    """Sign of the thread's velocity out of the pulled end after a step under pull = ratio · hold; 0: it sticks."""
    new = try_step(*rod(friction, alpha, beta, ratio * hold, hold), DT).new
    assert (new.s[0] == 0.01) == (new.sigma[0] == 0.0)
    return float(-new.sigma[0])


def rod_ratio(mu: float, alpha: float, beta: float) -> float:
    """T₁/T₂ at slip."""
    return float((np.cos(beta) + mu * np.sin(beta)) / (np.cos(alpha) - mu * np.sin(alpha)))


@pytest.mark.parametrize("turn", [30.0, 90.0, 120.0])
@pytest.mark.parametrize("mu", [0.1, 0.2, 0.3])
def test_threshold_of_slip(turn: float, mu: float) -> None:
    """Independent check (F1): (1 + μ tan θ/2)/(1 − μ tan θ/2) to 1e-3, in both senses; the static coefficient counts,
    whatever the kinetic one."""
    half = np.radians(turn) / 2
    exact = (1 + mu * np.tan(half)) / (1 - mu * np.tan(half))
    assert abs(rod_ratio(mu, half, half) / exact - 1.0) < 1e-12
    for kinetic in (mu, 0.5 * mu):
        friction = Friction(mu, kinetic)
        assert slips(friction, half, half, exact * (1 - THRESHOLD)) == 0.0
        assert slips(friction, half, half, exact * (1 + THRESHOLD)) == 1.0
        assert slips(friction, half, half, (1 + THRESHOLD) / exact) == 0.0
        assert slips(friction, half, half, (1 - THRESHOLD) / exact) == -1.0


@pytest.mark.parametrize(("alpha", "beta"), [(20.0, 50.0), (50.0, 20.0), (0.0, 60.0)])
def test_tangent_that_does_not_bisect(alpha: float, beta: float) -> None:
    """Independent check: the balance at the head of this file, to 1e-3."""
    a, b = np.radians([alpha, beta])
    exact = rod_ratio(0.25, a, b)
    assert slips(Friction(0.25, 0.2), a, b, exact * (1 - THRESHOLD)) == 0.0
    assert slips(Friction(0.25, 0.2), a, b, exact * (1 + THRESHOLD)) == 1.0


@pytest.mark.parametrize("mu", [0.2, 0.5, 1.0])
def test_locking_angle(mu: float) -> None:
    """Independent check (F1): at θ ≥ 2 atan(1/μ) no pull moves the thread; two degrees below, the pull of the law does.
    Held by a hundredth, for such pulls bend the rod."""
    lock, hold, friction = np.arctan(1 / mu), 0.01 * HOLD, Friction(mu, mu)
    for ratio in (1e1, 1e3):
        assert slips(friction, lock + 1e-3, lock + 1e-3, ratio, hold) == 0.0
    half = lock - np.radians(1.0)
    exact = rod_ratio(mu, half, half)
    assert exact > 20.0
    assert slips(friction, half, half, exact * (1 - THRESHOLD), hold) == 0.0
    assert slips(friction, half, half, exact * (1 + THRESHOLD), hold) == 1.0


def test_grip_threshold() -> None:
    """Independent check: F₀ alone holds F₀, not a thousandth more."""
    grip = 0.02
    assert slips(Friction(grip=grip), 0.0, 0.0, 1 + (1 - THRESHOLD) * grip / HOLD) == 0.0
    assert slips(Friction(grip=grip), 0.0, 0.0, 1 + (1 + THRESHOLD) * grip / HOLD) == 1.0


def test_channel_threshold() -> None:
    """Independent check: pulls T₁ and T₂ on arms a of 10 mm at 45° and 15° to the sleeve turn the rod by
    a (T₁ sin α − T₂ sin β), which the ends of a channel of length ℓ bear with that over ℓ each, up and down. Their
    halves of T₁ sin α + T₂ sin β are less, so they press with twice that, and f = μ 2a/ℓ (T₁ sin α − T₂ sin β)."""
    alpha, beta, mu, channel = np.radians(45.0), np.radians(15.0), 0.1, 5e-3
    lever = 2 * mu * 0.01 / channel
    exact = (np.cos(beta) - lever * np.sin(beta)) / (np.cos(alpha) - lever * np.sin(alpha))
    couple = 0.01 / channel * (exact * np.sin(alpha) - np.sin(beta))
    assert couple > 0.5 * (exact * np.sin(alpha) + np.sin(beta))
    assert exact / rod_ratio(mu, alpha, beta) > 1.2
    for friction in (Friction(mu, mu, channel=channel), Friction(mu, 0.0, channel=channel)):
        assert slips(friction, alpha, beta, exact * (1 - THRESHOLD)) == 0.0
        assert slips(friction, alpha, beta, exact * (1 + THRESHOLD)) == 1.0


def test_long_channel_presses_with_the_force_alone() -> None:
    """Independent check: where the halves of the force exceed the couple over the channel, both ends press to the same
    side, and together with N whatever the couple."""
    half, mu = np.radians(30.0), 0.2
    exact = rod_ratio(mu, half, half)
    for ratio, sigma in ((exact * (1 - THRESHOLD), 0.0), (exact * (1 + THRESHOLD), 1.0)):
        assert slips(Friction(mu, mu, channel=0.01), half, half, ratio) == sigma


def test_kinetic_friction_once_it_slips() -> None:
    """Independent check: past the static threshold the rod goes with (T₁ − T₂) cos θ/2 − μ_k N over its mass."""
    half, friction = np.radians(45.0), Friction(0.3, 0.1, grip=1e-3)
    pull = 1.01 * HOLD * rod_ratio(0.3, half, half) + 1e-3
    system, state = rod(friction, half, half, pull)
    steps = run(system, state, 1e-4, 20)
    force = (pull - HOLD) * np.cos(half) - 1e-3 - 0.1 * (pull + HOLD) * np.sin(half)
    mass = 0.02 * ROD.rhoA
    speed = steps[-1].new.v[:, 0].mean() - steps[9].new.v[:, 0].mean()
    assert abs(speed / (10 * 1e-4) / (force / mass) - 1.0) < 1e-3
    assert all(observe(system, state, step.new)[0].cone_residual <= RESIDUAL * pull for step in steps)


TABLE = {(0.1, 180): (1.493827, 1.393141, 1.374791), (0.2, 90): (1.393937, 1.374964, 1.370552)}


TABLE |= {(0.2, 180): (2.25, 1.943060, 1.890527), (0.3, 120): (2.013503, 1.904974, 1.881860)}


@pytest.mark.parametrize(("mu", "turn"), TABLE)
def test_contacts_in_a_row(mu: float, turn: int) -> None:
    """Independent check (F2): N rods, each held by the pull of the one before, turn by φ/N each: the ratio of the table
    for N = 2, 4, 8 to 1e-3, and its distance from e^{μφ} falls as N⁻²."""
    got = []
    for contacts, listed in zip((2, 4, 8), TABLE[mu, turn], strict=True):
        half, hold = np.radians(turn) / contacts / 2, HOLD
        for _ in range(contacts):
            hold = pull_at_slip(mu, half, hold)
        got.append(hold / HOLD)
        assert abs(got[-1] / listed - 1.0) < THRESHOLD
    error = np.array(got) - np.exp(mu * np.radians(turn))
    assert abs(np.log2(error[1] / error[2]) - 2.0) < ORDER


def pull_at_slip(mu: float, half: float, hold: float) -> float:
    """Pull that moves a rod held by `hold`: where |f| − μN, linear in the pull, has its zero, as seen while it
    sticks; a ten-thousandth on either side it sticks and slips."""
    friction = Friction(mu, mu)
    pulls, margin = np.array([1.0, 1.01]) * hold, []
    for pull in pulls:
        system, state = rod(friction, half, half, pull, hold)
        seen = observe(system, state, try_step(system, state, DT).new)[0]
        assert seen.state == "stick"
        margin.append(abs(seen.tangential_force) - mu * seen.normal_force)
    pull = pulls[0] - margin[0] * (pulls[1] - pulls[0]) / (margin[1] - margin[0])
    assert slips(friction, half, half, pull / hold * (1 - 1e-4), hold) == 0.0
    assert slips(friction, half, half, pull / hold * (1 + 1e-4), hold) == 1.0
    return float(pull)


# -- a thread that bends -----------------------------------------------------------------------------------------------


ELL = 2e-3  # √(EI/T₂) [m], four spans


@dataclass(frozen=True)
class Sliding:
    """Mean over a drawn length of two spans: ratio of the pulls, angles of pull and hold to the tangent."""

    ratio: float
    alpha: float
    beta: float


def drawn_round(turn: float, mu: float, directed: bool = False) -> Sliding:
    """A thread held by a dead load and drawn slowly round a hole at the origin."""
    arm, way, back, out = 10 * ELL, 3e-3, along(0.0), along(np.radians(turn))
    thread = uniform(2 * arm + way, 90, Strand(EA=1e4, EI=HOLD * ELL**2, rhoA=1e-5), damping=100.0)
    hand = np.array([[0.0, *((arm + way) * out)], [1.0, *((arm + 2 * way) * out)]])
    hole = (Piercing("ring", directed=directed, friction=Friction(mu, mu)),)
    site = ((ORIGIN, along(np.radians(turn) / 2)),)
    system = without_organ(thread, (Pulled(-HOLD * back), Driven(hand)), hole, site)

    def path(s: Array) -> Array:
        at = (np.asarray(s) - arm)[..., None]
        return np.where(at < 0.0, at * back, at * out)

    begun = run(system, laid(system, [arm], path), 0.05, 10)[-1].new
    span = float(np.diff(thread.spline.breaks)[0])
    seen = [measured(system, step.new) for step in run(system, begun, span / way / 8, 16)]  # two spans
    return Sliding(*np.mean(seen, axis=0))


def measured(system: System, state: State) -> tuple[float, ...]:
    """What is averaged in `Sliding`."""
    assert np.all(state.sigma == -1.0)
    hold, pull = np.linalg.norm(state.reaction, axis=1)
    tangent = observe(system, state, state)[0].tangent
    angles = np.arccos([tangent @ state.reaction[1] / pull, -tangent @ state.reaction[0] / hold])
    return float(pull / hold), *(float(angle) for angle in angles)


def ring_ratio(mu: float, turn: float) -> float:
    """T₁/T₂ of a thread that bends, round a ring by `turn` radians."""

    def jump_of_moment(alpha: float) -> float:
        beta = turn - alpha
        ratio = (1 + mu * np.sin(beta)) / (1 - mu * np.sin(alpha))
        return float(ratio * (1 - np.cos(alpha)) - (1 - np.cos(beta)))

    alpha = brentq(jump_of_moment, 1e-9, turn / 2)
    return float((1 + mu * np.sin(turn - alpha)) / (1 - mu * np.sin(alpha)))


@pytest.mark.parametrize(("turn", "mu"), [(90.0, 0.2), (30.0, 0.3)])
def test_ring(turn: float, mu: float) -> None:
    """Independent check: a thread that bends does not bisect, and slides at the ratio of the elastica, to 1e-3 on the
    mean over two spans."""
    seen = drawn_round(turn, mu)
    assert seen.beta - seen.alpha > np.radians(1.0)
    assert abs(seen.ratio / ring_ratio(mu, seen.alpha + seen.beta) - 1.0) < THRESHOLD


@pytest.mark.parametrize(("mu", "passed", "drum"), [(0.1, 8.0, 12.3), (0.2, 62.6, 152.4)])
def test_twelve_bare_holes_are_no_capstan(mu: float, passed: float, drum: float) -> None:
    """Independent check: the pulls that the guide names for twelve turns of 120°, by the law that a ring keeps; each
    turn in two halves comes nearer to the drum by three quarters of the difference."""
    turn = 2.0 * np.pi / 3.0
    assert ring_ratio(mu, turn) ** 12 == pytest.approx(passed, rel=5e-3)
    assert np.exp(12 * mu * turn) == pytest.approx(drum, rel=5e-3)
    gaps = [mu * turn - n * np.log(ring_ratio(mu, turn / n)) for n in (1, 2)]
    assert gaps[1] / gaps[0] == pytest.approx(0.25, abs=0.05)


def test_sleeve() -> None:
    """Independent check: nor does it where a sleeve holds the tangent; the configurational force is needed for it."""
    seen = drawn_round(90.0, 0.2, directed=True)
    exact = (1 + 0.2 * np.sin(seen.beta)) / (1 - 0.2 * np.sin(seen.alpha))
    assert abs(exact / rod_ratio(0.2, seen.alpha, seen.beta) - 1.0) > 0.05
    assert abs(seen.ratio / exact - 1.0) < THRESHOLD
