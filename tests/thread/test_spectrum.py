"""Small motions of a straight thread by its own mass and stiffness: Euler's loads, the notes of beams and strings."""

import numpy as np
import pytest
from scipy.linalg import eigh

from coupling.system import State, System
from tests.bounds import BUCKLING, LINEAR
from tests.thread.threads import FREE, ORIGIN, PP, X, inertia, laid, line, stiffness, straight, uniform, without_organ
from thread.ends import Clamped, End, Fixed, Free

L, N = 0.1, 40
PINNED = (Fixed(ORIGIN), Fixed(L * X))
CLAMPED_FREE = (Clamped(ORIGIN, X), Free())
CLAMPED_PINNED = (Clamped(ORIGIN, X), Fixed(L * X))
CLAMPED = (Clamped(ORIGIN, X), Clamped(L * X, X))


def held(ends: tuple[End, End]) -> tuple[System, State]:
    """A straight thread without strain."""
    system = without_organ(uniform(L, N), ends)
    state = laid(system, [], line(ORIGIN, X))
    assert np.abs(state.q - straight(system.thread.spline)).max() < 1e-9 * L
    return system, state


@pytest.mark.parametrize(
    ("ends", "c"),
    [(PINNED, 1.0), (CLAMPED_FREE, 0.25), (CLAMPED, 4.0), (CLAMPED_PINNED, 20.190729 / np.pi**2)],
    ids=["pinned", "clamped-free", "clamped", "clamped-pinned"],
)
def test_euler_loads(ends: tuple[End, End], c: float) -> None:
    """Independent check: P = c π² EI/L²; under P the stiffness K − P G first loses its hold on a motion, in both planes
    at once. For 2-0 polypropylene of 100 mm, pinned, that is 1.51452 mN."""
    system, state = held(ends)
    one = np.ones_like(state.N)
    K = stiffness(system, state, 0.0 * one)
    G = K - stiffness(system, state, -one)
    loads = 1.0 / eigh(G, K, eigvals_only=True)[::-1][:2]
    exact = c * np.pi**2 * PP.EI / L**2
    assert np.abs(loads / exact - 1.0).max() < BUCKLING
    if ends == PINNED:
        assert abs(exact - 1.51452e-3) < 1e-8


@pytest.mark.parametrize(
    ("ends", "beta"),
    [
        (CLAMPED_FREE, [1.8751041, 4.6940911, 7.8547574, 10.9955407]),
        (FREE, [4.7300407, 7.8532046, 10.9956078]),
        (CLAMPED_PINNED, [3.9266023, 7.0685827]),
    ],
    ids=["clamped-free", "free", "clamped-pinned"],
)
def test_frequencies_of_a_beam(ends: tuple[End, End], beta: list[float]) -> None:
    """Independent check: ω = (βL)² √(EI/ρA)/L², each twice; and six motions of a free one that cost nothing."""
    system, state = held(ends)
    squares = eigh(stiffness(system, state, 0.0 * state.N), inertia(system, state), eigvals_only=True)
    exact = np.repeat(beta, 2) ** 4 * PP.EI / (PP.rhoA * L**4)
    rigid = 6 if ends == FREE else 0
    assert np.abs(squares[:rigid]).max(initial=0.0) < LINEAR * squares[-1]
    bending = squares[squares > 1e-3 * exact[0]][: exact.size]
    assert np.abs(np.sqrt(bending / exact) - 1.0).max() < BUCKLING


@pytest.mark.parametrize("T", [1e-3, 0.05])
def test_notes_of_a_taut_stiff_string(T: float) -> None:
    """Independent check: ω_k = (kπ/L) √(T/ρA) √(1 + k²π² EI/(T L²)) between pins, k = 1 … 5, each twice."""
    system, state = held(PINNED)
    K = stiffness(system, state, T + 0.0 * state.N)
    squares = eigh(K, inertia(system, state), eigvals_only=True)[:10]
    k = np.repeat(np.arange(1, 6), 2) * np.pi / L
    assert np.abs(np.sqrt(squares / (k**2 * (T + k**2 * PP.EI) / PP.rhoA)) - 1.0).max() < BUCKLING


def test_note_of_a_steel_bar_in_stretch() -> None:
    """Independent check: f = c/2L between free ends, c = √(EA/ρA), and its octave; the reduced rule does not soften the
    long waves."""
    system, state = held(FREE)
    thread = system.thread
    along = np.arange(0, 3 * thread.n, 3)
    K = stiffness(system, state)[np.ix_(along, along)]
    squares = eigh(K, inertia(system, state)[np.ix_(along, along)], eigvals_only=True)[1:3]
    exact = np.array([1.0, 2.0]) * np.pi / L * np.sqrt(PP.EA / PP.rhoA)
    assert np.abs(np.sqrt(squares) / exact - 1.0).max() < BUCKLING
