"""A run: the steps of a scenario in order, each with its record."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from time import perf_counter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import tissue
from coupling.errors import FormingError, StepError, UnbalancedError
from coupling.interfaces import FrictionLaw
from coupling.paper.linear_step import checked, linear_step, linear_two_pass
from coupling.paper.staggered import backward_euler, stagger
from coupling.paper.two_pass import two_pass
from coupling.rest.equilibrium import refuse_unbalanced
from coupling.run import begin
from coupling.run.cutting import Cut
from coupling.step import stepping
from coupling.step.diagnosis import faults
from coupling.step.solver import covers
from coupling.step.stepping import Take, try_step
from coupling.system import State
from meshes.errors import MeshError
from studies.arrays import Array
from studies.output.checkpoint import Arrays
from studies.output.fields import OrganTopology
from studies.output.records import Ending, OrganRecord, Record, Snapshot, StepRecord
from studies.output.remarks import Remark, bounds
from studies.output.tally import Tally
from studies.scenario import Scenario, ScenarioError, Solve, WoundMesh, because, check_given, refused
from studies.scenario.organ import LIPS
from studies.scenario.solve import WHOLE
from studies.scenario.stitch import with_origin
from studies.simulation.assembly import Assembly, assemble, bounds_of, marks_of, shareable
from studies.simulation.given import Energy, Given, Stiffness
from studies.simulation.memory import OrganRun, recall
from studies.simulation.organ import lip_gaps
from studies.simulation.recording import lip_fields, own_holes, step_record, thread_record
from studies.simulation.remarks import foreseen, met
from studies.simulation.sharing import Shared, start_key
from studies.simulation.stepper import Stepper, WhichEnd
from studies.simulation.tracts import of_piercings
from thread.errors import ThreadError

Made = TypeVar("Made")
REFUSALS = (ScenarioError, MeshError, tissue.TissueError, ThreadError)  # of input, before the first step
OnStep = Callable[[StepRecord], None]
Moments = Iterator[tuple[StepRecord, Callable[[], Snapshot]]]  # steps, each with a function that makes its frame
AT_ONCE = 50  # largest number of steps before they are recorded: the user cannot see or stop steps before


def timed(make: Callable[[], Made], compiles: bool) -> tuple[Made, float]:
    """Return the result of a function and its wall-clock time [s].

    The time is without compilation if the function `compiles` loops.
    """
    began = perf_counter()
    if not compiles:
        return make(), perf_counter() - began
    from numba.core.event import install_timer

    compiling: list[float] = []
    with install_timer("numba:compile", compiling.append):
        result = make()
    return result, perf_counter() - began - sum(compiling)


@dataclass(frozen=True)
class Simulation:
    """A scenario ready to run, with its consistent start.

    `on_step` is called with the record of every step.
    """

    assembly: Assembly
    start: State
    on_step: OnStep | None = None

    def __repr__(self) -> str:
        title = f"{self.scenario.title!r}, " if self.scenario.title else ""
        holes = len(self.scenario.piercing)
        return f"Simulation({title}{holes} piercings, {self.tissue_dofs} tissue unknowns, {self.steps} steps)"

    @property
    def scenario(self) -> Scenario:
        """The scenario as run, with the defaults from the geometry."""
        return self.assembly.scenario

    @cached_property
    def topology(self) -> OrganTopology | None:
        """The organ's mesh, None without an organ."""
        body = self.assembly.body
        return None if body is None else OrganTopology(body.points, body.cells)

    @property
    def held(self) -> Array:
        """Places of the nodes that clamps and rollers hold, shape `(k, 3)` [m]."""
        body, table = self.assembly.body, self.scenario.tissue
        if body is None or table is None:
            return np.empty((0, 3))
        nodes = tissue.held_components(body.mesh, table.clamp, table.roller).any(axis=1)
        return np.asarray(body.mesh.p.T[nodes])

    @property
    def tissue_dofs(self) -> int:
        """Number of the organ's unknowns that are not held."""
        return self.assembly.organ.size

    @property
    def balls(self) -> int:
        """Number of balls of all tracts."""
        return len(self.assembly.holes) - len(self.scenario.piercing)

    @cached_property
    def refinement(self) -> dict[str, Any]:
        """The rounds of refinement at the holes, and the errors of their compliance.

        `rounds` are records. `errors` are the estimated relative errors by piercing [-]. The result
        is empty without refinement. With `tissue.mesh.bound` it has also the `bounds` of the exact
        compliance over the compliance of the mesh, lower and upper [-].
        """
        fit, out = self.assembly.fit, dict[str, Any]()
        if fit is not None:
            out = {"rounds": [one.record() for one in fit.rounds], "errors": self._by_piercing(fit.errors)}
        if (bounds := bounds_of(self.scenario, self.assembly.body, self.assembly.holes)) is not None:
            out["bounds"] = self._by_piercing(bounds)
        return out

    def _by_piercing(self, values: Array) -> dict[str, Any]:
        """Return finite values by the names of their piercings.

        `values` (p,) or (p, k) are those of all holes, with the balls of tracts.
        """
        own = of_piercings(self.assembly.holes, values.tolist())
        named = zip((hole.name for hole in self.scenario.piercing), own, strict=True)
        return {name: value for name, value in named if np.isfinite(value).all()}

    @cached_property
    def foreseen(self) -> list[Remark]:
        """Remarks on the run before its first step."""
        return list(foreseen(self.assembly, self.start.q))

    def remarks(self, ending: Ending | None = None) -> list[Remark]:
        """Return the remarks on the run before the first step and, if given, up to an `ending`."""
        return [*self.foreseen, *(met(self.assembly, ending) if ending else [])]

    def tally(self, memory: Arrays | None = None) -> Tally:
        """Return the tally of a run, continued from the `memory` of a step's record."""
        return Tally(self.scenario, self.tissue_dofs, self.remarks, memory, self.refinement)

    @property
    def methods(self) -> dict[str, str | None]:
        """The solution methods.

        `solver` is the organ's solver after the choice of `auto`. `organ` is the initial solution
        of its steps: "whole" or in its "krylov" space; both are None without an organ. A recorder
        adds the step of a change to the whole organ.
        """
        solve, choice = self.scenario.solve, getattr(self.assembly.organ, "choice", None)
        space = "krylov" if isinstance(self.assembly.organ, tissue.KrylovOrgan) else "whole"
        organ = space if choice else None
        ways = solve.model_dump(include={"kind", "start", "scheme", "integrator", "coupling", "friction"})
        return {"solver": choice.name if choice else None, "organ": organ, "newton": self._newton, **ways}

    @property
    def _newton(self) -> str:
        """Solution of the steps, if possible: "compiled" loops, else "numpy"."""
        solve, organ, system = self.scenario.solve, self.assembly.organ, self.assembly.system
        iterates = solve.kind == "static" or solve.scheme == "newton"
        linear = getattr(organ, "gaps", None) is None and not isinstance(organ, tissue.FiniteOrgan)
        return "compiled" if system.compiled and iterates and linear and covers(system) else "numpy"

    @property
    def steps(self) -> int:
        """Number of steps to be taken."""
        return self.scenario.solve.steps

    @cached_property
    def open_lips(self) -> tissue.Gaps | None:
        """The lips of a wound without contact, None without such lips."""
        body, table = self.assembly.body, self.scenario.tissue
        contactless = LIPS in self.scenario.wounds and LIPS not in self.scenario.touching
        if body is None or table is None or not contactless or not isinstance(table.mesh, WoundMesh):
            return None
        return lip_gaps(table.mesh, body)

    def record(self, now: OrganRun, seconds: float = 0.0) -> StepRecord:
        """Return the record of a step whose computation took `seconds`."""
        return step_record(now, seconds, self.open_lips)

    def advance(self, memory: Arrays | None = None) -> Moments:
        """Yield the start, then every step, each with a function that makes its frame.

        With the `memory` of a step's record: this step again, then the steps after it. Raises
        `ScenarioError` for a memory of another simulation.
        """
        at_rest = self.scenario.solve.start == "rest"
        if memory is None:
            return self._from(self.laid(), at_rest)
        return self._from(recall(replace(self.laid(), fresh=not at_rest), memory), False)

    def _from(self, now: OrganRun, rests: bool) -> Moments:
        """Yield the steps from the present state, or from its state of rest.

        BLAS uses one thread: on busy cores two threads are slower. No checkpoint is kept of a last
        step that was shortened, because a longer run does not reach its state.
        """
        solve = self.scenario.solve
        with threadpool_limits(limits=1, user_api="blas"):
            now = now.rested() if rests else now
            yield from self._reported(self.record(now), now)
            while now.number < self.steps:
                runs, seconds = timed(partial(self.onward, now), self._newton == "compiled")
                for run in runs:
                    record = self.record(run, seconds / len(runs))
                    on_grid = solve.kind == "static" or run.state.time == run.number * solve.dt
                    yield from self._reported(record if on_grid else replace(record, kept=None), run)
                now = runs[-1]

    def _reported(self, record: StepRecord, now: OrganRun) -> Moments:
        """Yield a step, then call `on_step`.

        The caller has then used the step, so that it is recorded first.
        """
        yield record, partial(self.snapshot, now)
        if self.on_step is not None:
            self.on_step(record)

    def stepper(self, end: WhichEnd = "end", deadline: float | None = None) -> Stepper:
        """Return the run for a host program, which moves an `end` of the thread step by step.

        `deadline` [s] is the longest time of a step; None is the simulated time of the step. Raises
        `ScenarioError`.
        """
        return Stepper(self.scenario, self.beginning, self.record, self.snapshot, end, deadline)

    def beginning(self) -> OrganRun:
        """Return the run before the first step.

        Raises `RestError` for a start at rest without equilibrium.
        """
        if self.scenario.solve.start == "path":
            return self.laid()
        with threadpool_limits(limits=1, user_api="blas"):
            return self.laid().rested()

    def laid(self) -> OrganRun:
        """Return the run with the thread as laid."""
        solve, cuts = self.scenario.solve, [Cut(table.s, table.time) for table in self.scenario.cut]
        return begin(
            self.assembly.system,
            self.start,
            method(solve),
            given=self.assembly.begin_abscissae,
            downhill=(solve.scheme, solve.coupling, solve.friction) == ("newton", "monolithic", "implicit"),
            cuts=tuple(cuts),
            tolerance=np.inf if solve.tolerance is None else solve.tolerance,
            marks=marks_of(self.assembly),
        )

    def next(self, now: OrganRun) -> OrganRun:
        """Return the run after one more step or load step."""
        solve, number = self.scenario.solve, now.number + 1
        if solve.kind == "static":
            return now.load(number / self.steps, solve.duration)
        return now.step(self.length_of(number), self.time_of(number))

    def onward(self, now: OrganRun) -> list[OrganRun]:
        """Return the runs after the next steps.

        These are all steps that are made in one call, else one step.
        """
        solve, numbers = self.scenario.solve, range(now.number + 1, min(now.number + AT_ONCE, self.steps) + 1)
        whole = [number for number in numbers if self.length_of(number) == solve.dt]
        if solve.kind == "static" or not whole:
            return [self.next(now)]
        return now.each_of_steps(solve.dt, [self.time_of(number) for number in whole])

    def time_of(self, number: int) -> float:
        """Return the time of the end of a step [s]."""
        solve = self.scenario.solve
        return solve.duration if number == self.steps else number * solve.dt

    def length_of(self, number: int) -> float:
        """Return the length of a step [s].

        Only the last step can be shorter, by more than round-off.
        """
        solve = self.scenario.solve
        rest = solve.duration - (number - 1) * solve.dt
        whole = number < self.steps or abs(rest - solve.dt) < WHOLE * solve.dt
        return solve.dt if whole else rest

    def snapshot(self, now: OrganRun) -> Snapshot:
        """Return the snapshot of a state."""
        holes = own_holes(now.piercings)
        return Snapshot(now.state.time, thread_record(now), holes, self.organ_record(now.state), now.ties)

    @cached_property
    def _cells_at_holes(self) -> tuple[NDArray[np.intp], ...]:
        """The cells on which each hole bears, without the balls of tracts."""
        organ: Any = self.assembly.organ
        return tuple(of_piercings(self.assembly.holes, tissue.cells_at(organ.elasticity, organ.sites)))

    def organ_record(self, state: State) -> Record | None:
        """Return the displacement, stress and strain of the organ, None without one."""
        body, organ = self.assembly.body, self.assembly.organ
        if body is None or isinstance(organ, tissue.FixedSites):
            return None
        U = organ.displacement(state.organ)
        if isinstance(organ, tissue.FiniteOrgan):
            stress, fields = finite_fields(organ, state.organ)
        else:
            stress, fields = self._linear_fields(body, state.organ)
        values, directions = tissue.principal(stress)
        pressure, gap = lip_fields(self.assembly.system, state, len(body.points))
        hole_strain, hole_energy = (
            np.array([fields[name][cells].max(initial=0.0) for cells in self._cells_at_holes])
            for name in ("strain", "energy_density")
        )
        return OrganRecord(
            displacement=body.nodal(U),
            stress=stress,
            von_mises=tissue.von_mises(stress),
            principal_stress=values,
            first_direction=directions[:, 0],
            third_direction=directions[:, 2],
            volume_ratio=tissue.volume_ratio(body, U),
            contact_pressure=pressure,
            lip_gap=gap,
            crossed=0.0 if self.open_lips is None else self.open_lips.crossed(U),
            hole_strain=hole_strain,
            hole_energy=hole_energy,
            **fields,
        )

    def _linear_fields(self, body: tissue.Elasticity, state: tissue.OrganState) -> tuple[Array, dict[str, Any]]:
        """Return the stress at the nodes of a linear organ, and other fields by their names."""
        organ: Any = self.assembly.organ
        U = organ.displacement(state)
        stress = self.assembly.recovery().stress(U)
        if isinstance(organ, tissue.RelaxingOrgan):
            stress = stress - organ.relaxed_stress(state)
        strain, rotation, energy, nodal_ratio = tissue.strains(body, U)
        return stress, {
            **beyond_small(strain, rotation, tissue.energy_measure(body, strain)),
            "energy_density": energy,
            "nodal_volume_ratio": nodal_ratio,
            "pressed_turn": float(organ.surface.turns(body.nodal(U)).max(initial=0.0)),
        }


def finite_fields(organ: tissue.FiniteOrgan, state: tissue.OrganState) -> tuple[Array, dict[str, Any]]:
    """Return the Cauchy stress at the nodes of an organ at finite strain, and other fields.

    The fields have their names in the record. The strain is the largest |λ − 1| of the principal
    stretches λ.
    """
    hyper, U = organ.law, organ.displacement(state)
    stretch, rotation, along = tissue.principal_stretch(hyper, U)
    energy = tissue.cell_energy(hyper, U, organ.lasting)
    return tissue.cauchy_stress(hyper, U, organ.stressed(state)), {
        **beyond_small(np.abs(stretch - 1.0).max(axis=1), rotation, energy * hyper.weights.sum(axis=0)),
        "energy_density": energy,
        "nodal_volume_ratio": tissue.nodal_volume_ratio(hyper.body, U),
        "principal_stretch": stretch,
        "first_stretch": along[:, 0],
        "third_stretch": along[:, 2],
    }


def beyond_small(strain: Array, rotation: Array, energy: Array) -> dict[str, Any]:
    """Return strain and rotation of cells, and the `energy` of all cells and of those beyond the
    bounds of small strain and rotation, each `(c,)`, by their names in the record.
    """
    return {
        "strain": strain,
        "rotation": rotation,
        "deformed": energy.sum(),
        "strained": energy[strain > bounds.SMALL_STRAIN].sum(),
        "rotated": energy[rotation > bounds.SMALL_ROTATION].sum(),
    }


def method(solve: Solve) -> Take:
    """Return the function that takes a step.

    It depends on the integrator, and on whether the organ is in the same system or follows the
    thread.
    """
    ways = {"euler": (try_step, backward_euler), "bdf2": (stepping.bdf2_step, stepping.scheme_of)}
    thread_step: Take
    thread_step, scheme_of = ways[solve.integrator]
    if solve.friction == "two-pass":
        thread_step = two_pass
    if solve.scheme == "linear":
        thread_step = checked(linear_two_pass if solve.friction == "two-pass" else linear_step)
    return stagger(thread_step, scheme_of) if solve.coupling == "staggered" else thread_step


def prepare(
    scenario: Scenario,
    store: Shared | None = None,
    mesh: object = None,
    *,
    stiffness: Stiffness | None = None,
    friction: Mapping[str, FrictionLaw] | None = None,
    energy: Energy | None = None,
    on_step: OnStep | None = None,
) -> Simulation:
    """Prepare everything that is needed before the first step.

    Mesh, organ and factor are reused from a `store` if possible; None makes new ones. The other
    arguments replace parts of the scenario; None keeps the scenario's part:

    - `mesh` [m]: the organ's mesh, a `skfem.MeshTet`, a meshio mesh or a pyvista grid of
      tetrahedra; a scenario without another mesh has `kind = "given"`.
    - `stiffness`: the stiffness of a linear organ, a function of a `skfem.Basis` that returns a
      symmetric sparse matrix `(N, N)` [N/m], such as `assemble` of your own `skfem.BilinearForm`.
      Mass, supports and loads of the scenario are kept.
    - `friction`: a `coupling.interfaces.FrictionLaw` by the name of its piercing, added to the
      friction of the scenario.
    - `energy`: the strain-energy density of distortion of an organ at finite strain [J/m³], a
      function of F, shape `(3, 3)`, as in `tissue.materials.own`, or a
      `tissue.materials.density.Density`. It replaces the shear part of E and ν. Their bulk part,
      κ/2 (J − 1)², is added.

    `on_step` is called with the record of the start and of every step, after the caller has used
    the record; an exception from it ends the run. Raises the errors of refused input.
    """
    check_given(scenario)
    given = Given(mesh, stiffness, {} if friction is None else friction, energy)
    check_doors(store, on_step)
    with threadpool_limits(limits=1, user_api="blas"), with_hints(scenario):  # the same bits on any number of cores
        assembly = assemble(scenario, store, given)
        simulation = Simulation(assembly, sound_start(assembly, shareable(store, given)), on_step)
        refuse_open_ties(simulation)
    return simulation


@contextmanager
def with_hints(scenario: Scenario) -> Iterator[None]:
    """Add to refusals of what a stitch wrote the keys of the stitch to change."""
    try:
        yield
    except ScenarioError as error:
        raise ScenarioError([with_origin(problem, scenario.stitches) for problem in error.problems]) from error
    except tissue.TissueError as error:
        raise tissue.TissueError(with_origin(str(error), scenario.stitches)) from error


def check_doors(store: object, on_step: object) -> None:
    """Refuse arguments from Python that are not a store or a function. Raises `ScenarioError`."""
    if store is not None and not hasattr(store, "take"):
        raise ScenarioError(f"store = {store!r} is refused; {because('store')}")
    if on_step is not None and not callable(on_step):
        raise ScenarioError(f"on_step = {on_step!r} is refused; give a function of the record of a step")


def refuse_open_ties(simulation: Simulation) -> None:
    """Refuse a tie at the start that cannot begin on the thread as laid. Raises `ScenarioError`."""
    if not any(tie.from_ == 0.0 or tie.held for tie in simulation.scenario.tie):
        return
    try:
        simulation.laid()
    except FormingError as error:
        begins = next(tie.from_ for tie in simulation.scenario.tie if tie.name == error.piercing)
        raise refused(("tie", error.piercing, "from"), begins, "tie-laid", cause=error.cause) from error


def sound_start(assembly: Assembly, store: Shared) -> State:
    """Return the consistent start, from the `store` if possible. Raises `ScenarioError`.

    A scenario is refused if there is no start or the constraints cannot be met. Statics and a start
    at rest also need an equilibrium of the dead loads.
    """
    try:
        state = store.take("start", start_key(assembly.scenario), assembly.start)
    except StepError as error:
        raise ScenarioError(f"thread.path is refused: {because('path-laid', cause=error.cause)}") from error
    problems = faults(assembly.system, state)
    if problems:
        raise ScenarioError(problems)
    solve = assembly.scenario.solve
    if solve.kind == "static" or solve.start == "rest":
        try:
            refuse_unbalanced(assembly.system, state, solve.duration if solve.kind == "static" else 0.0)
        except UnbalancedError as error:
            otherwise = ', or set solve.start = "path"' if solve.start == "rest" else ""
            reason = f"{error.cause}, so there is no equilibrium; {error.remedy}{otherwise}"
            raise ScenarioError(f"thread.start.force and thread.end.force are refused: {reason}") from error
    return state
