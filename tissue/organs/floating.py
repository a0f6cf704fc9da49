"""An organ at rest of which a body may be held by nothing but stitches and contact.

Where a body can still move as a rigid one, K is singular, and there is an equilibrium only where threads and contact
balance what loads it. It is found step by step (the proximal point algorithm: Rockafellar, SIAM J. Control and
Optimization 14, 1976), each of which drags the organ at where it was:

    K U⁺ + κ M (U⁺ − U) = load + Yᵀf_y + Gᵀp

The drag falls to the part κm/(κm + k) of itself in a step, by the stiffness k of what holds the body, and where it has
gone the equilibrium is that without it, whatever κ is. Along what no force acts on, the body stays where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tissue.arrays import Array
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.meshed import LinearAnswer, OrganState, TimeScheme

FIRST = 1e-2  # of the stiffness of a cube of its tissue as large: its drag where a load step begins
LATER = 1e-4  # of that stiffness: its drag from then on
SCALE = np.finfo(float).tiny


class Drag(NamedTuple):
    """A step that drags the organ at where it was with `a` times its mass [1/s²]; nothing moves."""

    a: float
    d: float = 0.0
    coefficients: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 1.0),)
    dt: float = 0.0


@dataclass(frozen=True, eq=False)
class FloatingOrgan(DynamicOrgan):
    """A linear organ at rest that need not be held; its mass gives it weight, and shares out the drag. Its state's A is
    what the drag of the last step has left of it, over the mass [m/s²]."""

    @cached_property
    def _cube(self) -> float:
        """Stiffness of a cube of the organ's tissue, as large as it, over its mass [1/s²]."""
        body = self.elasticity
        volume = float(body.M.sum() / 3.0 / np.mean(body.material.density))
        return float(np.mean(body.material.youngs_modulus) * np.cbrt(volume) / (body.M.sum() / 3.0))

    def drag(self, begins: bool) -> Drag:
        """Return the drag of a step, larger if a load step `begins`, because contact may not hold the body yet."""
        return Drag((FIRST if begins else LATER) * self._cube)

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> LinearAnswer:
        """Return the answer of a step from the first of `past` to the equilibrium under `share` of the loads at `time`
        [s]; where there are more, the last is that at which the load step began."""
        pairing = self.slipping_from(past[-1].U, self.paired_anew(past[0].U, past[0].ahead))
        return self.answer_paired(self.drag(len(past) == 1), past[:1], pairing, time, share)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step in which nothing moves from `y` (9p,), as the organ in motion does."""
        return super().displace(self.drag(True), state, y, f_y)

    def dragged(self, state: OrganState) -> float:
        """Return the drag that a state is under over all other forces on the organ [-]."""
        forces = (
            self.load_under(state.shares),
            self.Y.T @ state.f_y,
            self.pairing_of(state).G.T @ (self.contact_forces(state)),
        )
        return float(np.abs(self.mass_times(state.A)).sum() / max(sum(np.abs(f).sum() for f in forces), SCALE))
