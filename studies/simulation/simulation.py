"""A run: the steps of a scenario one after the other, each with what is recorded of it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import tissue
from coupling import stepping
from coupling.cutting import Cut
from coupling.diagnosis import faults
from coupling.errors import StepError
from coupling.paper.linear_step import checked, linear_step, linear_two_pass
from coupling.paper.staggered import backward_euler, stagger
from coupling.paper.two_pass import two_pass
from coupling.run import begin
from coupling.stepping import Take, try_step
from coupling.system import State
from studies.arrays import Array
from studies.output.checkpoint import Arrays
from studies.output.records import Ending, OrganRecord, OrganTopology, Snapshot, StepRecord
from studies.output.remarks import SMALL_ROTATION, SMALL_STRAIN, Remark
from studies.scenario import Scenario, ScenarioError, Solve
from studies.scenario.solve import WHOLE
from studies.simulation.assembly import Assembly, assemble
from studies.simulation.memory import OrganRun, recall
from studies.simulation.recording import lip_fields, own_holes, step_record, thread_record
from studies.simulation.remarks import foreseen, met
from studies.simulation.sharing import Store
from studies.simulation.tracts import Ball


@dataclass(frozen=True)
class Simulation:
    """A scenario ready to run, with the consistent start."""

    assembly: Assembly
    start: State

    def __repr__(self) -> str:
        title = f"{self.scenario.title!r}, " if self.scenario.title else ""
        holes = len(self.scenario.piercing)
        return f"Simulation({title}{holes} piercings, {self.tissue_dofs} tissue unknowns, {self.steps} steps)"

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
        """By piercing, and by tract of the ball that most is added to, what the organ's mesh is too coarse for
        (`tissue.sites.subgrid.Missing`), where that is added.
        """
        sites: tissue.Sites | None = getattr(self.assembly.organ, "sites", None)
        named = zip(self.assembly.holes, sites.missing if sites else (), strict=False)
        known = [(hole, gap.record()) for hole, gap in named if gap is not None]
        alone = {hole.name: gap for hole, gap in known if not isinstance(hole, Ball)}
        balls = sorted(((h.tract, gap) for h, gap in known if isinstance(h, Ball)), key=lambda ball: ball[1]["share"])
        return alone | dict(balls)

    @cached_property
    def foreseen(self) -> list[Remark]:
        """What is to be said of the run before its first step."""
        return foreseen(self.assembly, self.subgrid)

    def remarks(self, ending: Ending | None = None) -> list[Remark]:
        """Return what is to be said of the run: what is foreseen, and what it met until an `ending`."""
        strengths = [hole.strength for hole in self.assembly.system.piercings if not hole.tract]
        springs = {name: float(gap["share"]) for name, gap in self.subgrid.items()}
        return [*self.foreseen, *(met(self.scenario, ending, strengths, springs) if ending else [])]

    @property
    def methods(self) -> dict[str, str | None]:
        """By what the run is solved; `solver` is that of the organ, as `auto` chose it, None without one."""
        solve, choice = self.scenario.solve, getattr(self.assembly.organ, "choice", None)
        ways = {name: str(getattr(solve, name)) for name in ("kind", "scheme", "integrator", "coupling", "friction")}
        return {"solver": choice.name if choice else None, **ways}

    @property
    def steps(self) -> int:
        """Steps to be taken."""
        return self.scenario.solve.steps

    @cached_property
    def recovery(self) -> tissue.StressRecovery | None:
        """Stress from displacement, None without an organ."""
        return self.assembly.recovery()

    def advance(self, memory: Arrays | None = None) -> Iterator[tuple[StepRecord, Callable[[], Snapshot]]]:
        """Yield the start, then every step, each with a function that makes its frame.

        With the `memory` of a step's record: that step again, then those after it. Raises `ScenarioError` for a memory
        that is none of this simulation.
        """
        return self._from(self.beginning() if memory is None else recall(self.beginning(), memory))

    def _from(self, now: OrganRun) -> Iterator[tuple[StepRecord, Callable[[], Snapshot]]]:
        """Keep BLAS to one thread while stepping: two of them on busy cores cost more than they bring."""
        with threadpool_limits(limits=1, user_api="blas"):
            yield step_record(now), partial(self.snapshot, now)
            while now.number < self.steps:
                began = perf_counter()
                now = self.next(now)
                record = step_record(now, perf_counter() - began)
                yield record if self.is_on_grid(now) else replace(record, kept=None), partial(self.snapshot, now)

    def is_on_grid(self, now: OrganRun) -> bool:
        """Tell whether a run of a longer duration comes by the same state; not by the end of a last step cut short."""
        solve = self.scenario.solve
        return solve.kind == "static" or now.state.time == now.number * solve.dt

    def beginning(self) -> OrganRun:
        """Return the run before the first step."""
        made, solve = self.assembly, self.scenario.solve
        one_system = (solve.scheme, solve.coupling, solve.friction) == ("newton", "monolithic", "implicit")
        cuts = tuple(Cut(table.s, table.time) for table in self.scenario.cut)
        return begin(
            made.system,
            self.start,
            method(solve),
            made.resolution,
            made.begin_abscissae,
            downhill=one_system,
            cuts=cuts,
        )

    def next(self, now: OrganRun) -> OrganRun:
        """Return the run one step, or load step, further."""
        solve, number = self.scenario.solve, now.number + 1
        if solve.kind == "static":
            return now.load(number / self.steps, solve.duration)
        last = number == self.steps
        dt = solve.duration - (number - 1) * solve.dt if last else solve.dt
        whole = abs(dt - solve.dt) < WHOLE * solve.dt
        return now.step(solve.dt if whole else dt, solve.duration if last else number * solve.dt)

    def snapshot(self, now: OrganRun) -> Snapshot:
        """Return what is drawn of a state."""
        return Snapshot(now.state.time, thread_record(now), own_holes(now.piercings), self.organ_record(now.state))

    def organ_record(self, state: State) -> OrganRecord | None:
        """Return the displacement, stress and strain of the organ, None without one."""
        body, organ = self.assembly.body, self.assembly.organ
        if isinstance(organ, tissue.FiniteOrgan):
            wide = np.array([max(hole.footprint, np.finfo(float).tiny) for hole in self.assembly.holes])
            alone = [not isinstance(hole, Ball) for hole in self.assembly.holes]
            ways = (organ.spring_ways(state.organ) / wide)[alone]
            return finite_record(organ.law, organ.displacement(state.organ), ways)
        if body is None or self.recovery is None or isinstance(organ, tissue.FixedSites):
            return None
        U = organ.displacement(state.organ)
        stress = self.recovery.stress(U)
        lips = lip_fields(self.assembly.system, state, len(body.points))
        strain, rotation = tissue.cell_strain(body, U)
        beyond = strain > SMALL_STRAIN, rotation > SMALL_ROTATION
        strained, rotated = (tissue.energy_share(body, strain, cells) for cells in beyond)
        values, directions = tissue.principal(stress)
        at_nodes = stress, tissue.von_mises(stress), values, directions[:, 0], directions[:, 2]
        numbers = *at_nodes, strain, rotation, tissue.energy_density(body, U), strained, rotated
        turns = organ.surface.turns(body.nodal(U))
        return OrganRecord(body.nodal(U), *numbers, float(turns.max(initial=0.0)), *lips)


def finite_record(hyper: tissue.Hyperelasticity, U: Array, sprung: Array) -> OrganRecord:
    """Return what is drawn of an organ at finite strain: Cauchy stress, stretch less one, and rotation; `sprung` (p,)
    is how far its springs are drawn out, over the footprints. Nothing else is beyond what its model holds for."""
    stress = tissue.cauchy_stress(hyper, U)
    stretch, rotation = tissue.cell_stretch(hyper, U)
    strain = np.abs(stretch - 1.0).max(axis=1)
    values, directions = tissue.principal(stress)
    at_nodes = stress, tissue.von_mises(stress), values, directions[:, 0], directions[:, 2]
    return OrganRecord(
        hyper.body.nodal(U), *at_nodes, strain, rotation, tissue.cell_energy(hyper, U), 0.0, 0.0, sprung=sprung
    )


def method(solve: Solve) -> Take:
    """Tell how a step is taken: by which integrator, and with the organ in the same system or after the thread."""
    ways = {"euler": (try_step, backward_euler), "bdf2": (stepping.bdf2_step, stepping.scheme_of)}
    thread_step: Take
    thread_step, scheme_of = ways[solve.integrator]
    if solve.friction == "two-pass":
        thread_step = two_pass
    if solve.scheme == "linear":
        thread_step = checked(linear_two_pass if solve.friction == "two-pass" else linear_step)
    return stagger(thread_step, scheme_of) if solve.coupling == "staggered" else thread_step


def prepare(scenario: Scenario, store: Store | None = None, mesh: object = None) -> Simulation:
    """Prepare everything that is known before the first step.

    What a `store` has of mesh, organ and factor is shared, None: made anew. `mesh` [m]: the organ's in place of that of
    the scenario, a `skfem.MeshTet`, a meshio mesh or a pyvista grid of tetrahedra; a scenario that has no other says
    `kind = "given"`. Raises the errors of input that cannot be run.
    """
    assembly = assemble(scenario, store, mesh)
    with threadpool_limits(limits=1, user_api="blas"):
        return Simulation(assembly, sound_start(assembly))


def sound_start(assembly: Assembly) -> State:
    """Return the consistent start. Raises `ScenarioError` where there is none, or the constraints cannot be met."""
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
