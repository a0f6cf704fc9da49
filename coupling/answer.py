"""What the thread meets of an organ's answer: the sites of the piercings, then the clamped ends, which do not give,
and the strands of ties, which take no part in it."""

from dataclasses import dataclass
from typing import Generic

import numpy as np

from coupling.arrays import Array
from coupling.bordered import NINE
from coupling.interfaces import Body
from coupling.system import System

NO_PAIRS = np.zeros(0)
AT_TIE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0])  # x, and any u and v


def all_holds(system: System[Body], y: Array) -> Array:
    """Return the site variables of the piercings, `(9p,)`, followed by those of the clamped ends and of ties, whose
    place is left open; shape `(m, 9)`."""
    return np.concatenate([y.reshape(-1, NINE), system.clamp_frames, np.tile(AT_TIE, (2 * len(system.ties), 1))])


def pad_compliance(system: System[Body], C: Array) -> Array:
    """Return the organ's compliance over all holds, shape `(9m, 9m)`: clamped ends and ties have none."""
    return np.pad(C, (0, NINE * system.holds_off_organ)) if system.holds_off_organ else C


@dataclass(frozen=True)
class Held(Generic[Body]):
    """The answer of an organ that no force moves: its site variables `y_free` (9p,), its `state` for good."""

    y_free: Array
    state: Body

    @property
    def linear(self) -> bool:
        """Yes."""
        return True

    @property
    def C(self) -> Array:
        """Zero, shape `(9p, 9p)`."""
        return np.zeros((self.y_free.size, self.y_free.size))

    @property
    def g_free(self) -> Array:
        """No gaps, shape `(0,)`."""
        return NO_PAIRS

    @property
    def C_cy(self) -> Array:
        """No gaps, shape `(0, 9p)`."""
        return np.zeros((0, self.y_free.size))

    @property
    def C_cc(self) -> Array:
        """No gaps, shape `(0, 0)`."""
        return np.zeros((0, 0))

    @property
    def friction(self) -> Array:
        """No pairs, shape `(0,)`."""
        return NO_PAIRS

    def accept(self, f_y: Array, p: Array) -> Body:
        """Return the state as it was."""
        return self.state

    def again(self, f_y: Array, p: Array) -> "Held[Body]":
        """Return itself."""
        return self
