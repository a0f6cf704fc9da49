"""What happens to piercings: they begin and end at their times, the thread leaves them, slips or sticks in them.

Surfaces in contact slip where all of their pairs that press do, and stick again where the first of them sticks; so does
a thread along a tract, by the balls of it.

A piercing begins (`coupling.impact`) and ends between two steps: at the first end of a step that reaches its time
(`coupling.run`). All other events bear the time of the end of the step in which they were found, at most one step
late. An end of a piercing changes neither positions nor velocities. What the compliance that the spline lacks there
stored is let go, and counts as numerical dissipation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from coupling.interfaces import Body, Rubs
from coupling.observation import bearing_pressures
from coupling.stepping import Step
from coupling.system import State, System

Kind = Literal[
    "begins",
    "ends",
    "leaves",
    "slips",
    "sticks",
    "tears",
    "closes",
    "tied",
    "unties",
    "cut",
    "halved",
    "snaps",
    "branch",
    "knots",
]


@dataclass(frozen=True)
class Event:
    """One event.

    `time` [s]; `piercing`, tie, tract or surfaces in contact by name, empty for a halved step, tissue that snaps, a
    branch that was followed, a cut and other knots; `s` [m].
    Of a piercing that begins: `gap` [m] and `angle` [rad] that were closed, `work` [J] done in closing them, `loss` [J]
    of kinetic energy and `impulse` (3,) [N s] of the hole on the thread; of a tie that closes: `gap`. Of a cut and of
    other knots: `control_points` after it, `loss` and `impulse`, what the change cost of the thread's energy and
    momentum. `work` − `loss` is what the event changed of kinetic plus elastic energy.
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


def find_events(system: System[Body], old: State[Body], taken: Sequence[Step[Body]]) -> list[Event]:
    """Find the events in the steps taken from `old`, in the order of their times."""
    states = [old, *(step.new for step in taken)]
    out = [event for before, after in pairwise(states) for event in changes(system, before, after)]
    out += [Event(step.new.time, "snaps") for step in taken if step.snapped]
    out += [Event(step.new.time, "branch") for step in [each for each in taken if each.along][-1:]]
    if len(taken) > 1:
        out.append(Event(taken[-1].new.time, "halved"))
    return out


def changes(system: System[Body], old: State[Body], new: State[Body]) -> list[Event]:
    """Find the holes left, the stitches that began to slip or to stick, and those that the tissue no longer bears,
    between two states."""
    out = []
    for k, piercing in enumerate(system.piercings):
        turned = new.present[k] and system.rough[k] and (old.sigma[k] == 0.0) != (new.sigma[k] == 0.0)
        if old.present[k] and not new.present[k]:
            out.append(Event(new.time, "leaves", piercing.name, nearer_end(system, float(new.s[k]))))
        elif turned and not piercing.tract:
            kind: Kind = "sticks" if new.sigma[k] == 0.0 else "slips"
            out.append(Event(new.time, kind, piercing.name, float(new.s[k])))
    out += tie_changes(system, old, new) + tract_changes(system, old, new) + surface_changes(system, old, new)
    strengths = np.array([piercing.strength for piercing in system.piercings])
    if np.isinf(strengths).all():
        return out
    before, after = (bearing_pressures(system, state.lam) > strengths for state in (old, new))
    torn = np.flatnonzero(after & ~before & new.present[: len(strengths)])
    return out + [Event(new.time, "tears", system.piercings[k].name, float(new.s[k])) for k in torn]


def tie_changes(system: System[Body], old: State[Body], new: State[Body]) -> list[Event]:
    """Find the ties that came undone, or began to slip or to stick, between two states."""
    out = []
    for tie, (k, _) in zip(system.ties, system.strands, strict=True):
        if old.present[k] and not new.present[k]:
            out.append(Event(new.time, "unties", tie.name, float(new.s[k])))
        elif new.present[k] and tie.is_locked(old.time) and (old.sigma[k] == 0.0) != (new.sigma[k] == 0.0):
            out.append(Event(new.time, "sticks" if new.sigma[k] == 0.0 else "slips", tie.name, float(new.s[k])))
    return out


def tract_changes(system: System[Body], old: State[Body], new: State[Body]) -> list[Event]:
    """Find the tracts along which the thread began to slip as a whole, or sticks again somewhere, between two
    states."""
    out = []
    for name in dict.fromkeys(piercing.tract for piercing in system.piercings if piercing.tract):
        balls = np.flatnonzero([piercing.tract == name for piercing in system.piercings])
        balls = balls[system.rough[balls] & new.present[balls]]
        before, now = (bool(balls.size and (state.sigma[balls] != 0.0).all()) for state in (old, new))
        if before != now:
            out.append(Event(new.time, "slips" if now else "sticks", name))
    return out


def surface_changes(system: System[Body], old: State[Body], new: State[Body]) -> list[Event]:
    """Find the surfaces in contact that began to slip as a whole, or have pairs that stick again, between two
    states."""
    if not isinstance(system.organ, Rubs):
        return []
    before, now = (system.organ.slipping_surfaces(state.organ) for state in (old, new))
    changed = [(name, slips) for name, slips in now.items() if slips != before.get(name, False)]
    return [Event(new.time, "slips" if slips else "sticks", name) for name, slips in changed]


def nearer_end(system: System[Body], s: float) -> float:
    """Return the end of its piece of thread by which a hole at `s` was left [m]."""
    spline = system.thread.spline
    start, end = spline.piece_ends[spline.piece_of(s) + np.arange(2)]
    return float(start if s - start < end - s else end)
