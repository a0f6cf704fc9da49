"""Ties: two places of one thread that meet, a loop that hands draw tight and lock.

A tie joins the strands that leave two holes in opposite directions: P(s_a) − P(s_b) = d with s_a <
s_b. It is a point in space without mass and stiffness that belongs to no organ, and holds each
strand as a hole does. Its two holds are numbered after those of piercings and clamps. The organ's y
= y_free + C Φ_yᵀλ is replaced by

    x_a − x_b = d,      λ_a + λ_b = 0

which is the constraint with three multipliers. d decreases to zero while the hands bring the
strands together.

Both tails are slack where they leave the tie. One force λ is therefore that of either strand, T =
|λ|, and one equation says that the hands draw with T. The place of the knot along a straight strand
is not determined by this equation. For this reason a tie slides as one. Its loop s_b − s_a is under
the force τ = (f_b − f_a)/2, with f = Φ_sᵀλ/|T| as in `coupling.step.sliding`:

    held        s_a and s_b constant, before hands draw: only the hands keep slack strands together
    drawn       s_a + s_b constant,  τ = F + c ds_b/dt     by two equal hands, in the end with F
    kept        s_a and s_b constant,  τ > F               while F grows: hands let no thread out
    tied        s_a and s_b constant
    slips       s_a + s_b constant,  τ = σ F_hold          if a tied knot holds at most F_hold

With c = F/v the hands draw a thread without resistance at the speed v. Without c, a slack thread of
a few milligrams would reach very high speeds.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coupling.arrays import Array
from coupling.errors import CouplingError

ON_TIME = 1e-9  # of a step, or of the time in which a tie is drawn: tolerance of a time at its start or end


@dataclass(frozen=True)
class Tie:
    """A loop through the piercings number `between` (lower abscissa first), and beyond them to the tie.

    Hands bring its strands together from `begins` [s] on. Each hand draws with a force that grows
    to `force` [N] over `ramp` [s], at most at `speed` [m/s]. The tie is locked at `locks` [s], and
    then slips above `hold` [N]. If `held`, hands hold its strands together from the start until
    they draw.
    """

    name: str
    between: tuple[int, int]
    force: float
    begins: float
    locks: float
    ramp: float
    speed: float
    hold: float = np.inf
    held: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.begins < self.locks or not 0.0 <= self.ramp <= self.locks - self.begins:
            raise CouplingError(
                f"tie {self.name!r}: begins {self.begins} s, locks {self.locks} s, ramp {self.ramp} s; allowed are "
                "0 ≤ begins < locks and 0 ≤ ramp ≤ locks − begins"
            )
        if not (self.force > 0.0 and self.speed > 0.0 and self.hold > 0.0):
            raise CouplingError(
                f"tie {self.name!r}: force {self.force} N, speed {self.speed} m/s, hold {self.hold} N; all must be "
                "positive"
            )

    def is_locked(self, time: float) -> bool:
        """Return whether the tie is locked in a step from `time` [s] on."""
        return time >= self.locks - ON_TIME * (self.locks - self.begins)

    def is_drawn(self, time: float) -> bool:
        """Return whether hands draw in a step from `time` [s] on."""
        return self.has_begun(time) and not self.is_locked(time)

    def has_begun(self, time: float) -> bool:
        """Return whether hands have begun to draw at `time` [s]."""
        return time >= self.begins - ON_TIME * (self.locks - self.begins)

    def share(self, time: float) -> float:
        """Return the part of its force with which the loop is drawn at `time` [s].

        It is also the part of the way that its strands have moved together.
        """
        if not self.has_begun(time):
            return 0.0
        grown = (time - self.begins) / self.ramp if self.ramp > 0.0 else np.inf
        return 1.0 if grown > 1.0 - ON_TIME else max(grown, 0.0)

    def drawing_force(self, time: float) -> float:
        """Return the force of each hand at `time` [s], in N."""
        return self.force * self.share(time)


def gap_left(ties: Sequence[Tie], gaps: Array, earlier: float, later: float) -> Array:
    """Return the remaining gaps at `later` [s] of the `gaps` (t, 3) [m] between the strands at `earlier` [s]."""
    before, after = (np.array([1.0 - tie.share(time) for tie in ties]) for time in (earlier, later))
    return gaps * np.divide(after, before, out=np.zeros_like(after), where=before > 0.0)[:, None]
