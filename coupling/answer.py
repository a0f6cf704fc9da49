"""The organ's answer over all holds of the thread: piercings, clamped ends without compliance, and
strands of ties.

The strands of ties are not part of the organ's answer.
"""

import numpy as np

from coupling.arrays import Array
from coupling.interfaces import Body, Organ
from coupling.kernels.border import NINE
from coupling.system import System
from tissue.organs.meshed import SiteAnswer

AT_TIE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # y of a tie: x, and arbitrary u and v


def all_holds(system: System[Body], y: Array) -> Array:
    """Return the site variables of the piercings, `(9p,)`, then those of the clamped ends and ties,
    shape `(m, 9)`.

    The places of ties are zero.
    """
    if not system.holds_off_organ:
        return y.reshape(-1, NINE)
    return np.concatenate([y.reshape(-1, NINE), system.clamp_frames, np.tile(AT_TIE, (2 * len(system.ties), 1))])


def pad_compliance(system: System[Body], C: Array) -> Array:
    """Return the organ's compliance over all holds, shape `(9m, 9m)`; it is zero for clamped ends and ties."""
    return np.pad(C, (0, NINE * system.holds_off_organ)) if system.holds_off_organ else C


def hold_still(organ: Organ[Body], state: Body) -> SiteAnswer[Body]:
    """Return the answer of an organ that stays in this state under any force."""
    y = organ.site_variables(state)
    return SiteAnswer(y, lambda: np.zeros((y.size, y.size)), lambda f_y, p: state)
