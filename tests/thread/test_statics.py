"""Static shapes of the thread against beams, the elastica and the catenary. Fixed in space, no piercing."""

import numpy as np
import pytest

from coupling.system import State, System
from tests.bounds import BUCKLING, CATENARY, ELASTICA_COARSE, ELASTICA_FINE, LINEAR, RESIDUAL, TWO_SOLVERS
from tests.thread.threads import ORIGIN, PP, Array, Path, Strand, X, Z, laid, line, load_step, uniform, without_organ
from thread.ends import Clamped, End, Fixed, Free, Pulled

ALONG_X = line(ORIGIN, X)
# Tip-loaded cantilever, PL²/EI: deflection w/L, shortening u/L, angle, M₀L/EI (Mattiasson, IJNME 1981;17:145,
# recomputed by elliptic integrals).
ELASTICA = {
    1: (0.3017208, 0.0564332, 0.4613519, 0.9435668),
    5: (0.7137915, 0.3876284, 1.2153681, 3.0618582),
    10: (0.8106090, 0.5549956, 1.4302855, 4.4500440),
}


def equilibrium(system: System, path: Path, steps: int = 1) -> State:
    """Equilibrium of a thread laid along a path, under loads that grow in steps."""
    state = laid(system, [], path)
    for k in range(1, steps + 1):
        state = load_step(system, state, k / steps, 1.0)[-1].new
    return state


def cantilever(n: int, end: End, length: float = 0.1, section: Strand = PP, gravity: float = 0.0) -> System:
    """Clamped at the origin, along x."""
    return without_organ(uniform(length, n, section), (Clamped(ORIGIN, X), end), gravity=-gravity * Z)


def elastica(n: int, k: int, length: float = 0.1, section: Strand = PP) -> tuple[System, State]:
    """The cantilever under the dead load P = k EI/L²."""
    system = cantilever(n, Pulled(k * section.EI / length**2 * Z), length, section)
    return system, equilibrium(system, ALONG_X, 4)


def tip_error(state: State, k: int, length: float = 0.1) -> float:
    """Distance of the tip from the elastica's, over the length."""
    w, u = ELASTICA[k][:2]
    return float(np.hypot(state.q[-1, 2] / length - w, 1.0 - state.q[-1, 0] / length - u))


@pytest.mark.parametrize("held", [0, 1])
def test_a_thread_held_at_one_end_alone_bears_what_draws_on_the_other(held: int) -> None:
    """Independent check: without any hole or clamp too, the strain is P/EA and the holder bears P."""
    P, L = 1e-3 * PP.EA, 0.1
    ends: list[End] = [Fixed(ORIGIN), Pulled(P * X)] if held == 0 else [Pulled(-P * X), Fixed(L * X)]
    state = equilibrium(without_organ(uniform(L, 10, PP), (ends[0], ends[1])), ALONG_X)
    length = float(np.linalg.norm(state.q[-1] - state.q[0]))
    assert length / L - 1.0 == pytest.approx(P / PP.EA, rel=1e-2)  # of Green's strain by small ones
    assert np.linalg.norm(state.reaction[held]) == pytest.approx(P, rel=TWO_SOLVERS)


@pytest.mark.parametrize("k", ELASTICA)
@pytest.mark.parametrize(("n", "bound"), [(20, ELASTICA_COARSE), (60, ELASTICA_FINE)])
def test_elastica(n: int, k: int, bound: float) -> None:
    """Independent check: tip, angle and clamping moment of the inextensible elastica. The thread is real, its stretch
    P/EA at most 6e-6: in the bound, not corrected for."""
    system, state = elastica(n, k)
    assert tip_error(state, k) < bound
    T = system.thread.spline.curve(state.q, [0.0, 0.1])[:, 1]
    assert abs(np.arctan2(T[1, 2], T[1, 0]) - ELASTICA[k][2]) < 10 * bound
    assert abs(T[0, 2]) < RESIDUAL
    P = k * PP.EI / 0.1**2
    assert np.abs(state.reaction[0] + P * Z).max() < TWO_SOLVERS * P
    moment = np.cross(system.thread.spline.curve(state.q, [0.0])[0, 1], state.lam[0, 3:] @ state.y[0, 3:].reshape(2, 3))
    assert abs(moment[1] * 0.1 / PP.EI - ELASTICA[k][3]) < 10 * bound


@pytest.mark.parametrize("n", [8, 20])
def test_cantilever_in_the_linear_range(n: int) -> None:
    """Independent check: PL³/3EI and wL⁴/8EI. A cubic holds the first; of the second the tip is exact as well."""
    L, soft = 0.1, Strand(EA=1.0)
    P = 1e-4 * soft.EI / L**2
    tip = equilibrium(cantilever(n, Pulled(P * Z), L, soft), ALONG_X).q[-1, 2]
    assert abs(tip / (P * L**3 / (3 * soft.EI)) - 1.0) < LINEAR
    g = P / (soft.rhoA * L)
    tip = equilibrium(cantilever(n, Free(), L, soft, g), ALONG_X).q[-1, 2]
    assert abs(tip / (-P * L**3 / (8 * soft.EI)) - 1.0) < LINEAR


def arc(chord: float, length: float) -> Path:
    """A circular arc that sags below its chord from the origin along x."""
    angles = np.linspace(0.01, np.pi, 200001)
    half = np.interp(-chord / length, -np.sin(angles) / angles, angles)
    radius = 0.5 * length / half

    def at(s: Array) -> Array:
        a = (2.0 * np.asarray(s) / length - 1.0) * half
        return np.stack([0.5 * chord + radius * np.sin(a), 0.0 * a, radius * (np.cos(half) - np.cos(a))], axis=-1)

    return at


@pytest.mark.parametrize(
    ("length", "sag", "H", "T_max"),
    [(1.2, 0.29234380, 0.46954152, 0.76188532), (1.5, 0.50263326, 0.30823647, 0.81086973)],
)
def test_catenary(length: float, sag: float, H: float, T_max: float) -> None:
    """Independent check: sag of the middle and pull on the ends of a chain over the span 1, at EI/(wL³) = 1e-8 and
    EA/(wL) = 1e6 (w = 1 N/m)."""
    section = Strand(diameter=1e-3, rhoA=0.1, EA=1e6 * length, EI=1e-8 * length**3)
    system = without_organ(uniform(length, 81, section), (Fixed(ORIGIN), Fixed(X)), gravity=-10.0 * Z)
    state = equilibrium(system, arc(1.0, length))
    middle = system.thread.spline.curve(state.q, [0.5 * length])[0, 0]
    assert abs(middle[0] - 0.5) < CATENARY
    assert abs(-middle[2] - sag) < CATENARY
    assert np.abs(state.reaction[:, 0] - [-H, H]).max() < CATENARY
    assert np.abs(state.reaction[:, 2] - 0.5 * length).max() < CATENARY
    assert np.abs(np.linalg.norm(state.reaction, axis=1) - T_max).max() < CATENARY


# Half a pinned column: end slope α, P/P_cr, shortening/L, deflection/L of the middle of the whole (elliptic integrals).
BUCKLED = {40: (1.063663, 0.118796, 0.211120), 90: (1.393204, 0.543053, 0.381380)}


@pytest.mark.parametrize("alpha", BUCKLED)
def test_buckled_column(alpha: int) -> None:
    """Independent check: a clamped column under a dead push, laid in a bend, settles in the bent branch of Euler's
    column; below the critical load it straightens."""
    L = 0.1
    critical = np.pi**2 * PP.EI / (4 * L**2)
    ratio, shortening, deflection = BUCKLED[alpha]
    state = equilibrium(cantilever(40, Pulled(-ratio * critical * X)), bow(L, np.radians(alpha)))
    tip = state.q[-1] / L
    assert abs(1.0 - tip[0] - shortening) < BUCKLING
    assert abs(tip[2] - 2.0 * deflection) < BUCKLING
    state = equilibrium(cantilever(40, Pulled(-0.98 * critical * X)), bow(L, np.radians(alpha)))
    assert np.abs(state.q[:, 1:]).max() < TWO_SOLVERS * L


def bow(length: float, angle: float) -> Path:
    """A quarter wave of a bow that leaves the origin along x and turns by `angle`."""
    radius = length / angle
    return lambda s: radius * np.stack([np.sin(s / radius), 0.0 * s, 1.0 - np.cos(s / radius)], axis=-1)


# The pinned column: end slope α, P/P_cr, shortening/L, deflection/L of the middle (elliptic integrals). At 130.7099°
# the ends meet.
PINNED = {
    20: (1.015397, 0.030269, 0.109707),
    40: (1.063663, 0.118796, 0.211120),
    60: (1.151720, 0.258980, 0.296604),
    80: (1.293889, 0.440604, 0.359749),
    90: (1.393204, 0.543053, 0.381380),
    120: (1.884801, 0.876840, 0.401585),
    130.7099: (2.183379, 1.000000, 0.391594),
}


@pytest.mark.parametrize("alpha", PINNED)
def test_pinned_column(alpha: float) -> None:
    """Independent check: both ends pinned and brought together, the push, the slope of the ends and the deflection; of
    a real thread, whose stretch P/EA is 1e-5 at most. Where both ends meet it costs nothing to turn it about them, and
    the push says where its axis is: in the plane that it was laid in."""
    L = 0.1
    ratio, shortening, deflection = PINNED[alpha]
    chord = (1.0 - shortening) * L
    system = without_organ(uniform(L, 40), (Fixed(ORIGIN), Fixed(chord * X)))
    state = equilibrium(system, arc(chord, L))
    push = ratio * np.pi**2 * PP.EI / L**2
    x = state.reaction[0] / np.linalg.norm(state.reaction[0]) if shortening == 1.0 else X
    assert np.abs(state.reaction / push - np.outer([1.0, -1.0], x)).max() < BUCKLING
    assert abs(x[1]) < BUCKLING and x[0] > 0.9
    z = np.array([-x[2], 0.0, x[0]])
    P, T = system.thread.spline.curve(state.q, [0.0, 0.5 * L])[:, :2].swapaxes(0, 1)
    assert abs(-P[1] @ z / L - deflection) < BUCKLING
    assert abs(np.arctan2(-T[0] @ z, T[0] @ x) - np.radians(alpha)) < BUCKLING
