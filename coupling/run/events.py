"""Events of piercings, ties and strands.

Piercings begin and end at their times. The thread leaves them, slips or sticks in them. Strands
between them become taut and slack (`coupling.run.tautness`). Surfaces in contact slip if all of
their pressed pairs slip, and stick again when the first pair sticks. The same holds for a thread
along a tract, with the tract's balls instead of pairs.

A piercing begins (`coupling.run.impact`) and ends between two steps: at the first end of a step
that is not before its time, at rest at its time (`coupling.run.run`). The times of four kinds of
events are found within a step (`coupling.run.location`): a hole is left, a hold slips or sticks, a
strand becomes taut or slack, tissue tears. A hold that reverses its motion in a step sticks and
slips in it. All other events have the time of the end of the step. The end of a piercing changes
neither positions nor velocities.
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
    """One event, at its `time` [s] and abscissa `s` [m], for a strand that of its middle.

    - `piercing`: name of the piercing, tie, tract, strand or surfaces in contact. It is empty for a
      halved step, a snap of tissue, a branch that was followed, and a cut.
    - `gap` [m], `angle` [rad], `work` [J]: for a piercing that begins, the closed gap and angle,
      and the work for it; `gap` also for a tie that closes.
    - `loss` [J], `impulse` (3,) [N s]: for a piercing that begins, the loss of kinetic energy and
      the impulse of the hole on the thread. For a cut, the change of the thread's energy and
      momentum.
    - `control_points`: their number after a cut.

    `work` − `loss` is the change of kinetic plus elastic energy in the event.
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
    """Events in their order, found at the first access.

    The times of events need additional solutions, and a host program that only makes steps does not
    wait for them.
    """

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
    """Return the events in the steps `taken` from `old`, in the order of their times, and the taut
    strands after them.

    The strands have shape `(k + 1,)`; `taut` are those before the steps.
    """
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
    """Return the events at holes between two states: holes that were left, that slip or stick, and
    tissue that tears.

    `times` are those at which the holds changed.
    """
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
    """Return the events that hold `k`, with this `name`, sticks or slips; both in this order if it
    reversed its motion.
    """
    if old.sigma[k] == new.sigma[k]:
        return []
    sticks = [Event(float(times.sticks[k]), "sticks", name, float(new.s[k]))] if old.sigma[k] else []
    return sticks + ([Event(float(times.slips[k]), "slips", name, float(new.s[k]))] if new.sigma[k] else [])


def tie_changes(system: System[Body], old: State[Body], new: State[Body], times: Times) -> list[Event]:
    """Return the events of ties between two states: they untie, slip or stick."""
    out = []
    for tie, (k, _) in zip(system.ties, system.strands, strict=True):
        if old.present[k] and not new.present[k]:
            out.append(Event(float(times.leaves[k]), "unties", tie.name, float(new.s[k])))
        elif new.present[k] and tie.is_locked(old.time):
            out += switches(old, new, times, k, tie.name)
    return out


def tract_changes(system: System[Body], old: State[Body], new: State[Body], times: Times) -> list[Event]:
    """Return the events of tracts between two states: the thread slips along the whole tract, or
    sticks again at a ball.
    """
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
    """Return the events of strands that became taut or slack between two states, and the taut
    strands at the second.

    The strands have shape `(k + 1,)`; `taut` are those at the first state. Strands along a tract
    have no events.
    """
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
    """Return the taut strands of a state if none changed since the state before, where they were `taut`."""
    if np.array_equal(old.present, new.present) and len(taut) == strand_count(system, new):
        return taut
    return carried_over(system, taut, old, system, new)


def surface_changes(system: System[Body], old: State[Body], new: State[Body]) -> list[Event]:
    """Return the events of surfaces in contact between two states: they slip as a whole, or some of
    their pairs stick again.
    """
    if not isinstance(system.organ, Rubs):
        return []
    before, now = (system.organ.slipping_surfaces(state.organ) for state in (old, new))
    changed = [(name, slips) for name, slips in now.items() if slips != before.get(name, False)]
    return [Event(new.time, "slips" if slips else "sticks", name) for name, slips in changed]
