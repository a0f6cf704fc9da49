"""A tie begins and is locked, both between two steps, and what one wants to know of it.

Where it begins, the strands that leave its two holes away from each other are joined where they are nearest to one
another. Nothing moves then: what is left between them is closed by the hands as they draw (`coupling.ties`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from coupling.arrays import Array
from coupling.errors import FormingError
from coupling.interfaces import Body
from coupling.run.events import Event
from coupling.run.impact import CORRECTIONS
from coupling.step.stepping import release
from coupling.system import State, System, forgetful
from coupling.ties import Tie
from thread.spline import Spline

SAMPLES = 400  # places on each strand at which the search for the nearest two begins
FARTHEST = 1.0  # of the distance between the two holes: strands further apart are not brought together

TieState = Literal["open", "held", "drawn", "tied", "slips"]


@dataclass(frozen=True)
class TieObservation:
    """One tie at one time.

    `s_first`, `s_second` [m] of its strands; `length` [m] of the thread in its loop, unstrained, of which a loop that
    is cut has none; `force` [N],
    the tension of the strands that it holds; `x` (3,) [m]; `gap` [m] left between the strands; `work` [J] that hands
    have done on it; `state`: "open" before it begins and once it has come undone, "held" at rest before it is drawn,
    "drawn", "tied" or "slips".
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
    """Return all ties of a state; `works` (t,) [J] of the hands so far."""
    each = zip(system.ties, system.strands.tolist(), works.tolist(), strict=True)
    spline = system.thread.spline
    return tuple(observe_tie(spline, state, tie, strands, work) for tie, strands, work in each)


def observe_tie(spline: Spline, state: State[Body], tie: Tie, strands: Sequence[int], work: float) -> TieObservation:
    """Return one tie of a state, which has no place and no loop while it is open, and no loop where that is cut."""
    s, places, here = state.s[strands], state.y[strands, :3], bool(state.present[strands[0]])
    first, last = spline.piece_of(s)
    nowhere = np.full(3, np.nan)
    return TieObservation(
        name=tie.name,
        s_first=float(s[0]) if here else np.nan,
        s_second=float(s[1]) if here else np.nan,
        length=float(s[1] - s[0]) if here and first == last else np.nan,
        force=float(np.linalg.norm(state.lam[strands[0], :3])),
        x=places.mean(axis=0) if here else nowhere,
        gap=float(np.linalg.norm(places[0] - places[1])) if here else np.nan,
        work=work,
        state=tie_state(state, tie, strands[0]),
    )


def tie_state(state: State[Body], tie: Tie, strand: int) -> TieState:
    """Return what a tie does, of whose holds `strand` is the first."""
    if not state.present[strand]:
        return "open"
    if not tie.is_locked(state.time):
        return "drawn" if tie.is_drawn(state.time) else "held"
    return "slips" if state.sigma[strand] else "tied"


def begin_tie(system: System[Body], state: State[Body], k: int) -> tuple[State[Body], Event]:
    """Put tie `k` into force where its strands are nearest to one another: the state with it, and the event. Raises
    `FormingError`."""
    tie, (one, other) = system.ties[k], system.strands[k]
    s = nearest_places(system, state, k)
    places = system.thread.spline.curve(state.q[:, :3], s)[:, 0]
    gap = float(np.linalg.norm(places[0] - places[1]))
    first, last = (state.y[hole, :3] for hole in tie.between)
    if gap > FARTHEST * np.linalg.norm(first - last):
        cause = (
            f"its strands pass one another {gap:.3g} m apart, further than its two holes; let the path cross itself "
            "over them, or the tie begin before they part"
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
    """Return numbers of holds with others for two strands."""
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
    """Let go of the loops that are cut while hands draw or hold them: the state, and the events. What they draw no
    longer goes round anything, and at rest they would draw it out without end; a locked knot stays where it is."""
    piece = system.thread.spline.piece_of(state.s[system.strands])
    drawn = np.array([not tie.is_locked(state.time) for tie in system.ties], dtype=bool)
    cut = state.present[system.strands[:, 0]] & drawn & (piece[:, 0] != piece[:, 1])
    events = [
        Event(state.time, "unties", system.ties[k].name, float(state.s[system.strands[k, 0]]))
        for k in np.flatnonzero(cut)
    ]
    return release(state, np.isin(np.arange(system.holds), system.strands[cut])), events


def strand_ranges(system: System[Body], state: State[Body], k: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return from where to where the strands of tie `k` go [m]: away from their holes to the next, or to the end of the
    piece. Raises `FormingError` where the thread is not in both holes."""
    tie, spline, p = system.ties[k], system.thread.spline, len(system.piercings)
    lost = next((hole for hole in tie.between if not state.present[hole]), None)
    if lost is not None:
        cause = f"the thread is not in piercing {system.piercings[lost].name!r}; let the tie begin while it is"
        raise FormingError(state.time, tie.name, cause, "tie")
    first, last = (float(state.s[hole]) for hole in tie.between)
    here: Array = state.s[:p][state.present[:p]]
    start, end = spline.piece_ends[spline.piece_of(first)], spline.piece_ends[spline.piece_of(last) + 1]
    low = max([float(start), *here[here < first].tolist()])
    high = min([float(end), *here[here > last].tolist()])
    return (low, first), (last, high)


def nearest_places(system: System[Body], state: State[Body], k: int) -> Array:
    """Find where the strands of tie `k` are nearest to one another, shape `(2,)` [m]: the nearest of many pairs, then
    Newton's method on ½|P_a − P_b|² (Gauss and Newton's), kept within the strands."""
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
