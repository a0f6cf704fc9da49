"""The interface of an elastic energy that the thread sums."""

from typing import Any, Protocol

from thread.arrays import Array, Indices
from thread.frames import Frame


class Energy(Protocol):
    """An elastic energy that is summed over groups of `reach` neighbouring control points.

    The energy depends on the first `seen` coordinates of a point. The evaluated iterate, the
    argument `at` of its methods, has a type of the energy's choice.
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
        """Return the thread at the integration points; `frame` is the frame at the start of the
        step, None without twist.
        """

    def energy(self, at: Any) -> float:
        """Return the energy [J]."""

    def gradient(self, at: Any) -> Array:
        """Return the derivative by the control values of each group, shape `(m, reach, seen)`."""

    def tangent(self, at: Any, N: Array) -> Array:
        """Return the second derivative, shape `(m, reach, reach, seen, seen)`.

        `N` [N] is the iterated axial force, which only an energy of stretch uses.
        """


class AxialEnergy(Energy, Protocol):
    """An energy that includes stretch; its axial force is a separate unknown of Newton's iteration."""

    @property
    def s(self) -> Array:
        """Abscissae of the strain [m]."""

    @property
    def home(self) -> Array:
        """Abscissae that identify the piece of each strain on a cut thread, with the same shape
        [m].
        """

    def next_axial_force(self, at: Any, dq: Array) -> Array:
        """Return N of the next iterate [N]: the solution of the linearised equation N/EA = ε(q)."""
