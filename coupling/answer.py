"""What the thread meets of an organ's answer: the sites of the piercings, then the clamped ends, which do not give."""

from dataclasses import dataclass
from typing import Generic

import numpy as np

from coupling.arrays import Array
from coupling.bordered import NINE
from coupling.interfaces import Body
from coupling.system import System

NO_PAIRS = np.zeros(0)


def all_holds(system: System[Body], y: Array) -> Array:
    """Return the site variables of the piercings, `(9p,)`, followed by those of the clamped ends; shape `(m, 9)`."""
    return np.concatenate([y.reshape(-1, NINE), system.clamp_frames])


def pad_compliance(system: System[Body], C: Array) -> Array:
    """Return the organ's compliance over all holds, shape `(9m, 9m)`: clamped ends do not give."""
    return np.pad(C, (0, NINE * len(system.clamps))) if system.clamps else C


@dataclass(frozen=True)
class Held(Generic[Body]):
    """The answer of an organ that no force moves: its site variables `y_free` (9p,), its `state` for good."""

    y_free: Array
    state: Body

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

    def accept(self, f_y: Array, p: Array) -> Body:
        """Return the state as it was."""
        return self.state

    def again(self, f_y: Array, p: Array) -> "Held[Body]":
        """Return itself."""
        return self
