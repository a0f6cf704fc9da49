"""Over what length the thread bends at its holes, what the spline lacks there under that, and how far the thread is
stretched (`coupling.step.tension`)."""

from math import acos, cos, exp, floor, log, log2, sqrt
from typing import NamedTuple

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.kernels.iteration import Given, Knots, span_of
from coupling.kernels.loops import loop, owning
from coupling.kernels.vectors import Vector, dot, vector
from thread.compliance import LACKS

AT_END = 1e-9  # of the thread's length: a hold nearer to an end than this is at that end
KNOWN, BEYOND = -1, -2
FIRST = 0


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
    `settled`, and passes of a step until it is left as it is, and whether the thread `bends` at all."""

    least: float
    fine: float
    slack: float
    stages: float
    EI: float
    EA: float
    settled: float
    passes: int
    bends: bool


@loop
def span_at(knots: Knots, given: Given, s: float, k: int) -> int:
    """Return the span that holds the abscissa s of hold k."""
    return span_of(knots.breaks, s, given.spans[k, 0], given.spans[k, 1])


@loop
def is_within(knots: Knots, s: float) -> bool:
    """Whether an abscissa s [m] parts the thread: it is neither past its ends nor at them."""
    start, end = knots.breaks[0], knots.breaks[len(knots.breaks) - 1]
    near = AT_END * (end - start)
    return start + near < s < end - near


@loop
def put_bounds(knots: Knots, s: Array, present: Flags, bounds: Array) -> int:
    """Write the abscissae of the holds that part the thread, rising, into `bounds` (m,) [m]; returns how many."""
    count = 0
    for k in range(len(s)):
        if present[k] and is_within(knots, s[k]):
            at = count
            while at > 0 and bounds[at - 1] > s[k]:
                bounds[at] = bounds[at - 1]
                at -= 1
            bounds[at] = s[k]
            count += 1
    return count


@owning
def ask_tension(
    limits: Limits, knots: Knots, given: Given, axial: Array, s: Array, N: Array, lam: Array, present: Flags,
    layers: Array, stretch: Array,
) -> None:  # fmt: skip
    """Write √(EI/T) of every hold into `layers` (m,) [m] and 1 + T/EA into `stretch` (m,) [-]; `axial` (spans, a) [m]
    are the abscissae of N, `lam` (m, 5) the forces [N] and couples of the holds."""
    bounds = np.empty(len(s))
    count = put_bounds(knots, s, present, bounds)
    mean, points, part = np.zeros(count + 1), np.zeros(count + 1), 0
    for e in range(len(axial)):
        for g in range(axial.shape[1]):
            while part < count and bounds[part] < axial[e, g]:
                part += 1
            mean[part] += N[e, g]
            points[part] += 1.0
    for part in range(count + 1):
        mean[part] /= max(points[part], 1.0)
    for k in range(len(s)):
        at = 0
        while at < count and bounds[at] < s[k]:
            at += 1
        one, other = mean[at], mean[min(at + 1, count) if is_within(knots, s[k]) else at]
        stretch[k] = 1.0 + 0.5 * (one + other) / limits.EA
        before, after = max(one, limits.least), max(other, limits.least)
        span = span_at(knots, given, s[k], k)
        h = knots.breaks[span + 1] - knots.breaks[span]
        together = resisting_together(before, after, vector(lam[k], FIRST)) if given.directed[k] else 1.0
        ratio = h * (0.5 * (sqrt(before) + sqrt(after))) * together / sqrt(limits.EI)
        layers[k] = h / sqrt(max(ratio**2 - limits.fine**2, (0.5 * limits.slack) ** 2))


@loop
def resisting_together(before: float, after: float, force: Vector) -> float:
    """Return the mean, by √T, of cos ½α of strands under two tensions [N] that leave a hole, which holds them with a
    force [N], by α from the direction of the thread there."""
    cosine = (before**2 + after**2 - dot(force, force)) / (2.0 * before * after)
    half = 0.5 * acos(min(max(cosine, -1.0), 1.0)) / (before + after)
    one, other = sqrt(before), sqrt(after)
    return (one * cos(half * after) + other * cos(half * before)) / (one + other)


@loop
def change_of(limits: Limits, knots: Knots, given: Given, s: Array, here: Flags, one: Array, other: Array) -> float:
    """Return the largest ratio, of 1 or more, between two √(EI/T) of holes that are `here` and whose spans are long
    enough for the tension to matter."""
    largest = 0.0
    for k in range(len(s)):
        span = span_at(knots, given, s[k], k)
        h = knots.breaks[span + 1] - knots.breaks[span]
        if here[k] and h > limits.slack * min(one[k], other[k]):
            largest = max(largest, abs(log(other[k] / one[k])))
    return exp(largest)


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
