"""A run: the steps of a scenario one after the other, each with what is recorded of it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import tissue
from coupling.audit import Energies, audited, initial_energies
from coupling.constraints import passage, phi
from coupling.equilibrium import load_step
from coupling.observation import observe
from coupling.stepping import Step, advance
from coupling.system import State, System
from studies.assembly import Assembly, assemble
from studies.observables import Frame, OrganRecord, OrganTopology, StepRecord, ThreadRecord
from studies.scenario import Scenario

Array = NDArray[np.float64]

SAMPLES = 6  # points drawn on each span of the thread
WHOLE = 1e-9  # of a step: a duration this near a whole number of steps is one


@dataclass(frozen=True)
class Simulation:
    """A scenario ready to run."""

    assembly: Assembly

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
    def steps(self) -> int:
        """Steps to be taken."""
        solve = self.scenario.solve
        return solve.load_steps if solve.kind == "static" else ceil(solve.duration / solve.dt - WHOLE)

    @cached_property
    def recovery(self) -> tissue.StressRecovery | None:
        """Stress from displacement, None without an organ."""
        return None if self.assembly.body is None else tissue.stress_recovery(self.assembly.body)

    def advance(self) -> Iterator[tuple[StepRecord, Callable[[], Frame]]]:
        """The start, then every step, each with a function that makes its frame.

        One BLAS thread while stepping: two of them on busy cores cost more than they bring.
        """
        with threadpool_limits(limits=1, user_api="blas"):
            yield from self._advance()

    def _advance(self) -> Iterator[tuple[StepRecord, Callable[[], Frame]]]:
        system, state = self.assembly.system, self.assembly.start()
        first, energies = state, initial_energies(system, state)
        yield recorded(system, first, state, energies, 0, [], 0.0), partial(self.frame, first, first)
        for number in range(1, self.steps + 1):
            began = perf_counter()
            taken = self.take(state, number)
            for step in taken:
                energies = audited(system, energies, step)
            state = taken[-1].new
            seconds = perf_counter() - began
            record = recorded(system, first, state, energies, number, taken, seconds)
            yield record, partial(self.frame, first, state)

    def take(self, state: State, number: int) -> list[Step]:
        """Step `number` (1 is the first) from `state`; more than one where it had to be halved."""
        solve, system = self.scenario.solve, self.assembly.system
        if solve.kind == "static":
            return load_step(system, state, number / self.steps, solve.duration)
        last = number == self.steps
        dt = solve.duration - (number - 1) * solve.dt if last else solve.dt
        taken = advance(system, state, solve.dt if abs(dt - solve.dt) < WHOLE * solve.dt else dt)
        time = solve.duration if last else number * solve.dt
        return [*taken[:-1], replace(taken[-1], new=replace(taken[-1].new, time=time))]

    def frame(self, first: State, state: State) -> Frame:
        """What is drawn of a state."""
        system = self.assembly.system
        piercings = observe(system, first, state)
        return Frame(state.time, thread_record(system, state), piercings, self.organ_record(state))

    def organ_record(self, state: State) -> OrganRecord | None:
        """Displacement and stress of the organ, None without one."""
        body, organ = self.assembly.body, self.assembly.system.organ
        if body is None or self.recovery is None:
            return None
        U = organ.displacement(state.organ)
        stress = self.recovery.stress(U)
        return OrganRecord(body.nodal(U), stress, tissue.von_mises(stress))


def prepare(scenario: Scenario) -> Simulation:
    """Everything before the first step. Raises the errors of input that cannot be run."""
    return Simulation(assemble(scenario))


def recorded(
    system: System,
    first: State,
    state: State,
    energies: Energies,
    number: int,
    taken: list[Step],
    seconds: float,
) -> StepRecord:
    """What is written of a step."""
    points = system.thread.points(state.q)
    return StepRecord(
        time=state.time,
        step=number,
        piercings=observe(system, first, state),
        energy=energies,
        newton_iterations=sum(step.solution.iterations for step in taken),
        constraint_max=max((largest_gap(system, step.new) for step in taken), default=largest_gap(system, state)),
        start_reaction=state.reaction[0],
        end_reaction=state.reaction[1],
        max_strain=float(np.max(np.sqrt(1.0 + 2.0 * points.strain) - 1.0)),
        seconds=seconds,
    )


def largest_gap(system: System, state: State) -> float:
    """Largest |P(s) − x| over the holes the thread is in [m]."""
    at = passage(system.thread.spline, state.q, state.s)
    gap = np.linalg.norm(phi(at, state.y)[:, :3], axis=1)
    return float(np.max(gap[system.rows[:, 0] & state.present], initial=0.0))


def thread_record(system: System, state: State) -> ThreadRecord:
    """The thread sampled evenly on each span; tension is interpolated between the Gauss points, where it is best."""
    thread = system.thread
    breaks = thread.spline.breaks
    inner = np.arange(SAMPLES) / SAMPLES
    s = np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * inner).ravel(), breaks[-1])
    P, T, K, _ = thread.spline.curve(state.q, s).swapaxes(0, 1)
    speed = np.linalg.norm(T, axis=1)
    strain = thread.points(state.q).strain.ravel()
    tension = thread.EA * strain * np.sqrt(1.0 + 2.0 * strain)
    return ThreadRecord(
        points=P,
        s=s,
        tension=np.interp(s, thread.elastic_rule.s.ravel(), tension),
        curvature=np.linalg.norm(np.cross(T, K), axis=1) / speed**3,
        radius=0.5 * thread.section.diameter,
    )
