"""`suture bench`: milliseconds per step, and those of what a competent user would write, as ratios measured in one run.

Of every case: our step as it is taken, with the iteration in compiled loops where they are switched on
(`coupling.step.solver`), and the same step with the iteration in numpy; where the loops make many steps at once
(`coupling.run.run.Run.steps`), one of those, and one of which all is found that a run records, as a multiple of that;
of so many as go on smoothly. With an organ also the floor below which no step with this factor can be (one organ
back-substitution), and two baselines that solve the same step to the same tolerance:

- `assembled`: Newton on the one assembled matrix, each correction by `scipy.sparse.linalg.spsolve`;
- `prefactored`: the organ factored once by `scipy.sparse.linalg.splu` with W = A⁻¹Yᵀ kept, each Newton correction by
  one back-substitution and a dense Schur complement on thread, abscissae and multipliers.

An organ with inertia is measured twice: whole, and in its Krylov space (`tissue.organs.krylov`), whose floor is that of
the whole one. Of the space also what it took to make, in floors: after so many steps it has paid, for a step of the
whole organ is no less.

Measurements of a case are taken in turn, round after round, so that a machine that slows down slows all of them. Times
are those of the processor, on one thread: other work on the machine does not count.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_matrix
from scipy.sparse.linalg import splu, spsolve
from threadpoolctl import threadpool_limits

from coupling.errors import StepError
from coupling.integrators import BackwardEuler
from coupling.interfaces import Body, Steady
from coupling.paper.assembled import BlockSystem, monolithic_solve
from coupling.run.run import Run, begin
from coupling.step import newton
from coupling.step.newton import Iterate
from coupling.step.stepping import Step, conclude, dynamic_problem, organ_answer, predict
from coupling.system import State, System
from studies.arrays import Array
from studies.output.files import write_json
from studies.output.provenance import provenance
from studies.output.records import StepRecord
from studies.scenario import Scenario, load
from studies.simulation.assembly import assemble
from studies.simulation.recording import step_record
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.krylov import KrylovOrgan
from tissue.organs.meshed import OrganState
from tissue.organs.quasi_static import QuasiStaticOrgan

SCENES = Path(__file__).parents[1] / "scenario" / "scenes"
THREAD = SCENES / "paper_figure_1.toml"
COUPLED = SCENES / "two_piercings.toml"
SIZES = {"4k": (6.0e-3, 2.5e-3), "10k": (4.0e-3, 1.2e-3), "43k": (2.0e-3, 0.7e-3)}  # far from and at the holes [m]
FIXED = [  # whatever the scene has: the sizes are those of these meshes
    "thread.control_points=60",
    *(f"piercing.{name}.footprint=1.5e-3" for name in ("entry", "exit")),
]
COMPILED = 'solve.newton="compiled"'
ROUGH = [f"piercing.{name}.friction={{static=0.2,kinetic=0.15}}" for name in ("entry", "exit")]
THREADS = {
    "thread alone": [],
    "with friction": ROUGH,
    "of 100 points": [*ROUGH, "thread.control_points=100"],
    "of 1000 points": [*ROUGH, "thread.control_points=1000"],
}
WARM_UP = 60  # steps before anything is measured: the first ones are not like the rest
ROUNDS = 15
AT_ONCE = 50  # steps
LARGEST_ASSEMBLED = 15_000  # unknowns; beyond, one spsolve of the assembled matrix takes minutes
MILLI = 1e-3


@dataclass(frozen=True)
class Row:
    """One case: medians in milliseconds, None where not measured."""

    case: str
    tissue_unknowns: int
    newton_iterations: float
    step: float
    numpy_iterations: float
    numpy: float
    at_once: float | None = None
    recorded: float | None = None
    floor: float | None = None
    prefactored: float | None = None
    assembled: float | None = None
    space: float | None = None

    def ratio(self, other: float | None) -> float | None:
        """Return `other` over our step, None where it was not measured."""
        return None if other is None else other / self.step

    @property
    def over_at_once(self) -> float | None:
        """A step that is recorded over one that is not, of those made at once."""
        return None if self.at_once is None or self.recorded is None else self.recorded / self.at_once

    @property
    def over_floor(self) -> float | None:
        """Our step over one organ back-substitution."""
        return None if self.floor is None else self.step / self.floor

    @property
    def pays_after(self) -> float | None:
        """Steps after which the organ's Krylov space has paid, None without one."""
        return None if self.floor is None or self.space is None else self.space / self.floor


def main(json_path: Path | None = None, solver: str = "auto") -> int:
    """Measure every case, print the table, and write JSON where asked; return the exit status."""
    print(HEAD)
    rows = []
    with threadpool_limits(limits=1, user_api="blas"):
        for row in measurements(solver):
            rows.append(row)
            print(line(row), flush=True)
    if json_path is not None:
        table = [asdict(row) | ratios(row) for row in rows]
        write_json(json_path, {"milliseconds_per_step": table, "provenance": provenance()})
    return 0


def ratios(row: Row) -> dict[str, float | None]:
    """Return what is told of a row beside its times."""
    told = {"over_floor": row.over_floor, "numpy_over_step": row.ratio(row.numpy)}
    return told | {"recorded_over_at_once": row.over_at_once, "pays_after": row.pays_after}


def measurements(
    solver: str = "auto", sizes: dict[str, tuple[float, float]] = SIZES, rounds: int = ROUNDS
) -> Iterator[Row]:
    """Measure every case, smallest first, with a solver of the organ."""
    for name, overrides in THREADS.items():
        yield measure_case(name, load(THREAD, [*overrides, COMPILED]), rounds)
    ways = {"dynamic": ['solve.organ="whole"'], "Krylov": ['solve.organ="krylov"']}
    for name, way in (ways | {"quasi-static": ["tissue.inertia=false"]}).items():
        for size, (h, h_site) in sizes.items():
            overrides = [f"tissue.mesh.h={h}", f"tissue.mesh.h_site={h_site}", *way]
            scenario = load(COUPLED, [*FIXED, *overrides, COMPILED, f'tissue.solver="{solver}"'])
            yield measure_case(f"{name} {size}", scenario, rounds)


def measure_case(case: str, scenario: Scenario, rounds: int) -> Row:
    """Time our step and what it is compared with, in turn."""
    assembly, dt = assemble(scenario), scenario.solve.dt
    organ, run = assembly.organ, begin(assembly.system, assembly.start())
    for _ in range(WARM_UP):
        run = run.step(dt)
    others: dict[str, Callable[[State], object]] = {}
    if isinstance(organ, DynamicOrgan | QuasiStaticOrgan):
        others = baselines(run.system, organ, dt)
    if isinstance(organ, KrylovOrgan):
        others = {"floor": floor_of(organ.full, BackwardEuler(dt))}
    at_once = ["at_once", "recorded"] if isinstance(organ, Steady | KrylovOrgan) else []
    times: dict[str, list[float]] = {name: [] for name in ("step", "numpy", *at_once, *others)}
    if at_once:
        smooth_ones(run, dt)  # loads or compiles the loops
    iterations, by_numpy = [], []
    for _ in range(rounds):
        for name, call in others.items():
            with suppress(StepError):  # a baseline has no second try where the thread snaps through a hole
                times[name] += [time_call(call, run.state)]
        began = process_time()
        by_numpy += [replace(run, take=numpy_step).step(dt).iterations]
        times["numpy"] += [process_time() - began]
        if at_once:
            count = len(smooth_ones(run, dt))
            began = process_time()
            run.steps(dt, count)
            times["at_once"] += [(process_time() - began) / count]
            began = process_time()
            smooth_ones(run, dt)
            times["recorded"] += [(process_time() - began) / count]
        began = process_time()
        run = run.step(dt)
        times["step"] += [process_time() - began]
        iterations += [run.iterations]
    medians = {name: median(values) / MILLI for name, values in times.items()}
    if isinstance(organ, KrylovOrgan) and organ.vectors(run.state.organ):
        medians["space"] = time_call(KrylovOrgan(organ.full).site_variables, run.state.organ) / MILLI
    counts = {"newton_iterations": float(np.mean(iterations)), "numpy_iterations": float(np.mean(by_numpy))}
    return Row(case, organ.size, **counts, **medians)


def smooth_ones(run: Run[OrganState], dt: float) -> list[StepRecord]:
    """Return the records of the steps that are made at once from a run, AT_ONCE at most."""
    times = list(accumulate([dt] * AT_ONCE, initial=run.state.time))[1:]
    return [step_record(each) for each in run.each_of_steps(dt, times)]


def numpy_step(system: System[Body], state: State[Body], dt: float) -> Step[Body]:
    """Take a step of backward Euler with the iteration in numpy."""
    scheme = BackwardEuler(dt)
    problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state), scheme)
    return conclude(state, scheme, newton.solve(problem, predict(problem, state)))


def time_call(call: Callable[[Any], object], state: Any) -> float:
    """Measure the processor time of a call [s]."""
    began = process_time()
    call(state)
    return process_time() - began


def floor_of(organ: DynamicOrgan | QuasiStaticOrgan, scheme: BackwardEuler) -> Callable[[object], object]:
    """Return one back-substitution of an organ with the factor of a scheme."""
    factor = organ.operator(scheme.a, scheme.d).factor
    right = np.random.default_rng(0).standard_normal(organ.size)
    return lambda state: factor.solve(right)


def baselines(
    system: System[OrganState], organ: DynamicOrgan | QuasiStaticOrgan, dt: float
) -> dict[str, Callable[[State[OrganState]], object]]:
    """List what is measured in addition to our step from a state."""
    scheme = BackwardEuler(dt)
    operator = organ.operator(scheme.a, scheme.d)
    lu = splu(csc_array(operator.A))
    sites = SiteColumns(organ.Y, lu.solve(np.asfortranarray(organ.Y.T.toarray())))

    def baseline(state: State[OrganState], linear: Callable[[BlockSystem], Array]) -> Iterate:
        """Take a step from a state by Newton on the assembled system with a linear solver of the user's."""
        problem = dynamic_problem(system, state, dt, organ_answer(system, scheme, state))
        return monolithic_solve(problem, predict(problem, state), organ.field(state.organ), linear).iterate

    out: dict[str, Callable[[State[OrganState]], object]] = {
        "floor": floor_of(organ, scheme),
        "prefactored": lambda state: baseline(state, lambda x: prefactored_correction(x, lu.solve, sites)),
    }
    if organ.size <= LARGEST_ASSEMBLED:
        out["assembled"] = lambda state: baseline(state, lambda x: spsolve(x.matrix, x.right))
    return out


@dataclass(frozen=True)
class SiteColumns:
    """Y and W = A⁻¹Yᵀ: with them A⁻¹ of anything of the form YᵀZ costs a small product."""

    Y: csr_matrix
    W: Array

    def lift(self, columns: csc_array) -> Array:
        """Return A⁻¹ columns, for columns in the span of Yᵀ."""
        gram = (self.Y @ self.Y.T).toarray()
        return np.asarray(self.W @ np.linalg.solve(gram, (self.Y @ columns).toarray()))


def prefactored_correction(system: BlockSystem, solve: Callable[[Array], Array], sites: SiteColumns) -> Array:
    """Solve for one Newton correction with the organ eliminated: a back-substitution and a dense Schur complement."""
    organ = system.blocks["U"]
    small = np.r_[0 : organ.start, organ.stop : len(system.right)]
    matrix = system.matrix.tocsr()
    rows, columns = matrix[small], csc_array(matrix[organ][:, small])
    used = np.flatnonzero(np.diff(columns.indptr))
    free, lifted = solve(system.right[organ]), sites.lift(columns[:, used])
    to_organ, own = rows[:, organ], rows[:, small].toarray()
    own[:, used] -= to_organ @ lifted
    x = np.empty_like(system.right)
    x[small] = np.linalg.solve(own, system.right[small] - to_organ @ free)
    x[organ] = free - lifted @ x[small][used]
    return x


HEAD = (
    f"{'times in ms':18} {'unknowns':>9} {'Newton':>7} {'step':>9} {'in numpy':>18} {'at once':>9} {'recorded':>9} "
    f"{'floor':>9} {'step/floor':>11} {'prefactored':>12} {'assembled':>10} {'pays after':>11}"
)


def line(row: Row) -> str:
    """Write a row of the table, times in milliseconds, baselines as multiples of our step."""
    floor = f"{row.floor:9.3f} {row.over_floor:11.2f}" if row.floor is not None else " " * 21
    others = [f"{ratio:.1f} ×" if ratio else "" for ratio in (row.ratio(row.prefactored), row.ratio(row.assembled))]
    ours = f"{row.newton_iterations:7.1f} {row.step:9.3f}"
    theirs = f"{row.numpy_iterations:4.1f} {row.numpy:7.3f} {row.numpy / row.step:3.0f} ×"
    at_once = f"{row.at_once:9.3f}" if row.at_once is not None else " " * 9
    recorded = f"{row.over_at_once:7.2f} ×" if row.over_at_once is not None else " " * 9
    step = f"{row.case:18} {row.tissue_unknowns:9d} {ours} {theirs} {at_once} {recorded}"
    pays = f"{row.pays_after:11.0f}" if row.pays_after is not None else ""
    return f"{step} {floor} {others[0]:>12} {others[1]:>10} {pays}".rstrip()
