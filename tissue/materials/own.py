"""A user-defined density: a function of F in Python, differentiated twice without difference
quotients.

The function is called with numbers that carry their first and second derivatives with respect to
the nine components of F (hyper-dual numbers: Fike & Alonso, AIAA 2011-886). Stress and tangent are
therefore exact to round-off. F is a `(3, 3)` array. The function can use + − * / and powers,
`np.exp`, `np.log`, `np.sqrt`, `np.trace`, `@` and `tissue.materials.own.det`:

    def mooney_rivlin(F):
        C = F.T @ F
        I1, J = np.trace(C), det(F)
        I2 = 0.5 * (I1 * I1 - np.trace(C @ C))
        return 3e3 * (I1 * J ** (-2 / 3) - 3) + 1e3 * (I2 * J ** (-4 / 3) - 3)
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError

POINTS = 2000  # differentiated together: 91 numbers per point stay in the processor's cache


class Jet:
    """Numbers at k points, `value` (k,), with their derivatives with respect to F.

    `slope` (9, k) are the first derivatives and `bend` (9, 9, k) the second ones.
    """

    __slots__ = ("bend", "slope", "value")

    def __init__(self, value: Array, slope: Array, bend: Array) -> None:
        self.value, self.slope, self.bend = value, slope, bend

    def through(self, value: Array, first: Array, second: Array) -> "Jet":
        """Return a function of this number from the value and the first and second derivative of
        the function.
        """
        bend = first * self.bend + second * (self.slope[:, None] * self.slope[None])
        return Jet(value, first * self.slope, bend)

    def __add__(self, other: Any) -> "Jet":
        """Return the sum."""
        if isinstance(other, Jet):
            return Jet(self.value + other.value, self.slope + other.slope, self.bend + other.bend)
        return Jet(self.value + other, self.slope, self.bend)

    def __mul__(self, other: Any) -> "Jet":
        """Return the product."""
        if not isinstance(other, Jet):
            return Jet(self.value * other, self.slope * other, self.bend * other)
        cross = self.slope[:, None] * other.slope[None]
        bend = self.value * other.bend + other.value * self.bend + cross + cross.swapaxes(0, 1)
        return Jet(self.value * other.value, self.value * other.slope + other.value * self.slope, bend)

    def __pow__(self, power: float) -> "Jet":
        """Return a power whose exponent is a number."""
        x, n = self.value, float(power)
        return self.through(
            x**n, n * x ** (n - 1.0), n * (n - 1.0) * x ** (n - 2.0) if n not in (0.0, 1.0) else 0.0 * x
        )

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> "Jet":
        """Return the negative."""
        return self * -1.0

    def __sub__(self, other: Any) -> "Jet":
        """Return the difference."""
        return self + -other

    def __rsub__(self, other: Any) -> "Jet":
        """Return the difference from a number."""
        return -self + other

    def __truediv__(self, other: Any) -> "Jet":
        """Return the quotient."""
        return self * other**-1 if isinstance(other, Jet) else self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> "Jet":
        """Return the quotient of a number by this one."""
        return self**-1 * other

    def exp(self) -> "Jet":
        """Return the exponential; `np.exp` calls it."""
        grown = np.exp(self.value)
        return self.through(grown, grown, grown)

    def log(self) -> "Jet":
        """Return the natural logarithm; `np.log` calls it."""
        return self.through(np.log(self.value), 1.0 / self.value, -1.0 / self.value**2)

    def sqrt(self) -> "Jet":
        """Return the square root; `np.sqrt` calls it."""
        return self**0.5


def det(F: Any) -> Any:
    """Return the determinant of a `(3, 3)` array; its numbers can carry derivatives."""
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@dataclass(frozen=True)
class Own:
    """The density that a function `W` returns for F, a `(3, 3)` array of numbers.

    W does not depend on the position.
    """

    W: Callable[[Any], Any]

    def _jets(self, F: Array) -> Jet:
        """Return W with its derivatives at points `(3, 3, k)`."""
        k = F.shape[2]
        none, seeds = np.zeros((9, 9, k)), np.repeat(np.eye(9)[:, :, None], k, axis=2)
        given = np.empty((3, 3), dtype=object)
        for n, (i, j) in enumerate(np.ndindex(3, 3)):
            given[i, j] = Jet(F[i, j], seeds[n], none)
        out = self.W(given)
        if not isinstance(out, Jet):
            raise TissueError(f"W(F) returned {type(out).__name__}: allowed is a function of F; do not convert F")
        return out

    def _by_points(self, F: Array, part: str, lead: tuple[int, ...]) -> Array:
        points = F.reshape(3, 3, -1)
        some = np.array_split(np.arange(points.shape[2]), 1 + points.shape[2] // POINTS)
        found = [getattr(self._jets(points[:, :, those]), part) for those in some]
        return np.concatenate(found, axis=-1).reshape(*lead, *F.shape[2:])

    def energy(self, F: Array) -> Array:
        """Return W, shape `(…)` [J/m³]."""
        return self._by_points(F, "value", ())

    def stress(self, F: Array) -> Array:
        """Return P, shape `(3, 3, …)` [Pa]."""
        return self._by_points(F, "slope", (3, 3))

    def tangent(self, F: Array) -> Array:
        """Return A, shape `(3, 3, 3, 3, …)` [Pa]."""
        return self._by_points(F, "bend", (3, 3, 3, 3))
