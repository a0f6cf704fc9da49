"""A run: one step after another, each with its audit and events, on knots that fit the thread.

    run = begin(system, state)
    while run.state.time < duration:
        run = run.step(dt)

A step has four stages. If knots travel, packets of knots are made that fit its start. The step
itself is made, in halves if it fails. Its audit and its events follow. Finally the thread is cut,
and piercings begin or end.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, chain
from typing import Generic

import numpy as np

from coupling.arrays import Array, Flags
from coupling.errors import CouplingError, RestError
from coupling.interfaces import Body
from coupling.reports.audit import Energies, audit_step, closing_works, drawing_works, initial_energies, stored
from coupling.reports.observation import PiercingObservation, Sight, largest_gap, look, observe
from coupling.rest.branch import reach
from coupling.rest.equilibrium import lightly_loaded, refuse_unbalanced
from coupling.run.course import Course
from coupling.run.cutting import Cut, cut_thread
from coupling.run.events import Event, Events, find_events, kept_taut
from coupling.run.impact import begin_piercing
from coupling.run.march import march, step_between
from coupling.run.tautness import carried_over, still_taut, taut_strands
from coupling.run.tying import TieObservation, begin_tie, has_been, let_go_of_cut, lock_tie, observe_ties
from coupling.run.watch import Watch
from coupling.step.configuration import Configuration, configuration_of
from coupling.step.packets import fitted, fitting, know_holes
from coupling.step.stepping import CURVED, HALVINGS, Step, Take, advance, bdf2_step, release
from coupling.system import State, System, forgetful, turns
from coupling.ties import ON_TIME
from tissue.errors import FactorError

log = logging.getLogger(__name__)

AT_ONCE = 500  # steps in one call of the loops, at most: they cannot be cancelled in between


@dataclass(frozen=True)
class Run(Generic[Body]):
    """The state of a run: all data for its next steps, and the results of the last step.

    - `system`: with the knots of the present thread.
    - `s_begun` (holds,) [m]: reference abscissae of the slip, at the beginning of each piercing.
    - `take`: makes a step; `halvings`: halvings of a failed step, at most.
    - `given` (p,) [m]: abscissae of piercings that begin; nan means the thread's closest point.
    - `tie_works` (t,) [J]: work of the hands on each tie so far.
    - `taut` (k + 1,): taut strands of the thread, between its k holds and cuts
      (`coupling.run.tautness`).
    - `tolerance` [m]: largest error of a step that is not halved
      (`coupling.step.stepping.local_error`).
    - `downhill`: whether a step that creates energy has failed (`coupling.run.watch`).
    - `cuts`: cuts of the thread at their times.
    - `marks`: further times [s] at which a load step is divided.
    - `number`: number of steps made.
    - `fresh`: whether the thread has no tension yet for packets to fit.
    - `at_once`: Newton iterations of the steps made by compiled loops.
    - `taken`: the parts of the last step, several if it was halved; empty if the loops made it.
    - `events`: the events in the last step.
    - `seen`: the thread at its end as observed by the loops.
    """

    system: System[Body]
    state: State[Body]
    energies: Energies
    s_begun: Array
    take: Take[Body]
    given: Array
    tie_works: Array = field(default_factory=lambda: np.zeros(0))
    taut: Flags = field(default_factory=lambda: np.zeros(1, dtype=bool))
    halvings: int = HALVINGS
    tolerance: float = np.inf
    downhill: bool = True
    cuts: tuple[Cut, ...] = ()
    marks: tuple[float, ...] = ()
    number: int = 0
    fresh: bool = True
    at_once: int = 0
    taken: tuple[Step[Body], ...] = ()
    events: Sequence[Event] = ()
    seen: Sight[Body] | None = None

    @cached_property
    def configuration(self) -> Configuration:
        """The thread now: at the end of the last step, unless a cut, a tie or a piercing came after it."""
        if self.taken and self.taken[-1].new is self.state:
            return self.taken[-1].end
        return configuration_of(self.system, self.state)

    @cached_property
    def piercings(self) -> tuple[PiercingObservation, ...]:
        """All piercings now, with slip measured from the beginning of each."""
        if self.seen is not None and self.seen.state is self.state:
            return self.seen.piercings
        return observe(self.system, replace(self.state, s=self.s_begun), self.state, self.configuration)

    @cached_property
    def sight(self) -> Sight[Body]:
        """The observed thread now; the largest gap is that of all steps `taken`."""
        if self.seen is not None and self.seen.state is self.state:
            return self.seen
        ends = [(step.solution.problem.system, step.new, step.end.at) for step in self.taken]
        ends = ends or [(self.system, self.state, self.configuration.at)]
        gap = max(largest_gap(*end) for end in ends)
        now = self.configuration
        return Sight(self.state, self.piercings, gap, float(np.max(now.thread.whole_strain(now.points.strain))))

    @cached_property
    def ties(self) -> tuple[TieObservation, ...]:
        """All ties now."""
        return observe_ties(self.system, self.state, self.tie_works)

    @property
    def iterations(self) -> int:
        """Newton iterations of the last step, or of all steps made by `steps`."""
        return self.at_once + sum(step.solution.iterations for step in self.taken)

    def step(self, dt: float, time: float | None = None) -> "Run[Body]":
        """Return the run `dt` [s] later.

        `time` [s] is the time at its end, so that round-off does not accumulate; None means the sum
        of the time and dt. Raises `StepError`, `ConstraintError`, `InversionError`, `FormingError`,
        and `CouplingError` for a dt that is not positive and finite.
        """
        refuse_no_time(dt)
        first = replace(self, at_once=0, taken=(), events=(), seen=None)
        return first._gone(dt, self.state.time + dt if time is None else time)._scheduled(self.state.time, dt)

    def _gone(self, dt: float, time: float) -> "Run[Body]":
        """Return the run `dt` [s] later, at the `time` [s], before scheduled changes. Raises the
        errors of `step`.
        """
        run = self if self.fresh else self._fitted()
        watch = Watch([run.energies], run.downhill, run is not self, dt / 2 ** min(CURVED, run.halvings))
        depth = HALVINGS - run.halvings
        taken = advance(run.system, run.state, dt, fitting(run.take), depth, watch, run.tolerance)
        taken = [*taken[:-1], replace(taken[-1], new=replace(taken[-1].new, time=time))]
        return replace(run._after(taken, watch.energies[-1]), fresh=False)

    def steps(self, dt: float, count: int) -> "Run[Body]":
        """Return the run after `count` steps of `dt` [s].

        The steps are those of `step`, but as many smooth steps as possible are made in one call of
        compiled loops (`coupling.run.march`) if the system asks for them. The solutions of these
        steps are not stored. The events and iterations are those of all steps. Raises the errors of
        `step`; the steps before the failed one are then lost.
        """
        refuse_no_time(dt)
        run, last, parts, iterations = self, self.number + count, list[Sequence[Event]](), 0
        while run.number < last:
            times = list(accumulate([dt] * min(AT_ONCE, last - run.number), initial=run.state.time))[1:]
            run = run._smoothly(dt, times) or run.step(dt, times[0])
            parts, iterations = [*parts, run.events], iterations + run.iterations
        if len(parts) == 1:
            return run
        of_last = sum(step.solution.iterations for step in run.taken)
        return replace(run, events=Events(lambda: list(chain(*parts))), at_once=iterations - of_last)

    def each_of_steps(self, dt: float, times: Sequence[float]) -> "list[Run[Body]]":
        """Return the run after each step of `dt` [s] whose end is at one of the `times` [s].

        As many smooth steps as possible are made in compiled loops, as in `steps`; otherwise only
        the first step is made. Raises the errors of `step`.
        """
        refuse_no_time(dt)
        return self._each_smoothly(dt, times) or [self.step(dt, times[0])]

    def _smoothly(self, dt: float, times: Sequence[float]) -> "Run[Body] | None":
        """Return the run after the steps of `dt` [s] to the `times` [s] that the loops make at
        once; None if they make none.
        """
        course = self._course(dt, times)
        if course is None:
            return None
        (state,) = course.states(course.made - 1)
        run = self._marched(course.made, state, course.energies[-1], int(course.iterations.sum()))
        return self._switched(run, dt) if course.happened else run

    def _each_smoothly(self, dt: float, times: Sequence[float]) -> "list[Run[Body]]":
        """Return the runs after each of the steps that the loops make; empty if they make none."""
        course = self._course(dt, times)
        if course is None:
            return []
        states = course.states()
        sights = look(self.system, self.s_begun, course.seen(), states, course.strains)
        each = zip(states, course.energies, course.iterations.tolist(), sights, strict=True)
        runs = [self._marched(made, *one) for made, one in enumerate(each, 1)]
        return [self._switched(runs[0], dt)] if course.happened else runs

    def _course(self, dt: float, times: Sequence[float]) -> Course | None:
        """Return the steps of `dt` [s] to the `times` [s] that the loops make before scheduled
        changes; None if they make none.
        """
        before = self._before_due(dt, times)
        return march(self.system, self.state, self.energies, dt, before, self.take, self.taut) if before else None

    def _marched(
        self, made: int, state: State[Body], energies: Sequence[float], iterations: int, seen: Sight[Body] | None = None
    ) -> "Run[Body]":
        """Return the run after `made` steps of the loops, which lead to a `state` with its `energies` [J]."""
        return replace(
            self,
            number=self.number + made,
            system=self.system.at(state),
            state=state,
            energies=Energies(*energies),
            at_once=iterations,
            seen=seen,
            fresh=False,
            taken=(),
            events=(),
        )

    def _switched(self, new: "Run[Body]", dt: float) -> "Run[Body]":
        """Return the run after a step of `dt` [s] of the loops, `new`, with its events.

        In these events holds slip or stick, strands become taut or slack, or tissue tears.
        """
        taut = still_taut(self.system, new.state, kept_taut(self.system, self.state, new.state, self.taut))
        return replace(new, taut=taut, events=Events(lambda: self._events_until(new.state, dt)))

    def _events_until(self, new: State[Body], dt: float) -> list[Event]:
        """Return the events in a step of `dt` [s] of the loops to a `new` state."""
        step = step_between(self.system, self.state, new, dt, self.take)
        return find_events(self.system, self.state, [step], self.taut)[0]

    def _before_due(self, dt: float, times: Sequence[float]) -> Sequence[float]:
        """Return the `times` [s] of steps of `dt` [s] before scheduled changes.

        It is empty if the steps need a check that the loops do not have: the error of a step.
        """
        if not self.downhill or self.tolerance < np.inf or not know_holes(self.system, self.state):
            return []
        due = [time - ON_TIME * dt for time in self.planned]
        next_one = min((time for time in due if time > self.state.time), default=np.inf)
        return [time for time in times if time < next_one]

    @property
    def planned(self) -> list[float]:
        """The times of scheduled changes [s], in order.

        Cuts are due, piercings and ties begin or end, and hands take the thread, turn or let go.
        """
        holes, ties = self.system.piercings, self.system.ties
        grips = [rows for hole in holes for rows in (*hole.drawing, *hole.pulling)]
        periods = [(hole.begins, hole.ends) for hole in holes] + [(tie.begins, tie.locks) for tie in ties]
        return sorted({*(cut.time for cut in self.cuts), *chain(*periods), *chain(*map(turns, grips))})

    def load(self, share: float, duration: float) -> "Run[Body]":
        """Return the run at the equilibrium under the part `share` of the loads at `duration` [s].

        Scheduled changes within the load step take place in the equilibrium at their time. A thread
        that is cut, or whose tie may slip as it is locked, finds another equilibrium under the same
        loads, with friction from the first one. Raises `StepError` (for unbalanced dead loads
        before the first load step), `InversionError`, `ConstraintError`.
        """
        run, now, end = replace(self, at_once=0, taken=(), events=(), seen=None), self.state.time, share * duration
        dt, parts = end - now, [share]
        for time in sorted({*self.planned, *self.marks}, reverse=True):
            if ON_TIME * dt < time - now and time < parts[0] * duration - ON_TIME * dt:
                parts.insert(0, time / duration)
        if run.fresh:
            refuse_unbalanced(run.system, run.state, duration)
            run = run.held_together()._lightly_loaded(parts[0], duration)
        for part in parts:
            first = run if run.fresh else run._fitted()
            run = first._settled(part, duration)._scheduled(now, dt)
            if any(self._unbalances(event) for event in run.events[len(first.events) :]):
                run = run._audited(reach(run.system, run.state, part, duration))
            now = part * duration
        return replace(run, number=self.number + 1)

    def _unbalances(self, event: Event) -> bool:
        """Return whether a scheduled change ends an equilibrium: a cut, or the lock of a tie that may slip."""
        may_slip = {tie.name for tie in self.system.ties if tie.hold < np.inf}
        return event.kind == "cut" or (event.kind == "tied" and event.piercing in may_slip)

    def rested(self) -> "Run[Body]":
        """Return the run before its first step, at the equilibrium under the loads at its time.

        Slack is thus removed before the run starts. Nothing moves, holes with friction stick under
        the forces of the equilibrium, and slip counts from there. Energy released on the way is not
        part of the audit; holes that were left are events. Raises `RestError` if no equilibrium is
        found.
        """
        log.info("looking for the equilibrium from which the run starts")
        first = replace(self, at_once=0, taken=(), events=())
        try:
            refuse_unbalanced(first.system, first.state, first.state.time)
            run = first._lightly_loaded(1.0, first.state.time)._settled(1.0, first.state.time)
            near = run._fitted()
            if near is not run:  # without slack the strands have other lengths
                run = near._settled(1.0, near.state.time)
        except (CouplingError, FactorError) as error:
            raise RestError(str(error)) from error
        state = forgetful(run.state)
        state = replace(state, sigma=np.where(run.system.rough, 0.0, state.sigma))
        told = tuple(event for event in run.events if event.kind not in ("slips", "sticks", "taut", "slack"))
        return replace(
            self,
            system=run.system,
            state=state,
            energies=initial_energies(run.system, state),
            s_begun=state.s,
            taut=run.taut,
            fresh=False,
            events=(*self.events, *told),
        )

    def _lightly_loaded(self, share: float, duration: float) -> "Run[Body]":
        """Return the run at the equilibrium under light loads, from which the load step to the part
        `share` begins; itself if there is none.
        """
        taken = lightly_loaded(self.system, self.state, share, duration)
        return self._audited(taken) if taken else self

    def _settled(self, share: float, duration: float) -> "Run[Body]":
        """Return the run at the equilibrium under a part of the loads. Raises the errors of `load`."""
        return self._audited(reach(self.system, self.state, share, duration))

    @property
    def fallen(self) -> float | None:
        """Largest decrease of the loads along a branch in the last load step, on their time scale [s].

        None if the step followed no branch.
        """
        times = [time for step in self.taken if step.along for time in (step.old.time, step.new.time)]
        return float(np.max(np.maximum.accumulate(times) - times)) if times else None

    def _audited(self, taken: Sequence[Step[Body]]) -> "Run[Body]":
        """Return the run after the steps `taken`, with their audit and events."""
        energies = self.energies
        for step in taken:
            energies = audit_step(self.system, energies, step)
        return self._after(taken, energies)

    def _after(self, taken: Sequence[Step[Body]], energies: Energies) -> "Run[Body]":
        """Return the run after the steps `taken`, with the `energies` after them and their events."""
        found, taut = find_events(self.system, self.state, taken, self.taut)
        return replace(
            self,
            system=self.system.at(taken[-1].new),
            state=taken[-1].new,
            energies=energies,
            tie_works=self.tie_works + sum(closing_works(step) + drawing_works(step) for step in taken),
            taut=taut,
            taken=self.taken + tuple(taken),
            events=(*self.events, *found),
        )

    def _fitted(self) -> "Run[Body]":
        """Return the run on packets that fit its state; itself if they fit or if knots do not travel."""
        system, state = fitted(self.system, self.state)
        if state is self.state:
            return self
        loss = stored(self.system, self.state) - stored(system, state)  # not an event: nothing is transferred
        return replace(self, system=system, state=state, energies=booked(system, self.energies, state, loss=loss))

    def _scheduled(self, earlier: float, dt: float) -> "Run[Body]":
        """Return the run after the cuts, and after the piercings that end or begin, later than `earlier` [s]."""
        run = replace(self, number=self.number + 1, fresh=False).cut_when_due(earlier, dt).tied_when_due(earlier, dt)
        state, due = schedule_piercings(run.system, earlier, run.state, dt, run.given)
        if due:
            run = replace(
                run,
                system=run.system.at(state),
                state=state,
                energies=book_events(run.system, run.energies, state, due),
                s_begun=np.where(state.present & ~run.state.present, state.s, run.s_begun),
                events=(*run.events, *due),
            )
        return run._with_packets(self)._carried_from(self)

    def _with_packets(self, earlier: "Run[Body]") -> "Run[Body]":
        """Return the run with packets for its holes, if they differ from those of an `earlier` run."""
        return self if np.array_equal(self.state.present, earlier.state.present) else self._fitted()

    def _carried_from(self, earlier: "Run[Body]") -> "Run[Body]":
        """Return the run with the taut strands of an `earlier` run, which has other holes or cuts."""
        if self.state is earlier.state:
            return self
        return replace(self, taut=carried_over(earlier.system, earlier.taut, earlier.state, self.system, self.state))

    def cut_when_due(self, earlier: float, dt: float) -> "Run[Body]":
        """Return the run with the cuts of the thread that are due later than `earlier` [s]. Raises
        `CouplingError`.
        """
        run = self
        for cut in self.cuts:
            if is_due(cut.time, earlier, self.state.time, dt):
                system, state, event = cut_thread(run.system, run.state, cut.s)
                state, loops = let_go_of_cut(system, state)
                energies = book_events(system, run.energies, state, [event])
                events = *run.events, event, *loops
                run = replace(run, system=system, state=state, energies=energies, events=events)
        return run

    def held_together(self) -> "Run[Body]":
        """Return the run with the strands of every tie held at their closest points.

        At rest hands hold the strands until they draw, because a slack thread would straighten and
        part them. Raises `FormingError`.
        """
        state, open_ties = self.state, ~self.state.present[self.system.strands[:, 0]]
        events = list(self.events)
        for k in np.flatnonzero(open_ties):
            state, event = begin_tie(self.system, state, int(k))
            events.append(event)
        return replace(self, state=state, events=tuple(events))._with_packets(self)._carried_from(self)

    def tied_when_due(self, earlier: float, dt: float) -> "Run[Body]":
        """Return the run with the ties that begin or are locked later than `earlier` [s]. Raises
        `FormingError`.
        """
        state, due = self.state, []
        for k, tie in enumerate(self.system.ties):
            strands = self.system.strands[k].tolist()
            if state.present[strands[0]] and tie.is_locked(state.time) and not tie.is_locked(earlier):
                state, event = lock_tie(self.system, state, k)
                due.append(event)
            elif not has_been(state, strands) and is_due(tie.begins, earlier, state.time, dt):
                state, event = begin_tie(self.system, state, k)
                due.append(event)
        if not due:
            return self
        return replace(self, state=state, events=(*self.events, *due))


def refuse_no_time(dt: float) -> None:
    """Refuse a step that is not positive and finite. Raises `CouplingError`.

    Backwards in time the damping of the scheme would create energy.
    """
    if not 0.0 < dt < np.inf:
        raise CouplingError(f"dt = {dt} s; allowed are finite numbers above 0; give the length of the step")


def begin(
    system: System[Body],
    state: State[Body],
    take: Take[Body] = bdf2_step,
    given: Array | None = None,
    halvings: int = HALVINGS,
    downhill: bool = True,
    cuts: tuple[Cut, ...] = (),
    tolerance: float = np.inf,
    marks: tuple[float, ...] = (),
) -> Run[Body]:
    """Return the run before its first step; the arguments are as for `Run`."""
    nearest, closed, system = np.full(len(system.piercings), np.nan), [], system.at(state)
    for k in [k for k, tie in enumerate(system.ties) if tie.begins == 0.0 or tie.held]:
        state, event = begin_tie(system, state, k)
        closed.append(event)
    if closed:
        system, state = fitted(system, state)
    return Run(
        system=system,
        state=state,
        energies=initial_energies(system, state),
        s_begun=state.s,
        take=take,
        given=nearest if given is None else given,
        tie_works=np.zeros(len(system.ties)),
        taut=taut_strands(system, state),
        halvings=halvings,
        tolerance=tolerance,
        downhill=downhill,
        cuts=cuts,
        marks=marks,
        events=tuple(closed),
    )


def schedule_piercings(
    system: System[Body], earlier: float, state: State[Body], dt: float, given: Array
) -> tuple[State[Body], list[Event]]:
    """Begin and end every piercing whose time is after `earlier` [s] and not after that of the
    state; return state and events.

    `dt` [s] is the step. `given` (p,) [m] are the abscissae of piercings that begin; nan means the
    thread's closest point. Raises `FormingError`, `ConstraintError`.
    """
    out = []
    for k, piercing in enumerate(system.piercings):
        if state.present[k] and is_due(piercing.ends, earlier, state.time, dt):
            out.append(Event(state.time, "ends", piercing.name, float(state.s[k])))
            state = release(state, np.arange(system.holds) == k)
    for k, piercing in enumerate(system.piercings):
        if not state.present[k] and is_due(piercing.begins, earlier, state.time, dt):
            state, event = begin_piercing(system.at(state), state, k, dt, float(given[k]))
            out.append(event)
    return state, out


def is_due(time: float, earlier: float, now: float, dt: float) -> bool:
    """Return whether a time is after `earlier` and not after `now` [s]."""
    return earlier < time - ON_TIME * dt <= now


def book_events(system: System[Body], energies: Energies, state: State[Body], events: list[Event]) -> Energies:
    """Return the audit with events booked: their work is external, and their loss is numerical."""
    if not events:
        return energies
    return booked(system, energies, state, sum(event.work for event in events), sum(event.loss for event in events))


def booked(
    system: System[Body], energies: Energies, state: State[Body], work: float = 0.0, loss: float = 0.0
) -> Energies:
    """Return the audit with the stored energies of a state, after external `work` [J] and a
    numerical `loss` [J].
    """
    now = initial_energies(system.at(state), state)
    return replace(
        energies,
        kinetic=now.kinetic,
        elastic_thread=now.elastic_thread,
        elastic_tissue=now.elastic_tissue,
        external_work=energies.external_work + work,
        numerical_dissipation=energies.numerical_dissipation + loss,
    )
