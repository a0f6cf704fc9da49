"""Ties begin and are locked between two steps; observations of ties.

At its beginning a tie joins the two strands that leave its holes in opposite directions, at their
closest points. Nothing moves then: the hands close the remaining gap as they draw
(`coupling.ties`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from coupling.arrays import Array
from coupling.errors import FormingError
from coupling.interfaces import Body
from coupling.kernels.constraints import driving_force
from coupling.run.events import Event
from coupling.run.impact import CORRECTIONS
from coupling.step.stepping import release
from coupling.system import State, System, forgetful
from coupling.ties import Tie
from thread.spline import Spline

SAMPLES = 400  # points on each strand for the start of the search for the closest pair
FARTHEST = 1.0  # of the distance between the two holes: strands further apart are not brought together

TieState = Literal["open", "held", "drawn", "tied", "slips"]


@dataclass(frozen=True)
class TieObservation:
    """One tie at one time.

    - `s_first`, `s_second` [m]: abscissae of its strands; of a tie that is undone, the last ones.
    - `length` [m]: unstrained length of the thread in its loop; nan for a loop that is cut.
    - `force` [N]: its force along the strands, the mean of both: tension of the loop less that of the
      tails.
    - `x` (3,) [m]: its place.
    - `gap` [m]: remaining gap between the strands.
    - `work` [J]: work of hands on it so far.
    - `state`: "open" before it begins and after it is undone, "held" before it is drawn, "drawn",
      "tied" or "slips".
    """

    name: str
    s_first: float
    s_second: float
    length: float
    force: float
    x: Array
    gap: float
    work: float
    state: TieState


def observe_ties(system: System[Body], state: State[Body], works: Array) -> tuple[TieObservation, ...]:
    """Return the observations of all ties of a state; `works` (t,) [J] is the work of the hands so far."""
    if not system.ties:
        return ()
    each = zip(system.ties, system.strands.tolist(), tie_forces(system, state).tolist(), works.tolist(), strict=True)
    return tuple(observe_tie(system.thread.spline, state, *known) for known in each)


def tie_forces(system: System[Body], state: State[Body]) -> Array:
    """Return the force of every tie along its strands, the mean of both, shape `(t,)` [N]."""
    at, (one, other) = system.passage_of(state), system.strands.T
    size = np.linalg.norm(at.T, axis=1) if state.stretch is None or not system.thread.travels else state.stretch
    along = driving_force(at, state.lam, state.y) / size
    return np.where(state.present[one], 0.5 * np.abs(along[one] - along[other]), 0.0)


def observe_tie(
    spline: Spline, state: State[Body], tie: Tie, strands: Sequence[int], force: float, work: float
) -> TieObservation:
    """Return the observation of one tie of a state.

    An open tie has no place and no loop, a tie with a cut loop has no length, and a tie has no
    strands before it begins: these values are nan.
    """
    s, places, here = state.s[strands], state.y[strands, :3], bool(state.present[strands[0]])
    first, last = spline.piece_of(s)
    nowhere = np.full(3, np.nan)
    return TieObservation(
        name=tie.name,
        s_first=float(s[0]) if has_been(state, strands) else np.nan,
        s_second=float(s[1]) if has_been(state, strands) else np.nan,
        length=float(s[1] - s[0]) if here and first == last else np.nan,
        force=force,
        x=places.mean(axis=0) if here else nowhere,
        gap=float(np.linalg.norm(places[0] - places[1])) if here else np.nan,
        work=work,
        state=tie_state(state, tie, strands[0]),
    )


def has_been(state: State[Body], strands: Sequence[int]) -> bool:
    """Return whether a tie with these `strands` has begun, even if it is undone since."""
    return bool(state.s[strands[0]] < state.s[strands[1]])


def tie_state(state: State[Body], tie: Tie, strand: int) -> TieState:
    """Return the state of a tie whose first hold is `strand`."""
    if not state.present[strand]:
        return "open"
    if not tie.is_locked(state.time):
        return "drawn" if tie.is_drawn(state.time) else "held"
    return "slips" if state.sigma[strand] else "tied"


def begin_tie(system: System[Body], state: State[Body], k: int) -> tuple[State[Body], Event]:
    """Activate tie `k` at the closest points of its strands; return the state with it, and the event.

    Raises `FormingError`.
    """
    tie, (one, other) = system.ties[k], system.strands[k]
    s = nearest_places(system, state, k)
    places = system.thread.spline.curve(state.q[:, :3], s)[:, 0]
    gap = float(np.linalg.norm(places[0] - places[1]))
    first, last = (state.y[hole, :3] for hole in tie.between)
    if gap > FARTHEST * np.linalg.norm(first - last):
        cause = (
            f"its strands are {gap:.3g} m apart at the closest points, further than its two holes; let the path cross "
            "itself over them, or let the tie begin before they part"
        )
        raise FormingError(state.time, tie.name, cause, "tie")
    new = replace(
        forgetful(state),
        s=with_strands(state.s, (one, other), s),
        s_dot=with_strands(state.s_dot, (one, other), 0.0),
        sigma=with_strands(state.sigma, (one, other), (1.0, -1.0)),
        present=state.present | np.isin(np.arange(system.holds), (one, other)),
        lam=with_strands(state.lam, (one, other), 0.0),
        y=state.y.copy(),
    )
    new.y[[one, other], :3] = places
    return new, Event(state.time, "closes", tie.name, float(s[0]), gap)


def with_strands(values: Array, strands: Sequence[int], new: ArrayLike) -> Array:
    """Return numbers of holds with new numbers for two strands."""
    out = values.copy()
    out[list(strands)] = new
    return out


def lock_tie(system: System[Body], state: State[Body], k: int) -> tuple[State[Body], Event]:
    """Lock tie `k`: its strands stick from then on."""
    strands = system.strands[k].tolist()
    sigma, s_dot = (with_strands(values, strands, 0.0) for values in (state.sigma, state.s_dot))
    event = Event(state.time, "tied", system.ties[k].name, float(state.s[strands[0]]))
    return replace(forgetful(state), sigma=sigma, s_dot=s_dot), event


def let_go_of_cut(system: System[Body], state: State[Body]) -> tuple[State[Body], list[Event]]:
    """Release the ties that hands draw or hold and whose loops are cut; return the state and the events.

    Such a tie no longer encloses anything, and at rest hands would draw it out without end. A
    locked knot keeps its place.
    """
    piece = system.thread.spline.piece_of(state.s[system.strands])
    drawn = np.array([not tie.is_locked(state.time) for tie in system.ties], dtype=bool)
    cut = state.present[system.strands[:, 0]] & drawn & (piece[:, 0] != piece[:, 1])
    events = [
        Event(state.time, "unties", system.ties[k].name, float(state.s[system.strands[k, 0]]))
        for k in np.flatnonzero(cut)
    ]
    return release(state, np.isin(np.arange(system.holds), system.strands[cut])), events


def strand_ranges(system: System[Body], state: State[Body], k: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ranges of the strands of tie `k` [m]: from their holes away to the next holes, or
    to the ends of the piece.

    Raises `FormingError` if the thread is not in both holes.
    """
    tie, spline, p = system.ties[k], system.thread.spline, len(system.piercings)
    lost = next((hole for hole in tie.between if not state.present[hole]), None)
    if lost is not None:
        cause = f"the thread is not in piercing {system.piercings[lost].name!r}; begin the tie while it is there"
        raise FormingError(state.time, tie.name, cause, "tie")
    first, last = (float(state.s[hole]) for hole in tie.between)
    here: Array = state.s[:p][state.present[:p]]
    start, end = spline.piece_ends[spline.piece_of(first)], spline.piece_ends[spline.piece_of(last) + 1]
    low = max([float(start), *here[here < first].tolist()])
    high = min([float(end), *here[here > last].tolist()])
    return (low, first), (last, high)


def nearest_places(system: System[Body], state: State[Body], k: int) -> Array:
    """Return the abscissae of the closest points of the strands of tie `k`, shape `(2,)` [m].

    The Gauss-Newton method on ½|P_a − P_b|² starts from the closest of many pairs. It stays within
    the strands.
    """
    spline, ranges = system.thread.spline, strand_ranges(system, state, k)
    samples = [np.linspace(low, high, SAMPLES + 2)[1:-1] for low, high in ranges]
    one, other = (spline.curve(state.q[:, :3], each)[:, 0] for each in samples)
    best = np.unravel_index(np.argmin(np.linalg.norm(one[:, None] - other, axis=2)), (SAMPLES, SAMPLES))
    s = np.array([samples[0][best[0]], samples[1][best[1]]])
    low, high = np.transpose([(each[0], each[-1]) for each in samples])
    for _ in range(CORRECTIONS):
        P, T = spline.curve(state.q[:, :3], s)[:, :2].swapaxes(0, 1)
        J = np.stack([T[0], -T[1]], axis=1)
        step = np.linalg.lstsq(J, P[0] - P[1], rcond=1e-6)[0]
        before, s = s, np.clip(s - step, low, high)
        if np.array_equal(s, before):
            break
    return s
