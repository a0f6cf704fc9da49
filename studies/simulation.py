"""A run: the steps of a scenario one after the other, each with what is recorded of it."""

from collections.abc import Callable, Iterator
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
from coupling.adapting import span_ratio
from coupling.baumgarte import linear_step, linear_two_pass
from coupling.configuration import configuration_of
from coupling.constraints import Passage, phi
from coupling.contact import ContactObservation, observe_contact
from coupling.diagnosis import faults
from coupling.errors import StepError
from coupling.observation import observe
from coupling.run import Run, begin
from coupling.staggered import backward_euler, staggered
from coupling.stepping import Take, try_step
from coupling.system import State, System
from coupling.two_pass import two_pass
from studies.assembly import Assembly, assemble
from studies.checkpoint import CHECKPOINT, Arrays, packed, unpacked
from studies.observables import ContactRecord, Frame, OrganRecord, OrganTopology, StepRecord, ThreadRecord
from studies.scenario import Scenario, ScenarioError, Solve
from thread.spline import Spline

Array = NDArray[np.float64]

SAMPLES = 6  # points drawn on each span of the thread
WHOLE = 1e-9  # of a step: a duration this near a whole number of steps is one


OrganRun = Run[tissue.OrganState]


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
        return self.assembly.organ.size

    @property
    def subgrid(self) -> dict[str, dict[str, Any]]:
        """By piercing, what the organ's mesh is too coarse for (`tissue.subgrid.Missing`), where that is added."""
        sites: tissue.Sites | None = getattr(self.assembly.organ, "sites", None)
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

    def _from(self, now: OrganRun) -> Iterator[tuple[StepRecord, Callable[[], Frame]]]:
        """One BLAS thread while stepping: two of them on busy cores cost more than they bring."""
        with threadpool_limits(limits=1, user_api="blas"):
            yield recorded(now), partial(self.frame, now)
            while now.number < self.steps:
                began = perf_counter()
                now = self.next(now)
                yield recorded(now, perf_counter() - began), partial(self.frame, now)

    def beginning(self) -> OrganRun:
        """The run before the first step."""
        made = self.assembly
        return begin(made.system, self.start, method(self.scenario.solve), made.resolution, made.given)

    def next(self, now: OrganRun) -> OrganRun:
        """The run one step, or load step, further."""
        solve, number = self.scenario.solve, now.number + 1
        if solve.kind == "static":
            return now.load(number / self.steps, solve.duration)
        last = number == self.steps
        dt = solve.duration - (number - 1) * solve.dt if last else solve.dt
        whole = abs(dt - solve.dt) < WHOLE * solve.dt
        return now.step(solve.dt if whole else dt, solve.duration if last else number * solve.dt)

    def frame(self, now: OrganRun) -> Frame:
        """What is drawn of a state."""
        system, state = now.system, now.state
        piercings = observe(system, now.first, state, now.configuration)
        return Frame(state.time, thread_record(system, state), piercings, self.organ_record(state))

    def organ_record(self, state: State) -> OrganRecord | None:
        """Displacement and stress of the organ, None without one."""
        body, organ = self.assembly.body, self.assembly.organ
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


def memory_of(now: OrganRun) -> Arrays:
    """All that the steps after this one depend on, as arrays by name."""
    own = {"step": np.array(now.number), "s_begun": now.s_begun, "knots": now.system.thread.spline.knots}
    return own | packed(now.state, "state") | packed(now.energies, "energies")


def remembered(beginning: OrganRun, memory: Arrays) -> OrganRun:
    """Where a run was, from what it kept in mind; `beginning` shows how that is built. Raises `ScenarioError`."""
    try:
        system, number = on_knots(beginning.system, memory["knots"]), int(memory["step"])
        state = unpacked(beginning.state, memory, "state", beginning.state)
        energies, s_begun = unpacked(beginning.energies, memory, "energies"), memory["s_begun"]
    except (KeyError, TypeError) as error:
        raise ScenarioError(
            f"{CHECKPOINT} is of another version of this code ({error}); run without --resume to begin anew"
        ) from None
    return replace(
        beginning,
        system=system,
        state=state,
        energies=energies,
        s_begun=s_begun,
        configuration=configuration_of(system, state),
        number=number,
        fresh=number == 0,
    )


def recorded(now: OrganRun, seconds: float = 0.0) -> StepRecord:
    """What is written of a step."""
    system, state = now.system, now.state
    ends = [(step.solution.problem.system, step.new, step.end.at) for step in now.taken]
    ends = ends or [(system, state, now.configuration.at)]
    return StepRecord(
        time=state.time,
        step=now.number,
        piercings=observe(system, now.first, state, now.configuration),
        energy=now.energies,
        newton_iterations=now.iterations,
        constraint_max=max(largest_gap(*end) for end in ends),
        constraint_residual=max(largest_residual(*end) for end in ends),
        start_reaction=state.reaction[0, :3],
        end_reaction=state.reaction[1, :3],
        torques=end_torques(state) if system.thread.twist else None,
        max_strain=float(np.max(np.sqrt(1.0 + 2.0 * now.configuration.points.strain) - 1.0)),
        spans=partial(span_ratio, system, state),
        seconds=seconds,
        events=now.events,
        contact=contact_record(system, state),
        kept=partial(memory_of, now),
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


def largest_gap(system: System, state: State, at: Passage) -> float:
    """Return the largest |P(s) − x| of the drawn curve over the holes the thread is in [m]: what the spline lacks in
    compliance there, and the residual."""
    return largest_at_holes(system, state, at.P - state.y[:, :3])


def largest_residual(system: System, state: State, at: Passage | None = None) -> float:
    """Return the largest |P̂ − x| over the holes the thread is in [m]: what the solve leaves open of the constraint."""
    at = at or system.passage(state.q, state.s)
    return largest_at_holes(system, state, phi(at, state.lam, state.y)[:, :3])


def largest_at_holes(system: System, state: State, gap: Array) -> float:
    """Return the length of the longest of vectors (holds, 3) at the holes the thread is in."""
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
