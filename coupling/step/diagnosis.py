"""The reason why constraints cannot be satisfied, in words that name the piercings.

A state is checked for three faults. A hold may have no tangent of the thread. Two holds may leave
the span between them no freedom to bend. The rows of Φ_q may be dependent over the free control
points. The last check uses the singular values of the rows scaled to length one: if a combination
of rows nearly vanishes, one constraint repeats the others.
"""

from itertools import pairwise

import numpy as np

from coupling.arrays import Array, Flags, Indices
from coupling.errors import ConstraintError, CouplingError, StepError, TogetherError, TurnedHoleError
from coupling.interfaces import Body
from coupling.kernels.constraints import Passage
from coupling.system import State, System
from thread.vectors import cross, dot, unit_vector

DEPENDENT = 1e-6  # of a row's length; below, multipliers (with the square of its inverse) keep fewer than 4 digits
NO_TANGENT = 1e-2  # |∂P/∂s|, which is 1 for a thread without stretch
FARTHEST_TURN = 0.25 * np.pi  # between two equilibria; the default load steps turn soft tissue by a fifth of this angle
COLLAPSED = 0.2  # |u × v| of a hole's frame, 1 at rest: a linear organ has turned it by 78°
TRANSVERSE = 4  # conditions across a span with which its four control points cannot bend it any more


def hold_names(system: System[Body]) -> list[str]:
    """Return the name of each hold for a message: the piercings, then the clamped ends, then the
    strands of ties.
    """
    ends = [f"the clamped {('start', 'end')[k]} of the thread" for k in system.clamps]
    strands = [f"tie {tie.name!r}" for tie in system.ties for _ in range(2)]
    return [f"piercing {piercing.name!r}" for piercing in system.piercings] + ends + strands


def faults(system: System[Body], state: State[Body]) -> list[str]:
    """Return the faults of the active constraints in a state, one sentence each; empty if there are none."""
    at = system.passage_of(state)
    short = tangent_faults(system, state, at)
    return short or span_faults(system, state) or dependence_faults(system, state, at)


def refuse_faults(system: System[Body], state: State[Body]) -> None:
    """Raise `ConstraintError` if the constraints cannot be satisfied."""
    found = faults(system, state)
    if found:
        raise ConstraintError(state.time, "; ".join(found))


def diagnose(system: System[Body], state: State[Body], error: StepError) -> CouplingError:
    """Return the error that explains the failure of a step from a state best.

    It is `TogetherError` if holes have come to one place, `ConstraintError` if the constraints have
    a fault, `TurnedHoleError` if frames have collapsed, else the `error` of the step.
    """
    system = system.at(state)
    try:
        refuse_together(system, state)
    except TogetherError as together:
        return together
    found, collapsed = faults(system, state), collapsed_frames(system, state)
    if found:
        return ConstraintError(state.time, "; ".join(found))
    if collapsed:
        return TurnedHoleError(error.time, error.dt, "; ".join([error.cause, *collapsed]), error.piercing)
    return error


def refuse_together(system: System[Body], state: State[Body]) -> None:
    """Raise `TogetherError` if holes, or a hole and a tie, have come to one place."""
    together = drawn_together(system, state)
    if together:
        raise TogetherError(state.time, "; ".join(together))


def drawn_together(system: System[Body], state: State[Body]) -> list[str]:
    """Return sentences on neighbouring piercings and ties with less than a diameter of thread between them."""
    names, s, organ, p = hold_names(system), state.s, system.organ, len(system.piercings)
    others = [] if getattr(organ, "turns", False) else ["tissue at finite strain (tissue.material)"]
    others += [] if getattr(organ, "pairs", 0) else ["[[contact]] between the lips of a wound"]
    along = [k for k in holds_along_thread(system, state) if k < p or system.of_ties[k]]
    remedies = {
        2: f"pull less, or use {' or '.join(['firmer tissue', *others])}",
        1: "draw less, or give the holes friction, so that the loop does not slide round in them",
    }
    return [
        f"the thread between {names[i]} and {names[j]} is drawn to nothing, {abs(s[j] - s[i]):.2g} m of it are left: "
        f"they have come to one place; {remedies[(i < p) + (j < p)]}"
        for i, j in pairwise(along)
        if abs(s[j] - s[i]) < system.thread.section.diameter and min(i, j) < p
    ]


def collapsed_frames(system: System[Body], state: State[Body]) -> list[str]:
    """Return sentences on directed holes whose frames no longer define a direction."""
    size = np.linalg.norm(np.cross(state.y[:, 3:6], state.y[:, 6:]), axis=1)
    directed, names = system.rows[:, 3] & state.present, hold_names(system)
    return [
        f"the frame of {names[k]} has shrunk to {size[k]:.2g} of its area, by the cosine of its turn in a linear "
        "organ, and hardly defines a direction: pull less, or use firmer tissue, a wider footprint, a softer suture, "
        "or tissue at finite strain (tissue.material)"
        for k in np.flatnonzero(directed & (size < COLLAPSED))
    ]


def tangent_faults(system: System[Body], state: State[Body], at: Passage) -> list[str]:
    """Return sentences on holds at which the thread has no direction."""
    length = np.linalg.norm(at.T, axis=1)
    names = hold_names(system)
    return [
        f"the thread's tangent has no length at {names[k]} (|dP/ds| = {length[k]:.2g}, 1 in an unstrained thread); "
        "remove the kink of the path or the slack there"
        for k in np.flatnonzero(holds_in_force(system, state) & (length < NO_TANGENT))
    ]


def span_faults(system: System[Body], state: State[Body]) -> list[str]:
    """Return sentences on neighbouring holds between which the span cannot bend."""
    spline, names = system.thread.spline, hold_names(system)
    span, conditions = spline.spans_of(state.s), 1 + system.rows[:, 3].astype(int)
    return [
        f"{names[i]} (s = {state.s[i]:.6g} m) and {names[j]} (s = {state.s[j]:.6g} m) lie in one span of the spline, "
        f"{np.diff(spline.breaks)[span[i]]:.3g} m long: there are too few control points between them for two "
        "directions; raise thread.control_points, or set direction to free at one of them"
        for i, j in pairwise(holds_along_thread(system, state))
        if span[i] == span[j] and conditions[i] + conditions[j] >= TRANSVERSE
    ]


def dependence_faults(system: System[Body], state: State[Body], at: Passage) -> list[str]:
    """Return a sentence on holds with dependent constraints on the thread."""
    rows, owner = scaled_rows(system, state, at)
    if not len(rows):
        return []
    crowded = len(rows) > rows.shape[1]  # otherwise the full right-hand factor would be by far the largest array
    left, sizes, _ = np.linalg.svd(rows, full_matrices=crowded)
    weakest = np.append(sizes, np.zeros(len(rows) - len(sizes)))[-1]
    if weakest >= DEPENDENT:
        return []
    share = np.bincount(owner, left[:, -1] ** 2, system.holds)
    names = hold_names(system)
    pair = sorted(np.argsort(share)[-2:]) if np.sort(share)[:-1].any() else [int(np.argmax(share))]
    who = " and ".join(f"{names[k]} (s = {state.s[k]:.6g} m)" for k in pair)
    return [
        f"the constraints of {who} depend on one another (a combination of their rows has length {weakest:.1e}, "
        f"allowed is {DEPENDENT:g}): they constrain the same control points; move them apart, raise "
        "thread.control_points, or set direction to free at one of them"
    ]


def scaled_rows(system: System[Body], state: State[Body], at: Passage) -> tuple[Array, Indices]:
    """Return the rows of Φ_q over the free control points, each of length one, and the hold of each.

    A row without a free control point is zero. Strands of ties only hold one another, and have no
    rows.
    """
    m, n, c = system.holds, system.thread.n, system.thread.coordinates
    full = np.zeros((m, 5, n, c))
    local = at.first[:, None] + np.arange(4)
    hold = np.arange(m)[:, None]
    for axis in range(3):
        full[hold, axis, local, axis] = at.b[:, 0]
    for row, frame in ((3, slice(3, 6)), (4, slice(6, 9))):
        full[hold, row, local, :3] = at.b[:, 1, :, None] * state.y[:, None, frame]
    used = system.rows & (state.present & ~system.of_ties)[:, None]
    owner = np.nonzero(used)[0]
    flat = full.reshape(m, 5, n * c)[used]
    size = np.linalg.norm(flat, axis=1, keepdims=True)
    flat[:, system.held] = 0.0
    return flat / np.maximum(size, np.finfo(float).tiny), owner


def holds_in_force(system: System[Body], state: State[Body]) -> np.ndarray:
    """Return the holds that constrain the thread, shape `(m,)`."""
    return np.asarray(system.rows.any(axis=1) & state.present)


def holds_along_thread(system: System[Body], state: State[Body]) -> list[int]:
    """Return the active holds in the order of the thread."""
    here = np.flatnonzero(holds_in_force(system, state))
    return [int(k) for k in here[np.argsort(state.s[here], kind="stable")]]


def turn_of_holes(system: System[Body], old: State[Body], new: State[Body]) -> Array:
    """Return the angle by which tissue has turned the normal of every directed hole, shape `(m,)` [rad]."""
    before, after = (unit_vector(cross(state.y[:, 3:6], state.y[:, 6:])) for state in (old, new))
    here = old.present & new.present & system.rows[:, 3]
    return np.asarray(np.arccos(np.clip(dot(before, after), -1.0, 1.0)) * here)


def refuse_turning(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `StepError` if tissue has turned a hole by more than FARTHEST_TURN, further than on one branch."""
    angles = turn_of_holes(system, old, new).tolist()
    for piercing, angle in zip(system.piercings, angles, strict=False):  # without clamped ends and ties
        if angle > FARTHEST_TURN:
            cause = f"the tissue turned the hole by {np.degrees(angle):.3g}° in one step, to another branch"
            raise StepError(old.time, new.time - old.time, cause, piercing.name)


def refuse_crossing(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `StepError` if two piercings passed one another along the thread during a step.

    Two holes at different places cannot pass one another: the solution does not continue the
    motion.
    """
    refuse_swallowed_ties(system, old, new)
    spline = system.thread.spline
    inside = ~spline.has_left(new.s, home=old.s)
    here = np.flatnonzero((new.present & inside)[: len(system.piercings)])
    before, after = old.s[here], new.s[here]
    crossed = np.argwhere((before[:, None] < before) & (after[:, None] >= after))
    if crossed.size:
        i, j = here[crossed[0]]
        first, second = system.piercings[i].name, system.piercings[j].name
        cause = (
            f"piercing {first!r} (s = {new.s[i]:.6g} m) came past piercing {second!r} (s = {new.s[j]:.6g} m) along "
            "the thread; are they one hole, or is the thread between them slack?"
        )
        raise StepError(old.time, new.time - old.time, cause, second)


def refuse_swallowed_ties(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `StepError` if a tie came to a hole in its loop."""
    for tie, strands in zip(system.ties, system.strands.tolist(), strict=True):
        for hole, strand, sign in zip(tie.between, strands, (1.0, -1.0), strict=True):
            if new.present[hole] and new.present[strand] and sign * (new.s[hole] - new.s[strand]) <= 0.0:
                cause = (
                    f"tie {tie.name!r} came to the hole of piercing {system.piercings[hole].name!r} in its loop; give "
                    "the holes friction, so that the loop does not slide round in them, or draw less"
                )
                raise StepError(old.time, new.time - old.time, cause)


def refuse_drawn_out(system: System[Body], old: State[Body], new: State[Body]) -> None:
    """Raise `ConstraintError` if a hand has drawn the thread, or a piece of it, out of a hole during a step."""
    ends, piece = system.thread.spline.piece_ends, system.thread.spline.piece_of(old.s)
    beyond = (new.s <= ends[piece] + system.width) | (new.s >= ends[piece + 1] - system.width)
    in_hand = np.logical_or(*system.in_hand(old.time))
    for k in np.flatnonzero(new.present & in_hand & beyond):
        low, high = ends[piece[k] : piece[k] + 2]
        cause = (
            f"the thread is drawn out of piercing {system.piercings[k].name!r} (s = {new.s[k]:.6g} m, and its piece "
            f"goes from {low:.6g} to {high:.6g} m); draw less, or lay out more thread; in a dynamic run, "
            'solve.start = "rest" lets the bends of a laid path straighten before the hand draws'
        )
        raise ConstraintError(new.time, cause)


def refuse_held_end(system: System[Body], old: State[Body], new: State[Body], gone: Flags) -> None:
    """Raise `StepError` if the thread left the holes `gone` (holds,) during a step over a fixed,
    clamped or driven end.

    The thread cannot leave a hole over an end that is held.
    """
    spline, piece = system.thread.spline, system.thread.spline.piece_of(old.s)
    at_start, at_end = new.s <= spline.start + system.width, new.s >= spline.end - system.width
    beyond = gone & at_start & (piece == 0), gone & at_end & (piece == spline.pieces - 1)
    for name, end, left in zip(("start", "end"), system.ends, beyond, strict=True):
        if left.any() and end.position(new.time) is not None:
            k, holes = int(np.argmax(left)), len(system.piercings)
            cause = (
                f"the thread runs out at {hold_names(system)[k]}: its {name} is held and cannot pass the hole; lay out "
                "more thread, move the end less, or let it go"
            )
            raise StepError(old.time, new.time - old.time, cause, system.piercings[k].name if k < holes else "")
