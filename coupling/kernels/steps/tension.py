"""The tension of the strands next to the holes, over what length the thread bends there under it, what the spline lacks
there under that, and how far the thread is stretched.

Each strand resists the turn of a hole with √(EI T), so √T counts with its mean; where a direction is imposed on strands
that turn by θ from each other, both together with less of that, cos ¼θ under equal tensions
(`coupling.kernels.constraints`). Only what is beyond the tension that spans of FINE √(EI/T) have counts: on shorter
ones the compliance is that without tension.
"""

from math import acos, cos, exp, floor, log, log2, sqrt
from typing import Any, NamedTuple

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.iteration import Given, Knots, span_of
from thread.compliance import LACKS
from thread.kernels.loops import entry, loop, owning
from thread.kernels.vectors import Vector, dot, vector

AT_END = 1e-9  # of the thread's length: a hold nearer to an end than this is at that end
INSIDE = 1e-6  # of a span: a point of the stretch at a knot of a hole lies so far within the span that it belongs to
KNOWN, BEYOND = -1, -2
FIRST = 0


class Along(NamedTuple):
    """Abscissae of a thread [m]: the `breaks` of its spans, (spans + 1,), its `cuts` (c,), where the axial force is
    known, `axial` (k, a), and those of its control points, `greville` (n,); the weights `share` (k, a) by which an
    axial force counts in the mean of its strand."""

    breaks: Array
    cuts: Array
    axial: Array
    greville: Array
    share: Array


class Stages(NamedTuple):
    """What the spline lacks on each span at stages of √(EI/T), as far as it has been asked for
    (`thread.thread.Thread.missing_on`): `slots` (spans, k), the rows of `known` (rows, 3 derivatives, 4, 7 powers) for
    the stages from number `base` on and, last, for a slack thread; below zero where not known yet."""

    slots: Indices
    known: Array
    base: int


class Limits(NamedTuple):
    """Constants of the tension: the `least` that counts [N], spans over √(EI/T) up to which it is `fine` without and up
    to which the thread is `slack`, stages of √(EI/T) in a factor of two, EI [N m²], EA [N], the ratio at which it is
    `settled`, and passes of a step until it is left as it is, and whether the thread `bends` at all on knots that stand
    still, or `rides` on knots that travel."""

    least: float
    fine: float
    slack: float
    stages: float
    EI: float
    EA: float
    settled: float
    passes: int
    bends: bool
    rides: bool


class Pull(NamedTuple):
    """The mean axial forces before and after every hold, `T` (m, 2) [N], √(EI/T) there, `layers` (m,) [m], and the
    `stretch` 1 + T/EA (m,) [-]."""

    T: Array
    layers: Array
    stretch: Array


def within(breaks: Array, s: Any) -> Any:
    """Return whether abscissae `s` [m] part the thread: they are neither past its ends nor at them, where round-off
    decides which. Python asks this of arrays, the loops of numbers."""
    start, end = breaks[0], breaks[len(breaks) - 1]
    near = AT_END * (end - start)
    return (s > start + near) & (s < end - near)


is_within = loop(within)


@loop
def span_at(knots: Knots, given: Given, s: float, k: int) -> int:
    """Return the span that holds the abscissa s of hold k."""
    return span_of(knots.breaks, s, given.spans[k, 0], given.spans[k, 1])


@loop
def span_length(breaks: Array, s: float) -> float:
    """Return the length of the span that holds an abscissa [m]."""
    span = span_of(breaks, s, 0, len(breaks) - 2)
    return breaks[span + 1] - breaks[span]


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


@owning
def ask_tension(
    limits: Limits, along: Along, directed: Flags, s: Array, N: Array, lam: Array, present: Flags, out: Pull
) -> None:
    """Write the tension next to every hold at `s` (m,) [m], and what follows from it, into `out`; `lam` (m, 5) are the
    forces [N] and couples of the holds, which impose a direction where they are `directed`."""
    put_tensions(along, s, N, present, out.T)
    for k in range(len(s)):
        out.layers[k], out.stretch[k] = np.inf, 1.0
        if limits.rides:
            out.stretch[k] = 1.0 + 0.5 * (out.T[k, 0] + out.T[k, 1]) / limits.EA
        if limits.bends:
            put_bend(limits, along, directed[k], s[k], lam[k], k, out)


@loop
def put_bend(limits: Limits, along: Along, directed: bool, s: float, lam: Array, k: int, out: Pull) -> None:
    """Write √(EI/T) and 1 + T/EA of hold k at s [m]."""
    one, other = out.T[k, 0], out.T[k, 1]
    out.stretch[k] = 1.0 + 0.5 * (one + other) / limits.EA
    before, after, h = max(one, limits.least), max(other, limits.least), span_length(along.breaks, s)
    together = resisting_together(before, after, vector(lam, FIRST)) if directed else 1.0
    ratio = h * (0.5 * (sqrt(before) + sqrt(after))) * together / sqrt(limits.EI)
    out.layers[k] = h / sqrt(max(ratio**2 - limits.fine**2, (0.5 * limits.slack) ** 2))


@loop
def resisting_together(before: float, after: float, force: Vector) -> float:
    """Return the mean, by √T, of cos ½α of strands under two tensions T₁, T₂ [N] that turn by θ at a hole, which holds
    them with a force λ [N]: λ² = T₁² + T₂² − 2T₁T₂ cos θ.

    The thread leaves the hole by the mean of both directions by tension, and each strand by α from that: ½θ both under
    equal tensions. One that is slack leaves it by θ, which then does not follow from λ and does not count.
    """
    cosine = (before**2 + after**2 - dot(force, force)) / (2.0 * before * after)
    half = 0.5 * acos(min(max(cosine, -1.0), 1.0)) / (before + after)
    one, other = sqrt(before), sqrt(after)
    return (one * cos(half * after) + other * cos(half * before)) / (one + other)


@loop
def change_of(limits: Limits, along: Along, s: Array, here: Flags, one: Array, other: Array) -> float:
    """Return the largest ratio, of 1 or more, between two √(EI/T) of holes that are `here` and whose spans are long
    enough for the tension to matter."""
    largest = 0.0
    for k in range(len(s)):
        if here[k] and span_length(along.breaks, s[k]) > limits.slack * min(one[k], other[k]):
            largest = max(largest, abs(log(other[k] / one[k])))
    return exp(largest)


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


@loop
def forget(lack: Array) -> None:
    """Forget what the spline lacks."""
    for k in range(lack.shape[0]):
        for span in range(lack.shape[1]):
            lack[k, span, 0, 0, 0] = np.nan


@loop
def put_lack(stages: Stages, limits: Limits, h: float, span: int, layer: float, lack: Array) -> int:
    """Write what the spline lacks on a span of length h for a thread that bends over `layer` into `lack` (3, 4, 7).
    Returns KNOWN, or the number of the slot that is not, or BEYOND where there is none."""
    width, share = stages.slots.shape[1], 0.0
    lower = width - 1
    if not h < limits.slack * layer:
        stage = limits.stages * log2(layer)
        share = stage - floor(stage)
        lower = floor(stage) - stages.base
        if lower < 0 or lower + 1 >= width - 1:
            return BEYOND
    upper = lower if lower == width - 1 else lower + 1
    for slot in (lower, upper):
        if stages.slots[span, slot] < 0:
            return span * width + slot
    one, other = stages.known[stages.slots[span, lower]], stages.known[stages.slots[span, upper]]
    for derivative in range(3):
        for j in range(LACKS):
            for power in range(7):
                a, b = one[derivative, j, power], other[derivative, j, power]
                lack[derivative, j, power] = (1.0 - share) * a + share * b
    return KNOWN


@loop
def learn(stages: Stages, limits: Limits, knots: Knots, given: Given, layers: Array, s: Array) -> int:
    """Write what the spline lacks on the spans that hold the abscissae `s` (m,) [m] where it was forgotten. Returns
    what `put_lack` does."""
    for k in range(len(s)):
        span = span_at(knots, given, s[k], k)
        if np.isnan(given.lack[k, span, 0, 0, 0]):
            h = knots.breaks[span + 1] - knots.breaks[span]
            missing = put_lack(stages, limits, h, span, layers[k], given.lack[k, span])
            if missing != KNOWN:
                return missing
    return KNOWN


ask, change, pressed = entry(ask_tension), entry(change_of), entry(is_pressed)  # as Python calls them
