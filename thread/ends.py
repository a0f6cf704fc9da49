"""Conditions at the two ends of a thread: free, a fixed point, a clamp, a dead load or a moving
hand.

A held end of a thread with twist can also turn the thread about its tangent, as fingers turn a
needle.
"""

from dataclasses import dataclass, field

import numpy as np

from thread.arrays import Array
from thread.errors import ThreadError

ZERO = np.zeros(3)


def check_rows(name: str, rows: Array, columns: str) -> None:
    """Raise `ThreadError` if a table does not have the given `columns`, or if the times in the
    first do not increase.
    """
    if np.shape(rows)[1:] != (len(columns.split(", ")),) or not len(rows) or not np.isfinite(rows).all():
        raise ThreadError(f"{name} of shape {np.shape(rows)}; allowed are rows of {columns}, all finite")
    if (np.diff(rows[:, 0]) <= 0.0).any():
        raise ThreadError(f"{name}: its times do not increase; sort them and remove repeated times")


@dataclass(frozen=True)
class Free:
    """An end that is free."""

    def position(self, time: float | Array) -> Array | None:
        """Return the prescribed position [m] at `time` [s], or None if the end is free to move.

        The shape is `(3,)` for one time. For several times (k,) it is `(k, 3)`, or `(3,)` if the
        position is constant.
        """
        return None

    def angle(self, time: float) -> float | None:
        """Return the prescribed angle of the section about the tangent [rad], right-handed towards
        increasing s.

        None means that no torque holds the section. Only a thread with twist uses the angle.
        """
        return None

    def force(self, time: float | Array, share: float = 1.0) -> Array:
        """Return the dead load [N] at `time` [s], shape as for `position`.

        In statics it is the load at a `share` of the load steps, which end at `time`.
        """
        return ZERO


@dataclass(frozen=True)
class Turning(Free):
    """An end that a hand can turn about the tangent.

    `turn`, shape `(k, 2)`: time [s] and angle [rad], linear in between, zero at the start; None
    means that the end turns freely. If the tangent moves, the angle is measured from a frame that
    follows the tangent without spinning (`thread.frames`).
    """

    turn: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.turn is not None:
            check_rows("end: turn", self.turn, "t, angle")
            if self.angle(0.0) != 0.0:
                raise ThreadError("end: the angle of turn at t = 0 must be 0")

    def angle(self, time: float) -> float | None:
        """Return the angle at `time` [rad], constant after the last row of `turn`; None means that
        the end turns freely.
        """
        return None if self.turn is None else float(np.interp(time, self.turn[:, 0], self.turn[:, 1]))


@dataclass(frozen=True)
class Fixed(Turning):
    """An end at a fixed `point`, shape `(3,)` [m], with a free tangent."""

    point: Array

    def position(self, time: float | Array) -> Array | None:
        """Return the point [m], the same at all times."""
        return self.point


@dataclass(frozen=True)
class Clamped(Fixed):
    """An end at a fixed `point` with the tangent `direction` (unit vector, towards increasing s);
    the thread can stretch there.

    Without a `turn` the end does not turn. Raises `ThreadError` for a direction that is not a unit
    vector.
    """

    direction: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.isclose(np.linalg.norm(self.direction), 1.0, rtol=0.0, atol=1e-12):
            raise ThreadError(f"clamped end: direction {self.direction} is not a unit vector; divide it by its length")

    def angle(self, time: float) -> float | None:
        """Return the angle at `time` [rad]; zero without a `turn`."""
        return super().angle(time) or 0.0


@dataclass(frozen=True)
class Pulled(Free):
    """A dead load on the end, `load` (3,) [N].

    Its `course` has shape `(k, 2)`: time [s] and factor [-], linear in between. None means that the
    whole load acts at all times; in statics it then grows with the load steps.
    """

    load: Array
    course: Array | None = None

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.load)):
            raise ThreadError(f"pulled end: load {self.load} N; allowed are finite numbers")
        if self.course is not None:
            check_rows("pulled end: course", self.course, "t, factor")

    def force(self, time: float | Array, share: float = 1.0) -> Array:
        """Return the load [N] times the present factor of its course."""
        if self.course is None:
            return share * self.load
        grown = np.where(np.asarray(time) > 0.0, 1.0, share)  # in an equilibrium at the start the time is 0
        return np.multiply.outer(grown * np.interp(share * time, *self.course.T), self.load)


@dataclass(frozen=True)
class Driven(Turning):
    """An end that a hand moves along `waypoints`, shape `(k, 4)`: t [s], x, y, z [m]; linear in
    between.
    """

    waypoints: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        check_rows("driven end: waypoints", self.waypoints, "t, x, y, z")

    def position(self, time: float | Array) -> Array | None:
        """Return the interpolated point at `time` [m]; after the last waypoint it is constant."""
        t, *places = self.waypoints.T
        return np.array([np.interp(time, t, each) for each in places]).T


End = Free | Fixed | Clamped | Pulled | Driven
