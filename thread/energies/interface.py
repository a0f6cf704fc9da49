"""What the thread asks of an elastic energy."""

from typing import Any, Protocol

from thread.arrays import Array, Indices
from thread.frames import Frame


class Energy(Protocol):
    """An elastic energy, as the thread sums it: over groups of `reach` neighbouring control points.

    Of the coordinates of a point it sees the first `seen`. What it needs of an iterate is its own (`at`).
    """

    @property
    def first(self) -> Indices:
        """First control point of each group, shape `(m,)`."""

    @property
    def reach(self) -> int:
        """Control points of a group."""

    @property
    def seen(self) -> int:
        """Coordinates that it depends on, 3 or 4."""

    def evaluate(self, q: Array, frame: Frame | None) -> Any:
        """The thread where the energy is taken; `frame` is that of the start of the step."""

    def energy(self, at: Any) -> float:
        """Energy [J]."""

    def gradient(self, at: Any) -> Array:
        """Derivative by the control values of each group, shape `(m, reach, seen)`."""

    def tangent(self, at: Any, N: Array) -> Array:
        """Second derivative, shape `(m, reach, reach, seen, seen)`, at the iterated axial force `N` where it has
        one."""


class AxialEnergy(Energy, Protocol):
    """An energy of stretch (and of what goes with it), whose axial force Newton iterates on its own."""

    @property
    def s(self) -> Array:
        """Abscissae at which the strain is known [m]."""

    def next_axial_force(self, at: Any, dq: Array) -> Array:
        """N of the next iterate: the solution of its own linearised equation N/EA = ε(q) [N]."""
