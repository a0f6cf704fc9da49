"""Which strands of the thread are taut: its parts from hold to hold, to an end, or to a cut.

A strand that is longer than its way sags under its weight, or bows as a column that has buckled, and swings. Once the
slack is taken up its axial force T, the median over it, rises beyond what that bears:

    becomes taut     T > EI (π/ℓ)² + w ℓ + F + SWINGING ρA v²
    becomes slack    T < ½ (w ℓ + F)

with its length ℓ. EI (π/ℓ)² is Euler's load: beyond it √(EI/T), over which a thread bends at its ends, is shorter than
ℓ/π, and tension rather than bending keeps the strand in its way. Under T = w ℓ, its weight, it sags by an eighth of its
way, under half of that by a quarter. F stretches it by STRETCHED, for a limp one without weight. One that is longer
than its way by e bears some ρA v² ℓ/e as it swings to and fro at the speed v, a root mean square. In between a strand
stays what it was, so that one which swings does not change with every swing.

A strand with an end that nothing holds does not become taut: what drags it along is but its inertia.
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.steps.tension import Along, put_bounds
from thread.kernels.loops import entry, loop, owning

SHORTEST = 2.220446049250313e-16  # of the thread's end: the least length of a strand


class Strands(NamedTuple):
    """Which strands are `taut` (k + 1,), in the order of the thread; what Euler's load of a strand is times the square
    of its length, `euler` [N m²], its `weight` per length [N/m], the force F that counts, `least` [N], and what of the
    square of its speed does, `swing` [kg/m]; whether the thread's `start` and its `end` are loose."""

    taut: Flags
    euler: float
    weight: float
    least: float
    swing: float
    start: bool
    end: bool


class Looked(NamedTuple):
    """What there is to see of k + 1 strands: the abscissae at which they end, `ends` (k + 1,) [m]; the tensions above
    which they become taut, `enough`, and below which they become slack, `least` (k + 1,) [N]; and by how many more of
    their points are beyond the one at which they change than are not, `ahead` (k + 1,)."""

    ends: Array
    enough: Array
    least: Array
    ahead: Array


@loop
def look_at(strands: Strands, along: Along, s: Array, N: Array, v: Array, present: Flags, out: Looked) -> int:
    """Write what there is to see of the strands of a thread with holds at `s` (m,) [m], the axial force N at
    `along.axial`, and the velocities `v` (n, c) of its control points into `out`; returns how many there are. Where the
    axial force jumps, at a hole, that of a spline swings about it: so a strand changes where most of its points are
    beyond the bound. Where another number of strands was taut or not, none counts as taut."""
    count = put_bounds(along, s, present, out.ends)
    out.ends[count] = along.breaks[len(along.breaks) - 1]
    known, start, point, e, g = len(strands.taut) == count + 1, along.breaks[0], 0, 0, 0
    for part in range(count + 1):
        end, square, points = out.ends[part], 0.0, 0.0
        while point < len(v) and (part == count or along.greville[point] <= end):
            square += v[point, 0] ** 2 + v[point, 1] ** 2 + v[point, 2] ** 2
            points += 1.0
            point += 1
        length = max(end - start, SHORTEST * out.ends[count])
        light = strands.weight * length + strands.least
        is_loose = is_at(along.cuts, start) or is_at(along.cuts, end)
        is_loose |= (strands.start and part == 0) or (strands.end and part == count)
        held = np.inf if is_loose else strands.euler / length**2 + strands.swing * (square / max(points, 1.0))
        out.enough[part], out.least[part], out.ahead[part] = light + held, 0.5 * light, 0.0
        is_taut = known and strands.taut[part]
        while e < len(along.axial) and (part == count or along.axial[e, g] <= end):
            beyond = N[e, g] < out.least[part] if is_taut else N[e, g] > out.enough[part]
            out.ahead[part] += 1.0 if beyond else -1.0
            g += 1
            if g == along.axial.shape[1]:
                e, g = e + 1, 0
        start = end
    return count + 1


@loop
def is_at(cuts: Array, s: float) -> bool:
    """Whether the thread is cut at an abscissa."""
    cut = False
    for c in range(len(cuts)):
        cut |= cuts[c] == s
    return cut


@owning
def is_switched(strands: Strands, along: Along, s: Array, N: Array, v: Array, present: Flags) -> bool:
    """Whether a strand is taut that was not, or the other way round, or there are more or fewer of them; the arguments
    are those of `look_at`."""
    most = len(s) + len(along.cuts) + 1
    out = Looked(np.empty(most), np.empty(most), np.empty(most), np.empty(most))
    count = look_at(strands, along, s, N, v, present, out)
    switched = count != len(strands.taut)
    for part in range(count):
        switched |= out.ahead[part] > 0.0
    return switched


look = entry(look_at)  # as Python calls it
