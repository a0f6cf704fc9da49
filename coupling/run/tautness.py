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

from itertools import pairwise

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.step.tension import strands, within
from coupling.system import State, System
from thread.ends import Free
from thread.vectors import dot

STRETCHED = 1e-6  # [-]: forty nanometres of a strand of 40 mm
SWINGING = 10.0  # ℓ/e down to which a slack strand that swings is none that is taut [-]


def taut_strands(system: System[Body], state: State[Body]) -> Flags:
    """Return which strands of a state are taut by their tension alone, in the order of the thread, shape `(k + 1,)`."""
    return still_taut(system, state, np.zeros(strand_count(system, state), dtype=bool))


def still_taut(system: System[Body], state: State[Body], taut: Flags) -> Flags:
    """Return which strands of a state are taut, `(k + 1,)`, of which those `taut` were before. Where the axial force
    jumps, at a hole, that of a spline swings about it: so a strand changes where it is beyond the bound at most of its
    points."""
    bounds, part = strands(system, state.s, state.present)
    enough, least = borne(system, state, bounds)
    over = state.N - np.where(taut, least, enough)[part]
    is_beyond = np.where(taut[part], over < 0.0, over > 0.0)
    beyond = np.bincount(part.ravel(), np.where(is_beyond, 1.0, -1.0).ravel(), len(taut))
    return np.asarray(taut ^ (beyond > 0.0))


def borne(system: System[Body], state: State[Body], bounds: Array) -> tuple[Array, Array]:
    """Return the tensions above which the strands of a state between `bounds` (k,) [m] become taut, and below which
    they become slack, shape `(k + 1,)` [N] each."""
    thread, spline, v = system.thread, system.thread.spline, state.v
    edges = np.concatenate([[spline.start], bounds, [spline.end]])
    length = np.maximum(edges[1:] - edges[:-1], np.finfo(float).eps * spline.end)
    light = own_load(system) * length + STRETCHED * thread.EA
    part, parts = np.searchsorted(bounds, spline.greville), len(bounds) + 1
    squares = np.bincount(part, dot(v[:, :3], v[:, :3]), parts) / np.maximum(np.bincount(part, minlength=parts), 1)
    held = thread.EI * (np.pi / length) ** 2 + SWINGING * thread.section.rhoA * squares
    return light + np.where(loose_strands(system, state, bounds), np.inf, held), 0.5 * light


def tension_over(system: System[Body], state: State[Body], s: float, taut: bool) -> float:
    """Return by how much the tension of the strand at `s` [m] is beyond where it becomes `taut`, or slack [N]: the
    median over its points."""
    bounds, part = strands(system, state.s, state.present)
    enough, least = borne(system, state, bounds)
    k = int(np.searchsorted(bounds, s))
    here = part == k
    T = float(np.median(state.N[here])) if here.any() else np.nan
    return float(T - enough[k] if taut else least[k] - T)


def own_load(system: System[Body]) -> float:
    """Return the weight of the thread per length [N/m]."""
    return float(system.thread.section.rhoA * np.linalg.norm(system.gravity))


def loose_ends(system: System[Body], state: State[Body]) -> Flags:
    """Return which ends of the thread nothing holds or pulls, no anchor at them either, and that carry no mass, shape
    `(2,)`."""
    spline, masses = system.thread.spline, system.thread.point_masses
    free = np.array([type(end) is Free and mass == 0.0 for end, mass in zip(system.ends, masses, strict=True)])
    anchors = state.s[state.present & ~system.may_slide & ~within(system, state.s)]
    half = 0.5 * (spline.start + spline.end)
    return free & ~np.array([(anchors < half).any(), (anchors > half).any()])


def loose_strands(system: System[Body], state: State[Body], bounds: Array) -> Flags:
    """Return which strands between the `bounds` (k,) [m] have a loose end, or one at a cut, shape `(k + 1,)`."""
    loose, cuts = np.zeros(len(bounds) + 1, dtype=bool), system.thread.spline.cuts
    if cuts.size:
        at = np.searchsorted(bounds, cuts)
        loose[at] = loose[at + 1] = True
    start, end = loose_ends(system, state)
    loose[0] |= start
    loose[-1] |= end
    return loose


def strand_count(system: System[Body], state: State[Body]) -> int:
    """Return the number of strands, k + 1."""
    return int(np.count_nonzero(state.present & within(system, state.s))) + system.thread.spline.pieces


def middles(system: System[Body], state: State[Body]) -> Array:
    """Return the abscissae in the middle of the strands of a state, shape `(k + 1,)` [m]."""
    spline = system.thread.spline
    edges = np.concatenate([[spline.start], strands(system, state.s, state.present)[0], [spline.end]])
    return np.asarray(0.5 * (edges[:-1] + edges[1:]))


def carried_over(earlier: System[Body], taut: Flags, old: State[Body], system: System[Body], new: State[Body]) -> Flags:
    """Return which strands of a `new` state are taut, of which those `taut` were in an `old` one shortly before, with
    other holds or cuts: each is what that was in which its middle lies."""
    before, _ = strands(earlier, old.s, old.present)
    return np.asarray(taut[np.searchsorted(before, middles(system, new))])


def strand_names(system: System[Body], state: State[Body]) -> list[tuple[str, bool]]:
    """Return the names of the strands of a state, by those of what they lie between, each with whether it lies in the
    open, not along a tract."""
    cuts = system.thread.spline.cuts
    inside = np.flatnonzero(state.present & within(system, state.s))
    names = [p.name for p in system.piercings] + ["clamp"] * len(system.clamps)
    names += [tie.name for tie in system.ties for _ in range(2)]
    along = [bool(p.tract) for p in system.piercings] + [False] * system.holds_off_organ
    bounds = [(names[k], along[k]) for k in inside] + [("cut", False)] * len(cuts)
    order = np.argsort(np.append(state.s[inside], cuts), kind="stable")
    rising = [("start", False), *(bounds[k] for k in order), ("end", False)]
    return [(f"{a}-{b}", not (one or other)) for (a, one), (b, other) in pairwise(rising)]
