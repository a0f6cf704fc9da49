"""Whether a strand of the thread becomes taut or slack (`coupling.tautness`)."""

from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from coupling.compiled.iteration import Knots
from coupling.compiled.loops import loop, owning
from coupling.compiled.steps.tension import put_bounds


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
    bounds[count] = knots.breaks[len(knots.breaks) - 1]
    squares = np.empty(count + 1)
    put_squares(strands, bounds, v, squares)
    turned, part, bound = np.zeros(count + 1), 0, bound_of(strands, knots, bounds, squares, 0)
    for e in range(len(axial)):
        for g in range(axial.shape[1]):
            while part < count and bounds[part] < axial[e, g]:
                part += 1
                bound = bound_of(strands, knots, bounds, squares, part)
            is_over = N[e, g] < bound if strands.taut[part] else N[e, g] > bound
            turned[part] += 1.0 if is_over else -1.0
    switched = False
    for part in range(count + 1):
        switched |= turned[part] > 0.0
    return switched


@loop
def put_squares(strands: Strands, bounds: Array, v: Array, squares: Array) -> None:
    """Write the mean square of the speeds of the control points in each strand into `squares` (k + 1,) [m²/s²]."""
    part, points, last = 0, 0.0, len(squares) - 1
    squares[0] = 0.0
    for i in range(len(v)):
        while part < last and bounds[part] < strands.greville[i]:
            squares[part] /= max(points, 1.0)
            part, points = part + 1, 0.0
            squares[part] = 0.0
        squares[part] += v[i, 0] ** 2 + v[i, 1] ** 2 + v[i, 2] ** 2
        points += 1.0
    squares[part] /= max(points, 1.0)
    for empty in range(part + 1, last + 1):
        squares[empty] = 0.0


@loop
def bound_of(strands: Strands, knots: Knots, bounds: Array, squares: Array, part: int) -> float:
    """Return the tension below which a strand that is taut becomes slack, or above which one that is not becomes taut
    [N]; `bounds` (m,) are the abscissae of their ends [m], `squares` (k + 1,) [m²/s²] what `put_squares` writes."""
    start, last = part == 0, bounds[part] == knots.breaks[len(knots.breaks) - 1]
    length = bounds[part] - (knots.breaks[0] if start else bounds[part - 1])
    light = strands.weight * length + strands.least
    if strands.taut[part]:
        return 0.5 * light
    if (strands.start and start) or (strands.end and last):
        return np.inf
    return light + strands.euler / length**2 + strands.swing * squares[part]
