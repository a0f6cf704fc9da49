"""The tension of the strands next to the holes, how far the thread is stretched there, and where it is pressed."""

from typing import Any, NamedTuple

import numpy as np

from coupling.arrays import Array, Flags
from thread.kernels.loops import entry, loop, owning

AT_END = 1e-9  # of the thread's length: a hold nearer to an end than this is at that end
INSIDE = 1e-6  # of a span: a point of the stretch at a knot of a hole lies so far within the span that it belongs to


class Along(NamedTuple):
    """Abscissae of a thread [m]: the `breaks` of its spans, (spans + 1,), its `cuts` (c,), where the axial force is
    known, `axial` (k, a), and those of its control points, `greville` (n,); the weights `share` (k, a) by which an
    axial force counts in the mean of its strand."""

    breaks: Array
    cuts: Array
    axial: Array
    greville: Array
    share: Array


def within(breaks: Array, s: Any) -> Any:
    """Return whether abscissae `s` [m] part the thread: they are neither past its ends nor at them, where round-off
    decides which. Python asks this of arrays, the loops of numbers."""
    start, end = breaks[0], breaks[len(breaks) - 1]
    near = AT_END * (end - start)
    return (s > start + near) & (s < end - near)


is_within = loop(within)


@loop
def put_bounds(along: Along, s: Array, present: Flags, bounds: Array) -> int:
    """Write the abscissae that part the thread, of its holds and its cuts, rising, into `bounds` (m + c,) [m]; returns
    how many."""
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
    """Write the mean axial forces in the parts of the thread before and after every hold at `s` (m,) [m] into `T`
    (m, 2) [N], from those at `along.axial`: at the hole itself the axial force is not that of the pull."""
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
    """Write 1 + T/EA of every hold, T [N] the mean of both tensions `T` (m, 2) next to it."""
    for k in range(len(T)):
        stretch[k] = 1.0 + 0.5 * (T[k, 0] + T[k, 1]) / EA


@owning
def is_pressed(along: Along, strain: Array, borne: float, s: Array, here: Flags) -> bool:
    """Whether more than half of the points of a part of the thread are pressed along themselves to a `strain` beyond
    the one `borne` [-], the holds at `s` (m,) [m] that are `here` parting it. Spans that have a hold in them do not
    count: where the axial force jumps, at a hole or an end that was moved, that of a spline swings about it."""
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


tensions, pressed = entry(put_tensions), entry(is_pressed)  # as Python calls them
