"""Whether a strand of the thread becomes taut or slack (`coupling.run.tautness`)."""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.kernels.iteration import Knots
from coupling.kernels.loops import loop, owning
from coupling.kernels.steps.tension import put_bounds


class Strands(NamedTuple):
    """Which strands are `taut` (k + 1,), in the order of the thread; what Euler's load of a strand is times the square
    of its length, `euler` [N m²], its `weight` per length [N/m], the force F that counts, `least` [N], and what of the
    square of its speed does, `swing` [kg/m]; whether the thread's `start` and its `end` are loose; and the abscissae of
    its control points, `greville` (n,) [m]."""

    taut: Flags
    euler: float
    weight: float
    least: float
    swing: float
    start: bool
    end: bool
    greville: Array


@owning
def is_switched(strands: Strands, knots: Knots, axial: Array, s: Array, N: Array, v: Array, present: Flags) -> bool:
    """Whether a strand is taut that was not, or the other way round, of a thread with holds at `s` (m,) [m] and the
    axial force N at the abscissae `axial` (spans, a) [m], whose control points have the velocities `v` (n, 3) [m/s]."""
    bounds = np.empty(len(s) + 1)
    count = put_bounds(knots, s, present, bounds)
    if count + 1 != len(strands.taut):
        return True
    last = bounds[count] = knots.breaks[len(knots.breaks) - 1]
    start, point, e, g = knots.breaks[0], 0, 0, 0
    for part in range(count + 1):
        end, square, points = bounds[part], 0.0, 0.0
        while point < len(v) and (part == count or strands.greville[point] <= end):
            square += v[point, 0] ** 2 + v[point, 1] ** 2 + v[point, 2] ** 2
            points += 1.0
            point += 1
        bound = bound_of(strands, end - start, square / max(points, 1.0), part == 0, end == last, part)
        sign, ahead = -1.0 if strands.taut[part] else 1.0, 0
        while e < len(axial) and (part == count or axial[e, g] <= end):
            ahead += 1 if sign * (N[e, g] - bound) > 0.0 else -1
            g += 1
            if g == axial.shape[1]:
                e, g = e + 1, 0
        if ahead > 0:
            return True
        start = end
    return False


@loop
def bound_of(strands: Strands, length: float, square: float, first: bool, last: bool, part: int) -> float:
    """Return the tension below which a strand that is taut becomes slack, or above which one that is not becomes taut
    [N]: of a `length` [m] and a mean `square` of its speed [m²/s²], whether it is the thread's `first` or `last`."""
    light = strands.weight * length + strands.least
    if strands.taut[part]:
        return 0.5 * light
    if (strands.start and first) or (strands.end and last):
        return np.inf
    return light + strands.euler / length**2 + strands.swing * square
