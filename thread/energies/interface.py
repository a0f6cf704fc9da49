"""The interface of an elastic energy that the thread sums."""

from typing import Any, Protocol

from thread.arrays import Array, Indices
from thread.frames import Frame


class Energy(Protocol):
    """An elastic energy, as the thread sums it: over groups of `reach` neighbouring control points.

    The energy depends on the first `seen` coordinates of a point. What the energy evaluates of an iterate, the
    argument `at` of its methods, is of its own type.
    """

    @property
    def first(self) -> Indices:
        """First control point of each group, shape `(m,)`."""

    @property
    def reach(self) -> int:
        """Control points of a group."""

    @property
    def seen(self) -> int:
        """Number of coordinates that the energy depends on, 3 or 4."""

    def evaluate(self, q: Array, frame: Frame | None) -> Any:
        """Evaluate the thread where the energy is integrated; `frame` is that of the start of the step, None
        without twist.
        """

    def energy(self, at: Any) -> float:
        """Return the energy [J]."""

    def gradient(self, at: Any) -> Array:
        """Return the derivative by the control values of each group, shape `(m, reach, seen)`."""

    def tangent(self, at: Any, N: Array) -> Array:
        """Return the second derivative, shape `(m, reach, reach, seen, seen)`.

        `N` [N] is the iterated axial force, which only an energy of stretch reads.
        """


class AxialEnergy(Energy, Protocol):
    """An energy of stretch (and of what goes with it), whose axial force Newton iterates on its own."""

    @property
    def s(self) -> Array:
        """Abscissae at which the strain is known [m]."""

    @property
    def home(self) -> Array:
        """Abscissae on the pieces of a cut thread that those of the strain are on, of the same shape [m]."""

    def next_axial_force(self, at: Any, dq: Array) -> Array:
        """Return N of the next iterate [N]: the solution of the linearised equation N/EA = ε(q)."""
