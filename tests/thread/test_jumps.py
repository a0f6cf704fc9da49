"""A thread that jumps to another shape: a bow that a load presses through, and a loop that closes under twist."""

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.run.run import Run, begin
from coupling.run.watch import SHARE, TRACE
from coupling.step.stepping import bdf2_step
from tests.bounds import RESIDUAL
from tests.thread.test_twist import wave
from tests.thread.threads import ORIGIN, PP, Array, Path, X, Z, laid, uniform, without_organ
from thread.ends import Clamped, Fixed

CHORD, SHORTER = 0.1, 4e-3  # [m] between the pinned ends; what of it the thread is longer
NEAR = 0.05  # of the load at which the bow snaps: 0.03 are needed, of slopes of 0.11 and of the load that is not even


def bow(length: float) -> Path:
    """Half a wave of a sine over the chord, as long as the thread, by arc length."""
    x = np.linspace(0.0, 1.0, 2001)

    def drawn(height: float) -> tuple[Array, Array]:
        places = np.stack([CHORD * x, 0.0 * x, height * np.sin(np.pi * x)], axis=-1)
        return places, np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))

    places, s = drawn(brentq(lambda height: drawn(height)[1][-1] - length, 0.0, length))
    return lambda at: np.stack([np.interp(at, s, places[:, k]) for k in range(3)], axis=-1)


def snapping_weight() -> float:
    """Weight per length [N/m] under which a shallow pinned bow snaps.

    EI w'''' + N w'' = −p between pinned ends. The bow gives way to one side, by a whole wave, where N = 4π²EI/L²; there
    w'' = −p L²/4π²EI (1 − cos 2πx), and ½∫w'² is what the thread is longer.
    """
    return 4.0 * np.pi**2 * np.sqrt(2.0 * SHORTER / (1.0 / 12.0 + 5.0 / (8.0 * np.pi**2))) * PP.EI / CHORD**3


def loaded(share: float) -> tuple[Run, float, float]:
    """The bow after 0.16 s under a part of that weight, which leans by 1 %; its middle's height at first, and the most
    that a step made of the energy there is."""
    length = CHORD * (1.0 + SHORTER)
    g = share * snapping_weight() / PP.rhoA
    thread = uniform(length, 19, damping=20.0)
    system = without_organ(thread, (Fixed(ORIGIN), Fixed(CHORD * X)), gravity=-g * (Z + 0.01 * X))
    state = laid(system, [], bow(length))
    run, made = begin(system, state, bdf2_step), 0.0
    for _ in range(80):
        before, run = run.energies, run.step(2e-3)
        made = max(made, before.numerical_dissipation - run.energies.numerical_dissipation)
    return run, float(state.q[9, 2]), made


@pytest.mark.parametrize(("share", "through"), [(1.0 - NEAR, False), (1.0 + NEAR, True)])
def test_a_bow_of_thread_snaps_through(share: float, through: bool) -> None:
    """Independent check (a shallow pinned bow under an even load): a little less than the weight at which it gives way
    to one side leaves it standing, a little more and it hangs, as low as it stood; no step makes energy."""
    run, height, made = loaded(share)
    middle = run.state.q[9, 2]
    assert abs(middle / height - (-1.0 if through else 1.0)) <= NEAR
    assert made <= 2.0 * TRACE * run.energies.at_stake
    assert run.energies.kinetic <= 1e-2 * run.energies.elastic_thread


def test_a_loop_closes_under_twist_and_passes_through_itself() -> None:
    """Independent check (a closed curve that passes through itself loses two turns of its link): a bow between clamps,
    one of which is turned, stands up out of its plane and closes to a loop. A thread does not touch itself, so the loop
    opens on the other side, and two turns later torque and tension are what they were; what it stored is dissipated."""
    shorter, turns = 0.45, 28  # of the length; steps to a turn
    turn = np.array([[0.0, 0.0], [1e3, 1e3 * 2.0 * np.pi / (turns * 4e-3)]])
    thread = uniform(CHORD, 22, twist=True, damping=60.0)
    system = without_organ(thread, (Clamped(ORIGIN, X), Clamped((1.0 - shorter) * CHORD * X, X, turn=turn)))
    run, made, held = begin(system, laid(system, [], wave(CHORD, (1.0 - shorter) * CHORD)), bdf2_step), 0.0, []
    for _ in range(round(3.3 * turns)):
        before, run = run.energies, run.step(4e-3)
        made = max(made, before.numerical_dissipation - run.energies.numerical_dissipation)
        held.append(run.state.reaction[1, [3, 0]])
    before, closing, after = np.array(held)[[-1 - 2 * turns, round(2.1 * turns), -1]]
    assert np.abs(after / before - 1.0).max() <= NEAR
    assert closing[0] > 1.3 * before[0]
    assert made <= SHARE * run.energies.at_stake
    assert abs(run.energies.balance_error) <= RESIDUAL * run.energies.at_stake
