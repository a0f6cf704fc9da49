"""What holds the two ends of a thread: nothing, a fixed point, a clamp, a dead load or a moving hand.

A held end of a thread with twist may also turn the thread about its tangent, as fingers turn a needle.
"""

from dataclasses import dataclass, field

import numpy as np

from thread.arrays import Array
from thread.errors import ThreadError

ZERO = np.zeros(3)


@dataclass(frozen=True)
class Free:
    """An end that nothing holds."""

    def position(self, time: float | Array) -> Array | None:
        """Return the prescribed position [m] at `time` [s], shape `(3,)`, at times (k,) `(k, 3)` or what is the same at
        all of them; None means that the end is free to move."""
        return None

    def angle(self, time: float) -> float | None:
        """Return the prescribed angle of the section about the tangent [rad], right-handed towards rising s.

        None means that no torque holds the section. Only a thread with twist reads the angle.
        """
        return None

    def force(self, time: float | Array) -> Array:
        """Return the dead load [N] at `time` [s], shape as for `position`."""
        return ZERO


@dataclass(frozen=True)
class Turning(Free):
    """An end that a hand may turn about the tangent.

    `turn`, shape `(k, 2)`: time [s] and angle [rad], linear in between, zero at the start; None means that the
    end turns freely. Where the tangent moves, the angle is measured from a frame that follows the tangent
    without spinning (`thread.frames`).
    """

    turn: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.turn is None:
            return
        if self.turn.ndim != 2 or self.turn.shape[1] != 2 or not np.all(np.isfinite(self.turn)):
            raise ThreadError(f"end: turn of shape {self.turn.shape}; allowed are rows of t, angle")
        if np.any(np.diff(self.turn[:, 0]) <= 0.0) or self.angle(0.0) != 0.0:
            raise ThreadError("end: the times of turn must rise, and its angle at t = 0 be 0; sort its rows")

    def angle(self, time: float) -> float | None:
        """Return the angle at `time` [rad], after the last row of `turn` that row's angle; None means a free turn."""
        return None if self.turn is None else float(np.interp(time, self.turn[:, 0], self.turn[:, 1]))


@dataclass(frozen=True)
class Fixed(Turning):
    """An end that stays at `point`, shape `(3,)` [m], its tangent free."""

    point: Array

    def position(self, time: float | Array) -> Array | None:
        """Return the point [m], the same at all times."""
        return self.point


@dataclass(frozen=True)
class Clamped(Fixed):
    """An end that stays at `point` and leaves it along `direction` (unit, towards rising s); the end may stretch.

    Without a `turn` the end does not turn. Raises `ThreadError` for a direction that is not a unit vector.
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
    """A dead load on the end, `load` (3,) [N], reached linearly over `ramp` [s]."""

    load: Array
    ramp: float = 0.0

    def __post_init__(self) -> None:
        if not (np.all(np.isfinite(self.load)) and 0.0 <= self.ramp < np.inf):
            raise ThreadError(
                f"pulled end: load {self.load} N, ramp {self.ramp} s; allowed are finite numbers, ramp ≥ 0"
            )

    def force(self, time: float | Array) -> Array:
        """Return the load [N], or the part of the load that the ramp has reached."""
        return np.multiply.outer(np.minimum(time / self.ramp, 1.0), self.load) if self.ramp else self.load


@dataclass(frozen=True)
class Driven(Turning):
    """An end that a hand moves through `waypoints`, shape `(k, 4)`: t [s], x, y, z [m]; linear in between."""

    waypoints: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        w = self.waypoints
        if w.ndim != 2 or w.shape[1] != 4 or len(w) < 1 or not np.isfinite(w).all():
            raise ThreadError(f"driven end: waypoints of shape {w.shape}; allowed are rows of t, x, y, z")
        if (w[1:, 0] <= w[:-1, 0]).any():
            raise ThreadError("driven end: the times of the waypoints do not rise; sort them and drop repeats")

    def position(self, time: float | Array) -> Array | None:
        """Return the point on the way at `time`, after the last waypoint that waypoint [m]."""
        t, *places = self.waypoints.T
        return np.array([np.interp(time, t, each) for each in places]).T


End = Free | Fixed | Clamped | Pulled | Driven
