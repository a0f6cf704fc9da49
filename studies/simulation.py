"""A run: the steps of a scenario one after the other, each with what is recorded of it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import tissue
from coupling import bdf2
from coupling.adapting import INTERVAL, followed, span_ratio
from coupling.audit import Energies, audited, initial_energies
from coupling.baumgarte import linear_step, linear_two_pass
from coupling.constraints import phi
from coupling.contact import ContactObservation, observe_contact
from coupling.diagnosis import faults
from coupling.equilibrium import load_step
from coupling.errors import StepError
from coupling.events import Event, booked, noticed, scheduled
from coupling.observation import observe
from coupling.staggered import backward_euler, staggered
from coupling.stepping import Step, Take, advance, try_step
from coupling.system import State, System
from coupling.two_pass import two_pass
from studies.assembly import Assembly, assemble
from studies.checkpoint import CHECKPOINT, Arrays, packed, unpacked
from studies.observables import ContactRecord, Frame, OrganRecord, OrganTopology, StepRecord, ThreadRecord
from studies.scenario import Scenario, ScenarioError, Solve
from thread.spline import Spline

Array = NDArray[np.float64]

SAMPLES = 6  # points drawn on each span of the thread
EQUILIBRIA = 4  # further ones of a load step at most, on knots that fit the one before
WHOLE = 1e-9  # of a step: a duration this near a whole number of steps is one


@dataclass(frozen=True)
class Standing:
    """Where a run is after `step` steps: all that the next ones depend on.

    `system` is the one whose knots the thread has. `s_begun` (holds,) [m]: the abscissae that slip is measured from,
    where each piercing began.
    """

    step: int
    system: System
    state: State
    energies: Energies
    s_begun: Array

    @property
    def first(self) -> State:
        """A state at the abscissae that slip is measured from."""
        return replace(self.state, s=self.s_begun)

    @property
    def memory(self) -> Arrays:
        """The same as arrays by name."""
        own = {"step": np.array(self.step), "s_begun": self.s_begun, "knots": self.system.thread.spline.knots}
        return own | packed(self.state, "state") | packed(self.energies, "energies")


@dataclass(frozen=True)
class Simulation:
    """A scenario ready to run, with the consistent start."""

    assembly: Assembly
    start: State

    @property
    def scenario(self) -> Scenario:
        """As run: with the defaults that the geometry tells."""
        return self.assembly.scenario

    @cached_property
    def topology(self) -> OrganTopology | None:
        """The organ's mesh, None without an organ."""
        body = self.assembly.body
        return None if body is None else OrganTopology(body.points, body.cells)

    @property
    def tissue_dofs(self) -> int:
        """Unknowns of the organ that are not held."""
        return self.assembly.system.organ.size

    @property
    def subgrid(self) -> dict[str, dict[str, Any]]:
        """By piercing, what the organ's mesh is too coarse for (`tissue.subgrid.Missing`), where that is added."""
        sites: tissue.Sites | None = getattr(self.assembly.system.organ, "sites", None)
        named = zip(self.scenario.piercing, sites.missing if sites else (), strict=False)
        return {hole.name: gap.record() for hole, gap in named if gap is not None}

    @property
    def steps(self) -> int:
        """Steps to be taken."""
        solve = self.scenario.solve
        return solve.load_steps if solve.kind == "static" else ceil(solve.duration / solve.dt - WHOLE)

    @cached_property
    def recovery(self) -> tissue.StressRecovery | None:
        """Stress from displacement, None without an organ."""
        return None if self.assembly.body is None else tissue.stress_recovery(self.assembly.body)

    def advance(self, memory: Arrays | None = None) -> Iterator[tuple[StepRecord, Callable[[], Frame]]]:
        """The start, then every step, each with a function that makes its frame.

        With the `memory` of a step's record: that step again, then those after it. Raises `ScenarioError` for a memory
        that is none of this simulation.
        """
        return self._from(self.beginning() if memory is None else remembered(self.beginning(), memory))

    def _from(self, now: Standing) -> Iterator[tuple[StepRecord, Callable[[], Frame]]]:
        """One BLAS thread while stepping: two of them on busy cores cost more than they bring."""
        with threadpool_limits(limits=1, user_api="blas"):
            yield recorded(now), partial(self.frame, now)
            for number in range(now.step + 1, self.steps + 1):
                began = perf_counter()
                now, taken, events = self.next(now, number)
                record = recorded(now, taken, events, perf_counter() - began)
                yield record, partial(self.frame, now)

    def beginning(self) -> Standing:
        """The run before the first step."""
        system, state = self.assembly.system, self.start
        return Standing(0, system, state, initial_energies(system, state), state.s)

    def next(self, now: Standing, number: int) -> tuple[Standing, list[Step], list[Event]]:
        """Step `number`, then the piercings that end or begin with it: where the run is then, and how it got there."""
        end, taken, events = self.solved(now, number)
        system, solve = end.system, self.scenario.solve
        state, due = scheduled(system, now.state.time, end.state, solve.dt, self.assembly.given)
        s_begun = np.where(state.present & ~end.state.present, state.s, now.s_begun)
        energies = booked(system, end.energies, state, due)
        return Standing(number, system, state, energies, s_begun), taken, events + due

    def solved(self, now: Standing, number: int) -> tuple[Standing, list[Step], list[Event]]:
        """Step `number` on knots that fit the state it begins with, so that what is recorded is solved for on its own
        knots. An equilibrium is far from where it began: it is found again on the knots that fit it."""
        # A thread that has just been laid is under no tension to go by.
        now, events = self.refitted(now, number) if number > 1 else (now, [])
        now, taken, found = self.on_its_knots(now, number)
        events = events + found
        for _ in range(EQUILIBRIA if self.scenario.solve.kind == "static" else 0):
            now, knots = self.refitted(now, number)
            if not knots:
                break
            now, again, found = self.on_its_knots(now, number)
            taken, events = taken + again, events + knots + found
        return now, taken, events

    def on_its_knots(self, now: Standing, number: int) -> tuple[Standing, list[Step], list[Event]]:
        """Step `number` on the knots that the thread has, audited."""
        taken, energies = self.take(now.system, now.state, number), now.energies
        for step in taken:
            energies = audited(now.system, energies, step)
        found = noticed(now.system, now.state, taken)
        return replace(now, state=taken[-1].new, energies=energies), taken, found

    def refitted(self, now: Standing, number: int) -> tuple[Standing, list[Event]]:
        """The run with the knots that fit its state, where they are to follow it and step `number` is to look."""
        resolution, solve = self.assembly.resolution, self.scenario.solve
        if resolution is None:
            return now, []
        due = solve.kind == "static" or number % INTERVAL == 1
        system, state, knots = followed(resolution, now.system, now.state, solve.dt, due)
        if not knots:
            return now, []
        return replace(now, system=system, state=state, energies=booked(system, now.energies, state, knots)), knots

    def take(self, system: System, state: State, number: int) -> list[Step]:
        """Step `number` (1 is the first) from `state`; more than one where it had to be halved."""
        solve = self.scenario.solve
        if solve.kind == "static":
            return load_step(system, state, number / self.steps, solve.duration)
        last = number == self.steps
        dt = solve.duration - (number - 1) * solve.dt if last else solve.dt
        taken = advance(system, state, solve.dt if abs(dt - solve.dt) < WHOLE * solve.dt else dt, method(solve))
        time = solve.duration if last else number * solve.dt
        return [*taken[:-1], replace(taken[-1], new=replace(taken[-1].new, time=time))]

    def frame(self, now: Standing) -> Frame:
        """What is drawn of a state."""
        system, state = now.system, now.state
        piercings = observe(system, now.first, state)
        return Frame(state.time, thread_record(system, state), piercings, self.organ_record(state))

    def organ_record(self, state: State) -> OrganRecord | None:
        """Displacement and stress of the organ, None without one."""
        body, organ = self.assembly.body, self.assembly.system.organ
        if body is None or self.recovery is None:
            return None
        U = organ.displacement(state.organ)
        stress = self.recovery.stress(U)
        lips = on_lips(self.assembly.system, state, len(body.points))
        return OrganRecord(body.nodal(U), stress, tissue.von_mises(stress), *lips)


def method(solve: Solve) -> Take:
    """How a step is taken: by which integrator, and with the organ in the same system or after the thread."""
    integrators = {"euler": (try_step, backward_euler), "bdf2": (bdf2.take, bdf2.scheme_of)}
    thread_step, scheme_of = integrators[solve.integrator]
    if solve.friction == "two-pass":
        thread_step = two_pass
    if solve.scheme == "linear":
        thread_step = linear_two_pass if solve.friction == "two-pass" else linear_step
    return staggered(thread_step, scheme_of) if solve.coupling == "staggered" else thread_step


def prepare(scenario: Scenario) -> Simulation:
    """Everything before the first step. Raises the errors of input that cannot be run."""
    assembly = assemble(scenario)
    with threadpool_limits(limits=1, user_api="blas"):
        return Simulation(assembly, sound_start(assembly))


def sound_start(assembly: Assembly) -> State:
    """The consistent start. Raises `ScenarioError` where there is none, or the constraints cannot be met."""
    try:
        state = assembly.start()
    except StepError as error:
        raise ScenarioError(
            f"thread.path is refused: the thread cannot be laid along it through its piercings ({error.cause}); "
            "let the path pass nearer to them and bend less"
        ) from error
    problems = faults(assembly.system, state)
    if problems:
        raise ScenarioError(problems)
    return state


def on_knots(system: System, knots: Array) -> System:
    """The system with its thread on other knots."""
    return replace(system, thread=replace(system.thread, spline=Spline(knots)))


def remembered(beginning: Standing, memory: Arrays) -> Standing:
    """Where a run was, from what it kept in mind; `beginning` shows how that is built. Raises `ScenarioError`."""
    try:
        return Standing(
            step=int(memory["step"]),
            system=on_knots(beginning.system, memory["knots"]),
            state=unpacked(beginning.state, memory, "state", beginning.state.organ),
            energies=unpacked(beginning.energies, memory, "energies"),
            s_begun=memory["s_begun"],
        )
    except (KeyError, TypeError) as error:
        raise ScenarioError(
            f"{CHECKPOINT} is of another version of this code ({error}); run without --resume to begin anew"
        ) from None


def recorded(
    now: Standing, taken: Sequence[Step] = (), events: Sequence[Event] = (), seconds: float = 0.0
) -> StepRecord:
    """What is written of a step."""
    system, state = now.system, now.state
    points = system.thread.points(state.q, state.frame)
    return StepRecord(
        time=state.time,
        step=now.step,
        piercings=observe(system, now.first, state),
        energy=now.energies,
        newton_iterations=sum(step.solution.iterations for step in taken),
        constraint_max=max(largest_gap(*each) for each in at_ends(system, state, taken)),
        constraint_residual=max(largest_residual(*each) for each in at_ends(system, state, taken)),
        start_reaction=state.reaction[0, :3],
        end_reaction=state.reaction[1, :3],
        torques=end_torques(state) if system.thread.twist else None,
        max_strain=float(np.max(np.sqrt(1.0 + 2.0 * points.strain) - 1.0)),
        span_ratio=span_ratio(system, state),
        seconds=seconds,
        events=tuple(events),
        contact=contact_record(system, state),
        memory=now.memory,
    )


def pressures(system: System, lips: ContactObservation) -> Array:
    """Pressure at the pairs of the lips, shape `(k,)` [Pa]."""
    organ: Any = system.organ
    return np.asarray(organ.gaps.pressure(lips.force))


def contact_record(system: System, state: State) -> ContactRecord | None:
    """The lips of a state, None where they may cross."""
    lips = observe_contact(system, state)
    if lips is None:
        return None
    return ContactRecord(
        pairs=len(lips.gap),
        pressed=lips.pressed,
        smallest_gap=float(lips.gap.min()),
        largest_pressure=float(pressures(system, lips).max()),
        force=float(lips.force.sum()),
        complementarity=lips.complementarity,
    )


def on_lips(system: System, state: State, nodes: int) -> tuple[Array, Array] | tuple[None, None]:
    """Pressure and gap of the lips at all nodes of the organ, `(nodes,)` each [Pa, m]."""
    lips = observe_contact(system, state)
    if lips is None:
        return None, None
    organ: Any = system.organ
    pressure, gap = np.zeros(nodes), np.full(nodes, np.nan)
    for side in organ.gaps.nodes.T:
        pressure[side], gap[side] = pressures(system, lips), lips.gap
    return pressure, gap


def end_torques(state: State) -> tuple[float, float]:
    """Torque of the holders of start and end about the thread's tangent [N m]."""
    start, end = state.reaction[:, 3]
    return float(start), float(end)


def at_ends(system: System, state: State, taken: Sequence[Step]) -> list[tuple[System, State]]:
    """The ends of the steps taken, each with the system that it was solved for; the state given if there are none."""
    return [(step.solution.problem.system, step.new) for step in taken] or [(system, state)]


def largest_gap(system: System, state: State) -> float:
    """Largest |P(s) − x| of the drawn curve over the holes the thread is in [m]: what the spline lacks in compliance
    there, and the residual."""
    at = system.passage(state.q, state.s)
    return largest_at_holes(system, state, at.P - state.y[:, :3])


def largest_residual(system: System, state: State) -> float:
    """Largest |P̂ − x| over the holes the thread is in [m]: what the solve leaves open of the constraint."""
    at = system.passage(state.q, state.s)
    return largest_at_holes(system, state, phi(at, state.lam, state.y)[:, :3])


def largest_at_holes(system: System, state: State, gap: Array) -> float:
    """Length of the longest of vectors (holds, 3) at the holes the thread is in."""
    size = np.linalg.norm(gap, axis=1)
    return float(np.max(size[system.rows[:, 0] & state.present], initial=0.0))


def thread_record(system: System, state: State) -> ThreadRecord:
    """The thread sampled evenly on each span; tension is interpolated between the Gauss points, where it is best."""
    thread, spline = system.thread, system.thread.spline
    breaks, ends = spline.breaks, np.searchsorted(spline.breaks, spline.piece_ends)
    inner = np.arange(SAMPLES) / SAMPLES
    inside = (breaks[:-1, None] + np.diff(breaks)[:, None] * inner).ravel()
    s = np.insert(inside, SAMPLES * ends[1:], spline.piece_ends[1:])
    pieces = tuple((SAMPLES * np.diff(ends) + 1).tolist())
    home = np.repeat(spline.piece_ends[:-1], pieces)
    P, T, K, _ = spline.curve(state.q[:, :3], s, home).swapaxes(0, 1)
    speed = np.linalg.norm(T, axis=1)
    strain = thread.points(state.q, state.frame).strain.ravel()
    tension = thread.EA * strain * np.sqrt(1.0 + 2.0 * strain)
    return ThreadRecord(
        points=P,
        s=s,
        tension=piecewise(spline, s, home, thread.axial.s.ravel(), tension),
        curvature=np.linalg.norm(np.cross(T, K), axis=1) / speed**3,
        radius=0.5 * thread.section.diameter,
        pieces=pieces if spline.cuts.size else (),
        torque=None if state.frame is None else thread.torque_at(s, state.q, state.frame),
    )


def piecewise(spline: Spline, s: Array, home: Array, at: Array, values: Array) -> Array:
    """Values known at abscissae `at`, interpolated at `s` within the piece of the thread that holds `home`."""
    piece, own = spline.piece_of(home), spline.piece_of(at)
    return np.concatenate([np.interp(s[piece == k], at[own == k], values[own == k]) for k in range(spline.pieces)])
