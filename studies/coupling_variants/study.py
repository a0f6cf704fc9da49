"""Three ways to solve thread and organ: one system, staggered (§4.4), and linear (§4.1).

The last two are the paper's. A suture passes two ideal holes of a soft block. One end is held, and
a hand draws the other out and back. From the same settled state, the scenario is run in each way
over the organ's stiffness and the time step, with and without inertia of the organ. Measured are
the stable steps, the drift |P(s) − x| at the holes, and the created energy over the work of the
hand. The error of the exit's place is also measured. The reference for this error is a run of the
whole system at half the finest step. The cost is the number of linear systems.

These are consistency checks of our own paths. Theory says that the exchange destroys energy while
it is stable (`coupling.paper.staggered`), and that every error decreases with the step.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product, takewhile
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from coupling.errors import CouplingError
from coupling.kernels.steps.audit import REMAINDER
from coupling.paper import staggered
from coupling.paper.linear_step import linear_step
from coupling.reports.audit import turned_over
from coupling.reports.observation import largest_gap
from coupling.run import begin
from coupling.step.stepping import Step, Take, try_step
from coupling.system import State, System
from studies.arrays import KILO, MILLI, Array
from studies.figure import COLOURS, MARKERS, Item, curve, described, draw, level, series, unnamed
from studies.scenario import Scenario
from studies.simulation.assembly import Assembly, assemble
from studies.study import Table, columns_of, each, grouped, measure, measured, require, scene
from studies.verdicts import beyond_linear, too_coarse

STIFFNESSES = (2e3, 1e4, 5e4, 2.5e5)  # of the organ [Pa]: fat to firm phantom
STEP_COUNTS = (10, 20, 40, 80, 160, 320, 640, 1280)  # over DURATION, each a multiple of the first
SIZE = 2.5e-3  # of the mesh [m]
FOOTPRINT = 2e-3  # [m]

HOLD, HOLD_STEP = 0.1, 2e-3  # [s] of settling of the thread, always in one system
DURATION = 0.1  # of pull and release [s]
WAY = 6e-3  # of the hand, out and back [m]
CREATED = 0.1  # of the hand's work: a run that created more energy is unstable

COMPARED = (3e-4, 1.2e-3, 5e-3)  # steps in the table [s]
EQUAL = 500  # linear systems: the cost at which errors are compared
SHOWN = 5e4  # stiffness in the panel of error over cost [Pa]
COLOUR_OF = dict(zip(("monolithic", "staggered", "linear"), COLOURS, strict=False))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One run.

    `created` is relative to `external_work`, the work of the hand in the reference run.
    """

    way: str = measured("", lambda at: at.way)
    inertia: bool = measured("", lambda at: at.tissue.inertia)  # of the organ
    youngs_modulus: float = measured("Pa", lambda at: at.tissue.youngs_modulus)
    size: float = measured("m", lambda at: at.tissue.mesh.h)  # of the mesh
    dt: float = measured("s", lambda at: DURATION / at.n)
    completed: bool = measured("", lambda at: at.run.completed)
    drift: float = measured("m", lambda at: at.run.drift)  # largest |P(s) − x|
    moved: float = measured("m", lambda at: at.run.moved)  # largest displacement of a hole
    created: float = measured("-", lambda at: at.run.created / at.whole.external_work)
    external_work: float = measured("J", lambda at: at.whole.external_work)
    error: float = measured("-", lambda at: error_of(at.run, at.whole))  # error of the exit's place, over its path
    solves: int = measured("linear systems", lambda at: at.run.solves)

    @property
    def stable(self) -> bool:
        """Whether the run completed without created energy above the bound."""
        return self.completed and self.created <= CREATED


def main(
    stiffnesses: Sequence[float] = STIFFNESSES,
    step_counts: Sequence[int] = STEP_COUNTS,
    size: float = SIZE,
    inertias: Sequence[bool] = (True, False),
) -> Iterator[Row]:
    """Yield every run. Raises `StudyError` for steps without common times."""
    allowed = min(step_counts) >= 1 and not any(n % min(step_counts) for n in step_counts)
    require(allowed, f"step_counts = {list(step_counts)}", "give multiples of the smallest one")
    ways = [scenario(E, inertia, size) for inertia, E in product(inertias, stiffnesses)]
    yield from each([partial(run_ways, way, sorted(step_counts)) for way in ways])


def scenario(youngs_modulus: float, inertia: bool = True, size: float = SIZE) -> Scenario:
    """Return the scene of an organ; its end goes out and back after `HOLD`."""
    phase = np.linspace(0.0, 1.0, 33)
    out = WAY * np.sin(np.pi * phase) ** 2
    hand = [[HOLD + DURATION * t, 0.02 + 0.8 * x, 0.0, 0.02 + 0.6 * x] for t, x in zip(phase, out, strict=True)]
    organ = {"tissue.youngs_modulus": youngs_modulus, "tissue.inertia": inertia, "tissue.mesh.h": size}
    return scene("coupling_variants", organ | {"thread.end.waypoints": [[0.0, 0.02, 0.0, 0.02], *hand]})


def run_ways(scenario: Scenario, step_counts: Sequence[int]) -> Iterator[Row]:
    """Yield the runs of one organ in all ways with all steps.

    The linear step has its own start and reference.
    """
    coarsest = step_counts[0]
    with_it = settle(assemble(scenario))
    linear = scenario.solve.model_copy(update={"scheme": "linear"})
    without = settle(assemble(scenario.model_copy(update={"solve": linear})))
    most, whole_way = 2 * step_counts[-1], WAYS["monolithic"]
    references = [pull_and_release(*case, whole_way, most, coarsest) for case in (with_it, without)]
    for way, n in product(WAYS, step_counts):
        (system, state), whole = (without, references[1]) if way == "linear" else (with_it, references[0])
        run = pull_and_release(system, state, WAYS[way], n, coarsest)
        yield measure(Row, SimpleNamespace(way=way, tissue=scenario.tissue, n=n, run=run, whole=whole))


def settle(assembly: Assembly) -> tuple[System, State]:
    """Return the system and its state after `HOLD`."""
    run = begin(assembly.system, assembly.start(), try_step)
    for _ in range(round(HOLD / HOLD_STEP)):
        run = run.step(HOLD_STEP)
    return run.system, run.state


def constraint_energy(system: System, met: Array, step: Step) -> float:
    """Return the energy created by a linear step [J].

    Its constraint forces belong to the start of the step, and its elastic force is linearised.
    """
    return -turned_over(step)[REMAINDER] - step.solution.linearisation


Way = tuple[Take, Callable[[System, Array, Step], float]]  # takes a step; its created energy [J]
Outcome = SimpleNamespace  # the results of one run
WAYS: dict[str, Way] = {
    "monolithic": (try_step, staggered.work_of_the_lag),
    "staggered": (staggered.staggered_step, staggered.work_of_the_lag),
    "linear": (linear_step, constraint_energy),
}


def pull_and_release(system: System, state: State, way: Way, n: int, shared: int) -> Outcome:
    """Return the results of the pull and release in `n` steps.

    Steps are not halved, so a failed step ends the run. `completed` is false for such a run.
    `drift` and `moved` are the largest drift and displacement of a hole [m]. `created` and
    `external_work` are the created energy and the work of the hand [J]. `exit` are the places of
    the exit [m] at the `shared` common times of all runs, and `solves` is the number of linear
    systems.
    """
    take, created_by = way
    now, met = begin(system, state, take, halvings=0, downhill=False), state.y
    found = Outcome(completed=False, drift=0.0, moved=0.0, created=0.0, external_work=0.0)
    found.exit, found.solves = [state.y[1, :3]], 0
    for number in range(1, n + 1):
        before = now.energies
        try:
            now = now.step(DURATION / n)
        except CouplingError:
            return found
        step = now.taken[-1]
        found.created += created_by(system, met, step)
        met = step.solution.iterate.y
        found.drift = max(found.drift, largest_gap(system, now.state, now.configuration.at))
        moved = np.linalg.norm((now.state.y - state.y)[:, :3], axis=1)
        found.moved = max(found.moved, float(moved.max()))
        work = now.energies.external_work - before.external_work
        found.external_work += max(0.0, work)  # without returned work
        found.solves += now.iterations
        if number % (n // shared) == 0:
            found.exit.append(now.state.y[1, :3])
    found.completed = True
    return found


def error_of(run: Outcome, whole: Outcome) -> float:
    """Return the largest distance of the exit from its place in another run, over its path [-].

    NaN if the run failed.
    """
    away = np.linalg.norm(np.array(run.exit) - whole.exit[: len(run.exit)], axis=1)
    return float(away.max()) / whole.moved if run.completed else float("nan")


def runs_of(rows: Sequence[Row], way: str, inertia: bool, youngs_modulus: float) -> list[Row]:
    """Return the runs of one organ in one way, finest step first."""
    found = [r for r in rows if (r.way, r.inertia, r.youngs_modulus) == (way, inertia, youngs_modulus)]
    return sorted(found, key=lambda row: row.dt)


def organs(rows: Sequence[Row]) -> list[tuple[bool, float]]:
    """Return the inertia and Young's modulus [Pa] of every organ."""
    return list(dict.fromkeys((row.inertia, row.youngs_modulus) for row in rows))


def largest_stable(runs: Sequence[Row]) -> float:
    """Return the largest step up to which every step is stable [s].

    The `runs` begin with the finest step. Zero if the finest step is unstable.
    """
    return max((run.dt for run in takewhile(lambda run: run.stable, runs)), default=0.0)


# --- table and figure -------------------------------------------------------------------------------------


def table(rows: Sequence[Row]) -> Table:
    """Return the table with a line for each organ and way.

    Drift and energy are given at the steps nearest to COMPARED.
    """
    steps = " / ".join(f"{dt / MILLI:g}" for dt in COMPARED) + " ms"

    def at_steps(runs: Sequence[Row], cell: Callable[[Row], str]) -> str:
        chosen = [min(runs, key=lambda run: abs(np.log(run.dt / dt))) for dt in COMPARED]
        return " / ".join(cell(run) if run.completed else "broke off" for run in chosen)

    def moved(runs: Sequence[Row]) -> float:
        whole = runs_of(rows, "monolithic", runs[0].inertia, runs[0].youngs_modulus)
        return max(run.moved for run in whole) / MILLI

    columns = columns_of(
        "coupling_variants",
        organ=lambda runs: "with inertia" if runs[0].inertia else "quasi-static",
        moved=lambda runs: f"{moved(runs):.2g}",
        stable=stable_text,
        drift=lambda runs: at_steps(runs, lambda run: f"{run.drift / MILLI:.2g}"),
        created=lambda runs: at_steps(runs, lambda run: f"{100.0 * run.created:+.2g}"),
        error=error_text,
    )
    columns = [(head.format(steps=steps, equal=EQUAL), cell) for head, cell in columns]
    return Table.of(columns, [runs_of(rows, way, *organ) for organ in organs(rows) for way in WAYS])


def error_text(runs: Sequence[Row]) -> str:
    """Return the error at a number of linear systems [%] in words."""
    error = error_at(EQUAL, runs)
    return "none" if np.isnan(error) else f"{100.0 * error:.2g}"


def error_at(cost: float, runs: Sequence[Row]) -> float:
    """Return the error of the stable runs at a number of linear systems [-].

    It is interpolated in logarithms. NaN outside the range of the runs.
    """
    known = sorted((run.solves, run.error) for run in runs if run.stable)
    if not known or not known[0][0] <= cost <= known[-1][0]:
        return float("nan")
    solves, errors = np.log(np.array(known)).T
    return float(np.exp(np.interp(np.log(cost), solves, errors)))


def stable_text(runs: Sequence[Row]) -> str:
    """Return the largest stable step [ms] among the tested ones, in words."""
    stable = [run.dt / MILLI for run in runs if run.stable]
    largest = largest_stable(runs) / MILLI
    if not stable:
        return "none"
    if len(stable) == len(runs):
        return f"≥ {largest:.2g}"
    return f"{largest:.2g}" if largest else "only " + ", ".join(f"{dt:.2g}" for dt in stable)


def remarks(rows: Sequence[Row]) -> Iterator[str]:
    """Yield remarks on too soft organs, and on a mesh too coarse for the footprint."""
    yield from too_coarse("every run", rows[0].size, FOOTPRINT)
    for inertia, E in organs(rows):
        name = f"{'organ with inertia' if inertia else 'quasi-static organ'} of {E / KILO:g} kPa"
        yield from beyond_linear(name, runs_of(rows, "monolithic", inertia, E)[0].moved, FOOTPRINT)
    thread = "a thread without the added compliance of a spline at a hole"
    yield f"linear: compared with {thread}, which this step cannot use"


def figure(rows: Sequence[Row]) -> Figure:
    """Return the figure of stable steps, error over cost, drift and created energy over the step.

    Each kind of organ has a row of panels.
    """
    kinds = grouped(rows, lambda row: row.inertia).values()
    return draw([item for kind in kinds for item in panels_of(kind)], 4)


def panels_of(rows: Sequence[Row]) -> list[Item]:
    """Return the panels of a kind of organ."""
    stiffnesses, kind = [E for _, E in organs(rows)], "organ with inertia" if rows[0].inertia else "quasi-static organ"
    shown = min(stiffnesses, key=lambda E: abs(np.log(E / SHOWN)))
    ways = grouped((row for row in rows if row.stable and row.youngs_modulus == shown), lambda row: row.way)
    done = [row for row in rows if row.completed and row.way != "monolithic"]
    by_organ = grouped(done, lambda row: f"{row.way}, {row.youngs_modulus / KILO:g} kPa")
    unstable = {name: [row for row in runs if not row.stable] for name, runs in by_organ.items()}
    colours = [COLOUR_OF[runs[0].way] for runs in by_organ.values()]
    organ: dict[str, Any] = {"colours": colours}
    organ["markers"] = [MARKERS[stiffnesses.index(runs[0].youngs_modulus)] for runs in by_organ.values()]
    hollow = organ | {"markerfacecolor": "white"}

    def place(row: Row) -> float:
        return stiffnesses.index(row.youngs_modulus) + 0.25 * (1 - list(WAYS).index(row.way))

    states = [
        series(
            {f"_{way}": runs}, "dt [ms]", place, "", [marker], [COLOUR_OF[way]], markersize=4,
            markerfacecolor=COLOUR_OF[way] if runs[0].stable else "white",
        )
        for (way, marker, _), runs in grouped(rows, lambda row: (row.way, "sx"[not row.completed], row.stable)).items()
    ]  # fmt: skip
    levels = [f"{E / KILO:g}" for E in stiffnesses]
    return described(
        "coupling_variants",
        [
            *states, *(curve([], [], way, "s", COLOUR_OF[way]) for way in WAYS), {"ylim": (-0.6, len(levels) - 0.1)},
            lambda axes: axes.set_yticks(range(len(levels)), levels),
        ],
        [series(ways, "solves", "error", colours=[COLOUR_OF[way] for way in ways])],
        [
            series(by_organ, "dt [ms]", "drift [mm]", **organ),
            series(unnamed(unstable), "dt [ms]", "drift [mm]", "", **hollow),
        ],
        [
            series(unnamed(by_organ), "dt [ms]", "created", **organ),
            series(unnamed(unstable), "dt [ms]", "created", "", **hollow), level(CREATED),
            lambda axes: axes.set_yscale("symlog", linthresh=CREATED),
        ],
        kind=kind, shown=shown / KILO,
    )  # fmt: skip
