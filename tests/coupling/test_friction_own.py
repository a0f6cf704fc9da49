"""Friction by a law of one's own: where it slips, that Coulomb's law given as one's own is Coulomb's, what is refused.

The law is Howell's of fibres and yarns, F = a Nⁿ with n < 1 (Howell & Mazur, J. Text. Inst. 44, T59, 1953), without its
infinite slope at N = 0.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import brentq

from coupling.errors import CouplingError
from coupling.interfaces import FrictionLaw
from coupling.paper.two_pass import two_pass
from coupling.step.stepping import try_step
from coupling.system import Friction
from tests.bounds import IDENTITY
from tests.coupling.test_friction_capstan import DT, HOLD, THRESHOLD, rod, slips

BEND = 1e-5  # N, below which Howell's law is made a line


@dataclass(frozen=True)
class Howell:
    """F = a ((N + N₀)ⁿ − N₀ⁿ), and `held` times that where the thread sticks."""

    a: float = 0.15
    n: float = 0.8
    held: float = 1.2

    def kinetic(self, N: float) -> float:
        """Return the force while the thread slides [N]."""
        return float(self.a * ((N + BEND) ** self.n - BEND**self.n))

    def static(self, N: float) -> float:
        """Return the largest force that holds [N]."""
        return self.held * self.kinetic(N)

    def slope(self, N: float) -> float:
        """Return dF/dN [-]."""
        return float(self.a * self.n * (N + BEND) ** (self.n - 1.0))


@dataclass(frozen=True)
class Coulomb:
    """Coulomb's law by hand."""

    static_mu: float
    kinetic_mu: float

    def kinetic(self, N: float) -> float:
        """Return the force while the thread slides [N]."""
        return self.kinetic_mu * N

    def static(self, N: float) -> float:
        """Return the largest force that holds [N]."""
        return self.static_mu * N

    def slope(self, N: float) -> float:
        """Return dF/dN [-]."""
        return self.kinetic_mu


@pytest.mark.parametrize("hold", [HOLD, 5 * HOLD])
def test_threshold_of_a_power_law(hold: float) -> None:
    """Independent check: pulls on both sides of a sleeve turned by 60° slip where their difference along it is
    F(N) of what they press across it, to 1e-3; the ratio falls as they grow, which Coulomb's does not."""
    half, law = np.radians(30.0), Howell()

    def excess(ratio: float) -> float:
        return hold * (ratio - 1) * np.cos(half) - law.static(hold * (ratio + 1) * np.sin(half))

    exact = float(brentq(excess, 1.0, 3.0))
    friction = Friction(own=law)
    assert slips(friction, half, half, exact * (1 - THRESHOLD), hold) == 0.0
    assert slips(friction, half, half, exact * (1 + THRESHOLD), hold) == 1.0
    assert slips(friction, half, half, (1 - THRESHOLD) / exact, hold * exact) == -1.0


def test_coulomb_s_law_as_one_s_own() -> None:
    """Consistency check: the same step as by coefficients, sliding and sticking, its Newton iterations with it."""
    half = np.radians(45.0)
    for ratio in (1.05, 1.8):
        system, state = rod(Friction(0.25, 0.2), half, half, ratio * HOLD)
        [hole] = system.piercings
        own = replace(system, piercings=(replace(hole, friction=Friction(own=Coulomb(0.25, 0.2))),))
        one, other = try_step(system, state, DT), try_step(own, state, DT)
        np.testing.assert_allclose(other.new.q, one.new.q, rtol=0.0, atol=IDENTITY * np.abs(one.new.q).max())
        np.testing.assert_allclose(other.new.lam, one.new.lam, rtol=0.0, atol=IDENTITY * np.abs(one.new.lam).max())
        assert other.solution.iterations == one.solution.iterations
        assert one.new.sigma == other.new.sigma


def test_laws_that_are_none_are_refused() -> None:
    """Independent check: more friction sliding than sticking, a negative one, a slope of another function, and the
    paper's two passes."""

    class Steep(Howell):
        def slope(self, N: float) -> float:
            return 2.0 * super().slope(N)

    laws: list[tuple[FrictionLaw, str]] = [
        (Howell(held=0.9), "0 ≤ kinetic ≤ static"),
        (Howell(a=-0.1), "0 ≤ kinetic ≤ static"),
        (Steep(), "return the derivative of the kinetic force"),
    ]
    for law, words in laws:
        with pytest.raises(CouplingError, match=words):
            Friction(own=law)
    system, state = rod(Friction(own=Howell()), 0.3, 0.3, 2 * HOLD)
    with pytest.raises(CouplingError, match="only have Coulomb's law"):
        two_pass(system, state, DT)
