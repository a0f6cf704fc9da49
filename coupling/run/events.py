"""What happens to piercings: they begin and end at their times, the thread leaves them, slips or sticks in them; and to
the strands between them, which become taut and slack (`coupling.run.tautness`).

Surfaces in contact slip where all of their pairs that press do, and stick again where the first of them sticks; so does
a thread along a tract, by the balls of it.

A piercing begins (`coupling.run.impact`) and ends between two steps: at the first end of a step that reaches its time
(`coupling.run.run`). A hole is left, a strand slips or sticks, becomes taut or slack, and tissue tears within the
step in which that was found (`coupling.run.location`); one that turns back in a step sticks and slips in it. All
other events bear the time of its end. An end of a piercing changes neither positions nor velocities.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from coupling.arrays import Flags
from coupling.interfaces import Body, Rubs
from coupling.reports.observation import bearing_pressures
from coupling.run.location import Times, locate, nearer_end
from coupling.run.tautness import carried_over, middles, still_taut, strand_count, strand_names, tension_over
from coupling.step.stepping import Step
from coupling.system import State, System

Kind = Literal[
    "begins",
    "ends",
    "leaves",
    "slips",
    "sticks",
    "tears",
    "taut",
    "slack",
    "closes",
    "tied",
    "unties",
    "cut",
    "halved",
    "snaps",
    "branch",
]


@dataclass(frozen=True)
class Event:
    """One event.

    `time` [s]; `piercing`, tie, tract, strand or surfaces in contact by name, empty for a halved step, tissue that
    snaps, a branch that was followed and a cut; `s` [m], of a strand its middle.
    Of a piercing that begins: `gap` [m] and `angle` [rad] that were closed, `work` [J] done in closing them, `loss` [J]
    of kinetic energy and `impulse` (3,) [N s] of the hole on the thread; of a tie that closes: `gap`. Of a cut:
    `control_points` after it, `loss` and `impulse`, what it cost of the thread's energy and momentum. `work` − `loss`
    is what the event changed of kinetic plus elastic energy.
    """

    time: float
    kind: Kind
    piercing: str = ""
    s: float = float("nan")
    gap: float = 0.0
    angle: float = 0.0
    work: float = 0.0
    loss: float = 0.0
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0)
    control_points: int = 0

    @property
    def energy(self) -> float:
        """Change of kinetic and elastic energy [J]."""
        return self.work - self.loss


class Events(Sequence[Event]):
    """Events in their order, which are found when somebody first asks for them: their times take solutions of their
    own, and a host program that steps a run does not wait for these."""

    def __init__(self, find: Callable[[], Sequence[Event]]) -> None:
        self._find = find

    @cached_property
    def _found(self) -> tuple[Event, ...]:
        return tuple(self._find())

    def __len__(self) -> int:
        return len(self._found)

    def __getitem__(self, index: Any) -> Any:
        return self._found[index]


def find_events(
    system: System[Body], old: State[Body], taken: Sequence[Step[Body]], taut: Flags
) -> tuple[list[Event], Flags]:
    """Find the events in the steps taken from `old`, in the order of their times, and which strands are taut after them
    `(k + 1,)`, of which those `taut` were before."""
    states, out = [old, *(step.new for step in taken)], list[Event]()
    for (before, after), step in zip(pairwise(states), taken, strict=True):
        times = locate(before, step)
        of_strands, taut = strand_changes(system, before, after, taut, times)
        out += sorted(changes(system, before, after, times) + of_strands, key=lambda event: event.time)
    out += [Event(step.new.time, "snaps") for step in taken if step.snapped]
    out += [Event(step.new.time, "branch") for step in [each for each in taken if each.along][-1:]]
    if len(taken) > 1:
        out.append(Event(taken[-1].new.time, "halved"))
    return out, taut


def changes(system: System[Body], old: State[Body], new: State[Body], times: Times) -> list[Event]:
    """Find the holes left, the stitches that began to slip or to stick, and those that the tissue no longer bears,
    between two states, with the `times` of what the holds did."""
    out = []
    for k, piercing in enumerate(system.piercings):
        if old.present[k] and not new.present[k]:
            out.append(Event(float(times.leaves[k]), "leaves", piercing.name, nearer_end(system, float(new.s[k]))))
        elif new.present[k] and system.rough[k] and not piercing.tract:
            out += switches(old, new, times, k, piercing.name)
    out += tie_changes(system, old, new, times) + tract_changes(system, old, new, times)
    out += surface_changes(system, old, new)
    strengths = np.array([piercing.strength for piercing in system.piercings])
    if np.isinf(strengths).all():
        return out
    before, after = (bearing_pressures(system, state.lam) - strengths for state in (old, new))
    torn = np.flatnonzero((after > 0.0) & (before <= 0.0) & new.present[: len(strengths)])
    when = times.between(before[torn], after[torn]).tolist()
    torn_at = zip(torn, when, strict=True)
    return out + [Event(time, "tears", system.piercings[k].name, float(new.s[k])) for k, time in torn_at]


def switches(old: State[Body], new: State[Body], times: Times, k: int, name: str) -> list[Event]:
    """Return that hold `k`, of a `name`, sticks, slips, or does both in this order where it turned back."""
    if old.sigma[k] == new.sigma[k]:
        return []
    sticks = [Event(float(times.sticks[k]), "sticks", name, float(new.s[k]))] if old.sigma[k] else []
    return sticks + ([Event(float(times.slips[k]), "slips", name, float(new.s[k]))] if new.sigma[k] else [])


def tie_changes(system: System[Body], old: State[Body], new: State[Body], times: Times) -> list[Event]:
    """Find the ties that came undone, or began to slip or to stick, between two states."""
    out = []
    for tie, (k, _) in zip(system.ties, system.strands, strict=True):
        if old.present[k] and not new.present[k]:
            out.append(Event(float(times.leaves[k]), "unties", tie.name, float(new.s[k])))
        elif new.present[k] and tie.is_locked(old.time):
            out += switches(old, new, times, k, tie.name)
    return out


def tract_changes(system: System[Body], old: State[Body], new: State[Body], times: Times) -> list[Event]:
    """Find the tracts along which the thread began to slip as a whole, or sticks again somewhere, between two
    states."""
    out = []
    for name in dict.fromkeys(piercing.tract for piercing in system.piercings if piercing.tract):
        balls = np.flatnonzero([piercing.tract == name for piercing in system.piercings])
        balls = balls[system.rough[balls] & new.present[balls]]
        before, now = (bool(balls.size and (state.sigma[balls] != 0.0).all()) for state in (old, new))
        changed = balls[old.sigma[balls] != new.sigma[balls]]
        if now and not before:
            out.append(Event(float(times.slips[changed].max()), "slips", name))
        elif before and not now:
            out.append(Event(float(times.sticks[changed].min(initial=times.end)), "sticks", name))
    return out


def strand_changes(
    system: System[Body], old: State[Body], new: State[Body], taut: Flags, times: Times
) -> tuple[list[Event], Flags]:
    """Find the strands that became taut or slack between two states, and return with them which are taut at the second,
    `(k + 1,)`, of which those `taut` were at the first. What lies along a tract is not told."""
    taut = kept_taut(system, old, new, taut)
    now = still_taut(system, new, taut)
    changed = np.flatnonzero(now != taut).tolist()
    if not changed:
        return [], now
    ends, names = (replace(old, present=new.present), new), strand_names(system, new)
    s = middles(system, new)
    over = ([tension_over(system, end, float(s[k]), bool(now[k])) for k in changed] for end in ends)
    out = []
    for k, time in zip(changed, times.between(*map(np.array, over)).tolist(), strict=True):
        name, in_the_open = names[k]
        if in_the_open:
            out.append(Event(time, "taut" if now[k] else "slack", name, float(s[k])))
    return out, now


def kept_taut(system: System[Body], old: State[Body], new: State[Body], taut: Flags) -> Flags:
    """Return which strands of a state are taut if none changed since the one before, in which those `taut` were."""
    if np.array_equal(old.present, new.present) and len(taut) == strand_count(system, new):
        return taut
    return carried_over(system, taut, old, system, new)


def surface_changes(system: System[Body], old: State[Body], new: State[Body]) -> list[Event]:
    """Find the surfaces in contact that began to slip as a whole, or have pairs that stick again, between two
    states."""
    if not isinstance(system.organ, Rubs):
        return []
    before, now = (system.organ.slipping_surfaces(state.organ) for state in (old, new))
    changed = [(name, slips) for name, slips in now.items() if slips != before.get(name, False)]
    return [Event(new.time, "slips" if slips else "sticks", name) for name, slips in changed]
