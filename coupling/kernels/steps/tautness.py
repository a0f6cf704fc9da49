"""The taut strands of the thread. A strand is its part between two holes, or up to an end or a cut.

A strand that is longer than its way sags under its weight, or bows like a buckled column, and
swings. When the slack is gone, its axial force T, the median over its points, exceeds these
effects:

    becomes taut     T > EI (π/ℓ)² + w ℓ + F + SWINGING ρA v²
    becomes slack    T < ½ (w ℓ + F)

Here ℓ is its length. EI (π/ℓ)² is Euler's load. Above this load √(EI/T), the length over which a
thread bends at its ends, is shorter than ℓ/π; tension and not bending then keeps the strand in its
way. Under T = w ℓ, its weight, it sags by an eighth of its way, and under half of that by a
quarter.

F stretches the strand by STRETCHED; it is the bound of a limp strand without weight. A strand
longer than its way by e has about ρA v² ℓ/e as it swings at the root mean square speed v. Between
the two bounds a strand keeps its state, so that a swinging strand does not change with every swing.

A strand with a loose end does not become taut: only its inertia resists the pull.
"""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.steps.tension import Along, put_bounds
from thread.kernels.loops import entry, loop, owning
from thread.kernels.records import record

SHORTEST = 2.220446049250313e-16  # of the abscissa of the thread's end: least length of a strand


@record
class Strands(NamedTuple):
    """The strands of a thread, for the check of tautness.

    - `taut` (k + 1,): the taut strands, in the order of the thread.
    - `euler` [N m²]: Euler's load of a strand times its length squared.
    - `weight` [N/m]: weight per length.
    - `least` [N]: the force F.
    - `swing` [kg/m]: factor of the squared speed.
    - `start`, `end`: whether the ends of the thread are loose.
    """

    taut: Flags
    euler: float
    weight: float
    least: float
    swing: float
    start: bool
    end: bool


class Looked(NamedTuple):
    """The data of k + 1 strands.

    - `ends` (k + 1,) [m]: abscissae at which they end.
    - `enough`, `least` (k + 1,) [N]: tensions above which they become taut, and below which they
      become slack.
    - `ahead` (k + 1,): number of their points beyond the bound of a change minus the number of the
      other points.
    """

    ends: Array
    enough: Array
    least: Array
    ahead: Array


@loop
def look_at(strands: Strands, along: Along, s: Array, N: Array, v: Array, present: Flags, out: Looked) -> int:
    """Write the data of the strands of a thread into `out`. Returns the number of strands.

    The holds are at `s` (m,) [m], N is the axial force at `along.axial`, and `v` (n, c) are the
    velocities of the control points. At a hole the axial force jumps and that of a spline
    oscillates about the jump; for this reason a strand changes only if most of its points are
    beyond the bound. If the number of strands has changed, no strand counts as taut.
    """
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
    """Return whether the thread is cut at an abscissa."""
    cut = False
    for c in range(len(cuts)):
        cut |= cuts[c] == s
    return cut


@owning
def is_switched(strands: Strands, along: Along, s: Array, N: Array, v: Array, present: Flags) -> bool:
    """Return whether a strand became taut or slack, or the number of strands changed.

    The arguments are those of `look_at`.
    """
    most = len(s) + len(along.cuts) + 1
    out = Looked(np.empty(most), np.empty(most), np.empty(most), np.empty(most))
    count = look_at(strands, along, s, N, v, present, out)
    switched = count != len(strands.taut)
    for part in range(count):
        switched |= out.ahead[part] > 0.0
    return switched


look = entry(look_at)  # for Python
