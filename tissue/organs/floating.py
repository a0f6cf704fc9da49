"""An organ at rest with a body that can be held only by stitches and contact to its other bodies.

K is singular if a body can move as a rigid body. An equilibrium then exists only if threads and
contact balance the loads. The equilibrium is found step by step (the proximal point algorithm:
Rockafellar, SIAM J. Control and Optimization 14, 1976). In each step a drag force resists the
motion away from the last state:

    K U⁺ + κ M (U⁺ − U) = load + Yᵀf_y + Gᵀp

In a step the drag falls to the fraction κm/(κm + k) of its value. m is the mass of the body, and k
the stiffness of the threads and the contact that hold it. The equilibrium without drag does not
depend on κ. In directions without any force the body stays at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissue.arrays import Array
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.meshed import LinearAnswer, OrganState, TimeScheme, refuse_loose

# Drag in the first step of a load step, over the stiffness of a cube of the same tissue and volume.
FIRST = 1e-2
LATER = 1e-4  # drag in all later steps, over that stiffness
SCALE = np.finfo(float).tiny


class Drag(NamedTuple):
    """A step without inertia, with a drag of `a` [1/s²] times the mass.

    The drag resists the motion away from the last state.
    """

    a: float
    d: float = 0.0
    coefficients: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 1.0),)
    dt: float = 0.0


@dataclass(frozen=True, eq=False)
class FloatingOrgan(DynamicOrgan):
    """A linear organ at rest of bodies that do not all need supports; one that holds all together is enough.

    Its mass gives the weight and distributes the drag. `A` of its state is the remaining drag of
    the last step divided by the mass [m/s²].
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_loose(self.elasticity)

    def drag(self, begins: bool) -> Drag:
        """Return the drag of a step.

        Its unit is the stiffness of a cube of the organ's tissue and volume, divided by the mass.
        The drag is larger if a load step `begins`, because contact may not hold the body yet.
        """
        material, mass = self.elasticity.material, float(self.elasticity.M.sum() / 3.0)
        firm = float(np.mean(material.youngs_modulus) * np.cbrt(mass / np.mean(material.density)) / mass)
        return Drag((FIRST if begins else LATER) * firm)

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> LinearAnswer:
        """Return the answer of a step from the first state of `past` to the equilibrium.

        `share` of the loads acts at `time` [s]. If `past` has several states, the last of them is
        the one at which the load step began.
        """
        pairing = self.paired_after(past, scheme)
        return self.answer_paired(self.drag(len(past) == 1), past[:1], pairing, time, share)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step without motion from `y` (9p,), as `DynamicOrgan.displace`."""
        return super().displace(self.drag(True), state, y, f_y)

    def dragged(self, state: OrganState) -> float:
        """Return the ratio of the drag on a state to all other forces on the organ [-]."""
        forces = (
            self.load_under(state.shares),
            self.Y.T @ state.f_y,
            self.pairing_of(state).G.T @ state.p,
        )
        return float(np.abs(self.mass_times(state.A)).sum() / max(sum(np.abs(f).sum() for f in forces), SCALE))
