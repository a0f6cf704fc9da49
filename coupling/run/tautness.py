"""The taut strands of the thread, their names, and their earlier states (`coupling.kernels.steps.tautness`)."""

from itertools import pairwise

import numpy as np

from coupling.arrays import Array, Flags
from coupling.interfaces import Body
from coupling.kernels.steps import tautness
from coupling.kernels.steps.tautness import Looked, Strands
from coupling.step.tension import along_of, within
from coupling.system import State, System
from thread.ends import Free

STRETCHED = 1e-6  # [-]: forty nanometres of a strand of 40 mm
SWINGING = 10.0  # smallest ℓ/e [-] at which a swinging slack strand is not counted as taut


def strands_of(system: System[Body], state: State[Body], taut: Flags) -> Strands:
    """Return the strands of a state, of which those in `taut` (k + 1,) are taut."""
    thread, (start, end) = system.thread, loose_ends(system, state).tolist()
    return Strands(
        taut=np.ascontiguousarray(taut),
        euler=float(thread.EI * np.pi**2),
        weight=float(thread.section.rhoA * np.linalg.norm(system.gravity)),
        least=float(STRETCHED * thread.EA),
        swing=float(SWINGING * thread.section.rhoA),
        start=start,
        end=end,
    )


def look_at(system: System[Body], state: State[Body], taut: Flags) -> Looked:
    """Return the data of the strands of a state, of which those in `taut` (k + 1,) were taut before."""
    system = system.at(state)
    along, count = along_of(system), strand_count(system, state)
    out = Looked(*np.empty((4, count)))
    s, present = np.ascontiguousarray(state.s), np.ascontiguousarray(state.present)
    N, v = np.ascontiguousarray(state.N.reshape(along.axial.shape)), np.ascontiguousarray(state.v)
    tautness.look(strands_of(system, state, taut), along, s, N, v, present, out)
    return out


def taut_strands(system: System[Body], state: State[Body]) -> Flags:
    """Return which strands of a state are taut by their tension alone, in the order of the thread,
    shape `(k + 1,)`.
    """
    return still_taut(system, state, np.zeros(strand_count(system, state), dtype=bool))


def still_taut(system: System[Body], state: State[Body], taut: Flags) -> Flags:
    """Return which strands of a state are taut, `(k + 1,)`; `taut` were so before."""
    return np.asarray(taut ^ (look_at(system, state, taut).ahead > 0.0))


def tension_over(system: System[Body], state: State[Body], s: float, taut: bool) -> float:
    """Return the excess of the tension of the strand at `s` [m] over the bound at which it becomes
    `taut`, or slack [N].

    The tension is the median over the points of the strand.
    """
    looked = look_at(system, state, np.zeros(0, dtype=bool))
    bounds = looked.ends[:-1]
    k = int(np.searchsorted(bounds, s))
    here = np.searchsorted(bounds, along_of(system.at(state)).axial).reshape(state.N.shape) == k
    T = float(np.median(state.N[here])) if here.any() else np.nan
    return float(T - looked.enough[k] if taut else looked.least[k] - T)


def loose_ends(system: System[Body], state: State[Body]) -> Flags:
    """Return which ends of the thread are loose, shape `(2,)`: not held, pulled or anchored, and
    without a mass.
    """
    spline, masses = system.thread.spline, system.thread.point_masses
    free = np.array([type(end) is Free and mass == 0.0 for end, mass in zip(system.ends, masses, strict=True)])
    if not free.any():
        return free
    anchors = state.s[state.present & ~system.may_slide & ~within(system, state.s)]
    half = 0.5 * (spline.start + spline.end)
    return free & ~np.array([(anchors < half).any(), (anchors > half).any()])


def strand_count(system: System[Body], state: State[Body]) -> int:
    """Return the number of strands, k + 1."""
    return int(np.count_nonzero(state.present & within(system, state.s))) + system.thread.spline.pieces


def middles(system: System[Body], state: State[Body]) -> Array:
    """Return the abscissae in the middle of the strands of a state, shape `(k + 1,)` [m]."""
    ends = look_at(system, state, np.zeros(0, dtype=bool)).ends
    return np.asarray(0.5 * (ends + np.append(system.thread.spline.start, ends[:-1])))


def carried_over(earlier: System[Body], taut: Flags, old: State[Body], system: System[Body], new: State[Body]) -> Flags:
    """Return which strands of a `new` state are taut; `taut` were so in an `old` state with other
    holds or cuts.

    A strand is taut if the old strand that contains its middle was taut.
    """
    before = look_at(earlier, old, taut).ends[:-1]
    return np.asarray(taut[np.searchsorted(before, middles(system, new))])


def strand_names(system: System[Body], state: State[Body]) -> list[tuple[str, bool]]:
    """Return the names of the strands of a state, made from the names of their two ends.

    Each name has a flag: True if the strand is not along a tract.
    """
    cuts = system.thread.spline.cuts
    inside = np.flatnonzero(state.present & within(system, state.s))
    names = [p.name for p in system.piercings] + ["clamp"] * len(system.clamps)
    names += [tie.name for tie in system.ties for _ in range(2)]
    along = [bool(p.tract) for p in system.piercings] + [False] * system.holds_off_organ
    bounds = [(names[k], along[k]) for k in inside] + [("cut", False)] * len(cuts)
    order = np.argsort(np.append(state.s[inside], cuts), kind="stable")
    rising = [("start", False), *(bounds[k] for k in order), ("end", False)]
    return [(f"{a}-{b}", not (one or other)) for (a, one), (b, other) in pairwise(rising)]
