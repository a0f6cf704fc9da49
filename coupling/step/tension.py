"""The tension of the strands next to the holes, over what length the thread bends there under it, and its stretch."""

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.interfaces import Body
from coupling.kernels.steps.tension import AT_END
from coupling.system import State, System
from thread.compliance import SLACK

REST = 1e-9  # of EA: a thread under less tension than this bends over all its length
FINE = 0.5  # spans over √(EI/T) up to which a beam without tension stands for the thread
SETTLED = 1.15  # ratio of √(EI/T) at the end of a step to that which it was solved with


def strand_tensions(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return the mean axial forces `N` [N] in the parts of the thread, from hold to hold or cut, before and after every
    hold at `s` (m,) [m], shape `(m, 2)` [N]: at the hole itself the axial force is not that of the pull. The answer to
    what was asked last is remembered: the end of a step is the start of the next."""
    there = tuple(present.tolist())
    return system.recent_tensions.of((s, N), lambda: mean_forces(system, s, N, present), there)


def mean_forces(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return the mean axial forces before and after every hold, shape `(m, 2)` [N]: see `strand_tensions`."""
    bounds, part = strands(system, s, present)
    parts = len(bounds) + 1
    mean = np.bincount(part.ravel(), N.ravel(), parts) / np.maximum(np.bincount(part.ravel(), minlength=parts), 1)
    at = np.searchsorted(bounds, s)
    return np.stack([mean[at], mean[np.minimum(at + within(system, s), parts - 1)]], axis=1)


def stretches_at(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return 1 + T/EA of every hold, T the mean of the tensions before and after it, shape `(m,)` [-]; 1 of a thread
    whose spline lacks nothing at holes."""
    if not bends_at_holes(system):
        return np.ones(len(s))
    return np.asarray(1.0 + strand_tensions(system, s, N, present).mean(axis=1) / system.thread.EA)


def lengths_bent_over(system: System[Body], s: Array, N: Array, present: Flags) -> Array:
    """Return √(EI/T) of every hold, at most the thread's length, shape `(m,)` [m]. T is the larger of the mean axial
    forces in the parts of the thread before and after the hole: at the hole itself the axial force is not that of the
    pull."""
    thread = system.thread
    pull = np.maximum(strand_tensions(system, s, N, present).max(axis=1), REST * thread.EA)
    return np.asarray(np.minimum(np.sqrt(thread.EI / pull), thread.spline.end - thread.spline.start))


def strands(system: System[Body], s: Array, present: Flags) -> tuple[Array, Indices]:
    """Return the abscissae that part the thread, of its holds at `s` (m,) and its cuts, rising, `(k,)` [m], and the
    number of the part that each point is in at which the axial force is known, of the shape of that."""
    bounds = np.sort(np.append(s[present & within(system, s)], system.thread.spline.cuts))
    return bounds, np.searchsorted(bounds, system.thread.axial.s)


def within(system: System[Body], s: Array) -> Flags:
    """Return which abscissae `s` (m,) [m] part the thread: those that are neither past its ends nor at them, where
    round-off decides which."""
    spline = system.thread.spline
    near = AT_END * (spline.end - spline.start)
    return np.asarray((s > spline.start + near) & (s < spline.end - near))


def largest_pressure(system: System[Body], s: Array, N: Array, present: Flags) -> float:
    """Return the largest force by which most of a part of the thread is pressed along itself [N], 0 where none is.

    The median over a part is asked, without spans that have a hold in them: where the axial force jumps, at a hole or
    an end that was moved, that of a spline swings about it.
    """
    bounds, part = strands(system, s, present)
    spans = np.searchsorted(system.thread.spline.breaks, system.thread.axial.s)
    asked = ~np.isin(spans, np.searchsorted(system.thread.spline.breaks, bounds))
    return max([0.0, *(-float(np.median(N[asked & (part == k)])) for k in np.unique(part[asked]))])


def bends_at_holes(system: System[Body]) -> bool:
    """Whether the spline lacks compliance at holes."""
    thread = system.thread
    return bool(thread.EI != 0.0 and thread.hole_compliance and system.holds)


def layers_at(system: System[Body], s: Array, N: Array, lam: Array, present: Flags) -> Array | None:
    """Return √(EI/T) of every hold, shape `(m,)` [m], None of a thread that does not bend.

    Each strand resists the turn of a hole with √(EI T), so √T counts with its mean; where a direction is imposed on
    strands that turn by θ from each other, both together with less of that, cos ¼θ under equal tensions
    (`coupling.kernels.constraints`). Of T counts what is beyond that which spans of FINE √(EI/T) have: on shorter
    ones the compliance is that without tension.
    """
    if not bends_at_holes(system):
        return None
    thread, spline = system.thread, system.thread.spline
    T = np.maximum(strand_tensions(system, s, N, present), REST * thread.EA)
    spans = np.diff(spline.breaks)[spline.spans_of(s)]
    together = np.where(system.rows[:, 3], resisting_together(T, lam), 1.0)
    ratio = spans * np.sqrt(T).mean(axis=1) * together / np.sqrt(thread.EI)
    return np.asarray(spans / np.sqrt(np.maximum(ratio**2 - FINE**2, (0.5 * SLACK) ** 2)))


def resisting_together(T: Array, lam: Array) -> Array:
    """Return the mean, by √T, of cos ½α of strands under the tensions `T` (m, 2) [N] that turn by θ at a hole which
    holds them with λ, the first three of `lam` (m, 5) [N], shape `(m,)`: λ² = T₁² + T₂² − 2T₁T₂ cos θ.

    The thread leaves the hole by the mean of both directions by tension, and each strand by α from that: ½θ both under
    equal tensions, and one that is slack by θ, which then is not told by λ and does not count.
    """
    squares = (T**2).sum(axis=1) - (lam[:, :3] ** 2).sum(axis=1)
    theta = np.arccos(np.clip(squares / (2.0 * T[:, 0] * T[:, 1]), -1.0, 1.0))
    off = 0.5 * theta[:, None] * T[:, ::-1] / T.sum(axis=1, keepdims=True)
    return np.asarray((np.sqrt(T) * np.cos(off)).sum(axis=1) / np.sqrt(T).sum(axis=1))


def is_settled(
    system: System[Body], s: Array, present: Flags, layers: tuple[Array | None, Array | None], ratio: float
) -> bool:
    """Whether the `layers` that were solved with and those at the end are the same but for the `ratio`, or spans are
    too short for the tension to matter."""
    return change_of(system, s, present, layers) <= ratio


def change_of(system: System[Body], s: Array, present: Flags, layers: tuple[Array | None, Array | None]) -> float:
    """Return the largest ratio, of 1 or more, between the `layers` that were solved with and those at the end, of holes
    where spans are long enough for the tension to matter; infinite where one of them bends and the other not."""
    with_, ended = layers
    if with_ is None or ended is None:
        return 1.0 if with_ is ended else np.inf
    spans = np.diff(system.thread.spline.breaks)[system.thread.spline.spans_of(s)]
    matters = present & (spans > SLACK * np.minimum(with_, ended))
    return float(np.exp(np.max(np.abs(np.log(ended / with_)), where=matters, initial=0.0)))


def unsettled_layers(system: System[Body], state: State[Body]) -> float:
    """Return the part by which √(EI/T) of a state differs from that which it was solved with, at the hole where it does
    most [-]; 0 of a thread that was not solved with any."""
    if state.layers is None:
        return 0.0
    present = system.rows[:, 0] & state.present
    ended = layers_at(system, state.s, state.N, state.lam, state.present)
    return change_of(system, state.s, present, (state.layers, ended)) - 1.0
