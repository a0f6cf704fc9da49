"""The tensions of the strands next to the holes, the stretch of the thread there, and parts of it
under compression.
"""

from typing import Any, NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from thread.kernels.loops import entry, loop, owning
from thread.kernels.records import record

AT_END = 1e-9  # of the thread's length: a hold closer to an end than this is at that end
INSIDE = 1e-6  # of a span: distance by which a stretch point at the knot of a hole is moved into its own span


@record
class Along(NamedTuple):
    """Abscissae of a thread [m].

    The `breaks` of its spans (spans + 1,), its `cuts` (c,), the points of the axial force, `axial`
    (k, a), and those of its control points, `greville` (n,). `share` (k, a) is the weight of each
    axial force in the mean of its strand.
    """

    breaks: Array
    cuts: Array
    axial: Array
    greville: Array
    share: Array


def within(breaks: Array, s: Any) -> Any:
    """Return whether holds at the abscissae `s` [m] divide the thread.

    Holds outside the thread or at its ends do not divide it; at an end round-off would decide.
    Python calls this function with arrays, and the loops with numbers.
    """
    start, end = breaks[0], breaks[len(breaks) - 1]
    near = AT_END * (end - start)
    return (s > start + near) & (s < end - near)


is_within = loop(within)


@loop
def put_bounds(along: Along, s: Array, present: Flags, bounds: Array) -> int:
    """Write the abscissae of holds and cuts that divide the thread, in rising order, into `bounds`
    (m + c,) [m].

    Returns their number.
    """
    count = len(along.cuts)
    for c in range(count):
        bounds[c] = along.cuts[c]
    for k in range(len(s)):
        if present[k] and is_within(along.breaks, s[k]):
            at = count
            while at > 0 and bounds[at - 1] > s[k]:
                bounds[at] = bounds[at - 1]
                at -= 1
            bounds[at] = s[k]
            count += 1
    return count


@owning
def put_tensions(along: Along, s: Array, N: Array, present: Flags, T: Array) -> None:
    """Write the mean axial forces before and after every hold into `T` (m, 2) [N].

    The holds are at `s` (m,) [m], and the axial forces N at `along.axial`. A mean is over the part
    of the thread next to the hole, because the axial force at the hole itself is not that of the
    pull.
    """
    axial, bounds = along.axial, np.empty(len(s) + len(along.cuts))
    count = put_bounds(along, s, present, bounds)
    mean, points, part = np.zeros(count + 1), np.zeros(count + 1), 0
    for e in range(len(axial)):
        for g in range(axial.shape[1]):
            while part < count and bounds[part] < axial[e, g]:
                part += 1
            mean[part] += along.share[e, g] * N[e, g]
            points[part] += along.share[e, g]
    for part in range(count + 1):
        mean[part] /= points[part] if points[part] > 0.0 else 1.0
    for k in range(len(s)):
        at = 0
        while at < count and bounds[at] < s[k]:
            at += 1
        T[k, 0], T[k, 1] = mean[at], mean[min(at + 1, count) if is_within(along.breaks, s[k]) else at]


@loop
def put_stretch(T: Array, EA: float, stretch: Array) -> None:
    """Write 1 + T/EA of every hold; T [N] is the mean of its two tensions in `T` (m, 2)."""
    for k in range(len(T)):
        stretch[k] = 1.0 + 0.5 * (T[k, 0] + T[k, 1]) / EA


@owning
def is_pressed(along: Along, strain: Array, borne: float, s: Array, here: Flags) -> bool:
    """Return whether a part of the thread is under compression at more than half of its points.

    A point counts if its strain is below −`borne` [-]. The holds at `s` (m,) [m] that are `here`
    divide the thread into parts. Points in spans that contain a hold do not count. At a hole, or at
    an end that was moved, the axial force jumps and that of a spline oscillates about the jump.
    """
    breaks, axial, bounds = along.breaks, along.axial, np.empty(len(s) + len(along.cuts))
    count = put_bounds(along, s, here, bounds)
    points, pressed, part, span = np.zeros(count + 1), np.zeros(count + 1), 0, 0
    for e in range(len(axial)):
        for g in range(axial.shape[1]):
            while part < count and bounds[part] < axial[e, g]:
                part += 1
            while span < len(breaks) - 2 and breaks[span + 1] < axial[e, g]:
                span += 1
            before = part > 0 and bounds[part - 1] > breaks[span]
            if not (before or (part < count and bounds[part] <= breaks[span + 1])):
                points[part] += 1.0
                pressed[part] += 0.0 if strain[e, g] >= -borne else 1.0
    squeezed = False
    for part in range(count + 1):
        squeezed |= 2.0 * pressed[part] > points[part]
    return squeezed


tensions, pressed = entry(put_tensions), entry(is_pressed)  # for Python
