"""What holds the two ends of a thread: nothing, a fixed point, a clamp, a dead load or a moving hand.

A held end of a thread with twist may turn it about its tangent too, as the fingers turn a needle.
"""

from dataclasses import dataclass, field

import numpy as np

from thread.arrays import Array
from thread.errors import ThreadError

ZERO = np.zeros(3)


@dataclass(frozen=True)
class Free:
    """Nothing holds the end."""

    def position(self, time: float) -> Array | None:
        """Prescribed position [m] at `time` [s], None where the end is free to move."""
        return None

    def angle(self, time: float) -> float | None:
        """Prescribed angle of the section about the tangent [rad], right-handed towards rising s, None where no torque
        holds it. It matters to a thread with twist alone."""
        return None

    def force(self, time: float) -> Array:
        """Dead load [N] at `time` [s]."""
        return ZERO


@dataclass(frozen=True)
class Turning(Free):
    """An end that a hand may turn: `turn`, shape `(k, 2)`: t [s], angle [rad] about the tangent, linear in between,
    zero at the start; None: it turns freely. Where the tangent moves, the angle is measured from a frame that goes with
    it without spinning (`thread.frames`)."""

    turn: Array | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.turn is None:
            return
        if self.turn.ndim != 2 or self.turn.shape[1] != 2 or not np.all(np.isfinite(self.turn)):
            raise ThreadError(f"end: turn of shape {self.turn.shape}; allowed are rows of t, angle")
        if np.any(np.diff(self.turn[:, 0]) <= 0.0) or self.angle(0.0) != 0.0:
            raise ThreadError("end: the times of turn must rise, and its angle at t = 0 be 0; sort its rows")

    def angle(self, time: float) -> float | None:
        """The angle on the way at `time`, the last one afterwards [rad]."""
        return None if self.turn is None else float(np.interp(time, self.turn[:, 0], self.turn[:, 1]))


@dataclass(frozen=True)
class Fixed(Turning):
    """The end stays at `point`, shape `(3,)` [m], its tangent free."""

    point: Array

    def position(self, time: float) -> Array | None:
        """The point, at all times [m]."""
        return self.point


@dataclass(frozen=True)
class Clamped(Fixed):
    """The end stays at `point` and leaves it along `direction` (unit, towards rising s); it may stretch. Unless a
    `turn` is given, it does not turn."""

    direction: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.isclose(np.linalg.norm(self.direction), 1.0, rtol=0.0, atol=1e-12):
            raise ThreadError(f"clamped end: direction {self.direction} is not a unit vector; divide it by its length")

    def angle(self, time: float) -> float | None:
        """The angle on the way at `time`; without `turn` zero [rad]."""
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

    def force(self, time: float) -> Array:
        """The load, or the part of it that the ramp has reached [N]."""
        return self.load if time >= self.ramp else self.load * (time / self.ramp)


@dataclass(frozen=True)
class Driven(Turning):
    """A hand moves the end through `waypoints`, shape `(k, 4)`: t [s], x, y, z [m]; linear in between."""

    waypoints: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        w = self.waypoints
        if w.ndim != 2 or w.shape[1] != 4 or len(w) < 1 or not np.all(np.isfinite(w)):
            raise ThreadError(f"driven end: waypoints of shape {w.shape}; allowed are rows of t, x, y, z")
        if np.any(np.diff(w[:, 0]) <= 0.0):
            raise ThreadError("driven end: the times of the waypoints do not rise; sort them and drop repeats")

    def position(self, time: float) -> Array | None:
        """The point on the way at `time`, the last waypoint afterwards [m]."""
        w = self.waypoints
        return np.array([np.interp(time, w[:, 0], w[:, k]) for k in (1, 2, 3)])


End = Free | Fixed | Clamped | Pulled | Driven
