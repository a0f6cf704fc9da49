"""Ties: two places of one thread that meet, a loop that hands draw tight and lock.

A tie joins the strands that leave two holes away from each other: P(s_a) − P(s_b) = d with s_a < s_b. It is a point
in space that belongs to nobody, without mass and stiffness, and holds each strand as a hole does: its two holds are
numbered behind those of piercings and clamps, and in place of the organ's y = y_free + C Φ_yᵀλ there stand

    x_a − x_b = d,      λ_a + λ_b = 0

which is the constraint with three multipliers. d goes to zero while the hands bring the strands together.

Both tails are slack where they leave the tie, so one force λ is that of either strand, T = |λ|, and one equation says
that the hands draw with T; where along a straight strand the knot sits is left open by it. So a tie slides as one:
with τ = (f_b − f_a)/2 the force that its loop s_b − s_a is under, f = Φ_sᵀλ/|T| as in `coupling.step.sliding`,

    held        s_a and s_b as they were, before hands draw: at rest, where nothing else keeps slack strands together
    drawn       s_a + s_b as it was,  τ = F + c ds_b/dt     by two hands alike, in the end with F
    tied        s_a and s_b as they were
    slips       s_a + s_b as it was,  τ = σ F_hold          where a knot that is tied holds no more than F_hold

c = F/v makes the hands draw what offers no resistance at the speed v, and not as fast as milligrams of slack thread
can be thrown.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coupling.arrays import Array
from coupling.errors import CouplingError

ON_TIME = 1e-9  # of a step, or of the time in which a tie is drawn: so near an end of it a time is that end


@dataclass(frozen=True)
class Tie:
    """A loop through the piercings number `between` (lower abscissa first), and beyond, as far as the tie.

    Hands bring its strands together from `begins` [s] on and draw with a force that grows to `force` [N] over `ramp`
    [s], each at most at `speed` [m/s]; it is locked at `locks` [s], and then slips above `hold` [N].
    """

    name: str
    between: tuple[int, int]
    force: float
    begins: float
    locks: float
    ramp: float
    speed: float
    hold: float = np.inf

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
        """Whether it is locked in a step from `time` [s] on."""
        return time >= self.locks - ON_TIME * (self.locks - self.begins)

    def is_drawn(self, time: float) -> bool:
        """Whether hands draw in a step from `time` [s] on."""
        return time >= self.begins - ON_TIME * (self.locks - self.begins) and not self.is_locked(time)

    def share(self, time: float) -> float:
        """Return the part of its force with which the loop is drawn at `time` [s], which is also the part of the way
        on which its strands have come together."""
        grown = (time - self.begins) / self.ramp if self.ramp > 0.0 else np.inf
        return float(np.clip(grown, 0.0, 1.0))

    def drawing_force(self, time: float) -> float:
        """Return the force of each hand at `time` [s], in N."""
        return self.force * self.share(time)


def gap_left(ties: Sequence[Tie], gaps: Array, earlier: float, later: float) -> Array:
    """Return what is left at `later` [s] of the `gaps` (t, 3) [m] between the strands at `earlier` [s]."""
    before, after = (np.array([1.0 - tie.share(time) for tie in ties]) for time in (earlier, later))
    return gaps * np.divide(after, before, out=np.zeros_like(after), where=before > 0.0)[:, None]
