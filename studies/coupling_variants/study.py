"""Three ways to solve thread and organ: one system, the staggered variant (§4.4), and the paper's linear step (§4.1).

A suture through two ideal holes of a soft block, one end held, the other drawn out and let back by a hand. From one
settled state the same scenario is stepped each way over the organ's stiffness and the time step, with an organ that
has inertia and with one that has none. Measured are which steps are stable, the drift |P(s) − x| at the holes, the
energy that comes from nowhere, over the work that the hand puts in, and how far the exit is from where a run of the
whole system at half the finest step has it, against the number of linear systems that were solved.

Consistency checks of our own paths; that the exchange destroys energy while it is stable is the theory it can be held
against (`coupling.paper.staggered`), and that every error falls with the step.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from coupling.errors import CouplingError
from coupling.kernels.steps.audit import REMAINDER
from coupling.paper import staggered
from coupling.paper.linear_step import linear_step
from coupling.reports.audit import Energies, turned_over
from coupling.reports.observation import largest_residual
from coupling.run import begin
from coupling.step.stepping import Step, Take, try_step
from coupling.system import State, System
from studies.arrays import Array
from studies.figure import COLOURS, MARKERS, panels, ticks
from studies.scenario import Scenario, parse
from studies.simulation.assembly import Assembly, assemble
from studies.study import Study, StudyError, Table, each, unit_field
from studies.verdicts import beyond_linear, too_coarse

STIFFNESSES = (2e3, 1e4, 5e4, 2.5e5)  # of the organ [Pa]: fat to firm phantom
STEP_COUNTS = (10, 20, 40, 80, 160, 320, 640, 1280)  # over DURATION, each a multiple of the first
SIZE = 2.5e-3  # of the mesh [m]
FOOTPRINT = 2e-3  # [m]

HOLD, HOLD_STEP = 0.1, 2e-3  # the thread settles, always in one system [s]
DURATION = 0.1  # of pull and release [s]
WAY = 6e-3  # of the hand, out and back [m]
HALF = 5e-3  # of the distance of the holes [m]
CREATED = 0.1  # of the hand's work: a run whose lag has created more is unstable

MILLI, KILO = 1e-3, 1e3
COMPARED = (3e-4, 1.2e-3, 5e-3)  # steps in the table [s]
TICKS = (0.1, 0.3, 1.0, 3.0, 10.0)  # [ms]
EQUAL = 500  # linear systems: the cost at which errors are compared
SHOWN = 5e4  # stiffness whose error is drawn over the cost [Pa]
COLOUR_OF = dict(zip(("monolithic", "staggered", "linear"), COLOURS, strict=False))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One run. `created` is over `external_work`, what the hand puts in while it gives, in the run of reference."""

    way: str
    inertia: bool  # of the organ
    youngs_modulus: float = unit_field("Pa")
    size: float = unit_field("m")  # of the mesh
    dt: float = unit_field("s")
    completed: bool
    drift: float = unit_field("m")  # largest |P(s) − x|
    moved: float = unit_field("m")  # farthest a hole moved
    created: float = unit_field("-")
    external_work: float = unit_field("J")
    error: float = unit_field("-")  # of the exit's place, over how far it goes
    solves: int = unit_field("linear systems")

    @property
    def stable(self) -> bool:
        """Whether the run came to its end, and not on energy from nowhere."""
        return self.completed and self.created <= CREATED


def main(
    stiffnesses: Sequence[float] = STIFFNESSES,
    step_counts: Sequence[int] = STEP_COUNTS,
    size: float = SIZE,
    inertias: Sequence[bool] = (True, False),
) -> Iterator[Row]:
    """Yield every run. Raises `StudyError` for steps that share no times."""
    if min(step_counts) < 1 or any(n % min(step_counts) for n in step_counts):
        raise StudyError(f"step_counts = {list(step_counts)} is refused: give multiples of the smallest one")
    with threadpool_limits(limits=1, user_api="blas"):
        ways = [scenario(E, inertia, size) for inertia, E in product(inertias, stiffnesses)]
        yield from each([partial(run_ways, way, size, sorted(step_counts)) for way in ways])


def scenario(youngs_modulus: float, inertia: bool = True, size: float = SIZE) -> Scenario:
    """Make the scenario: a suture down into a block, under its surface, and up again; its end goes out and back, from
    `HOLD` on."""
    phase = np.linspace(0.0, 1.0, 33)
    out = WAY * np.sin(np.pi * phase) ** 2
    hand = [[HOLD + DURATION * t, 0.02 + 0.8 * x, 0.0, 0.02 + 0.6 * x] for t, x in zip(phase, out, strict=True)]
    hole = {
        "direction": "normal",
        "footprint": FOOTPRINT,
        "subgrid": False,
    }  # the same organ on every mesh it is run on
    down, up = [-HALF, 0.0, 0.0], [HALF, 0.0, 0.0]
    return parse(
        {
            "title": "staggered against monolithic",
            "tissue": {
                "youngs_modulus": youngs_modulus,
                "poisson_ratio": 0.45,
                "density": 1070.0,
                "rayleigh": [0.0, 5e-4],
                "inertia": inertia,
                "clamp": ["bottom"],
                "mesh": {"kind": "block", "size": [0.03, 0.02, 0.01], "h": size},
            },
            "thread": {
                "suture": "2-0 polypropylene",
                "control_points": 30,
                "damping": 20.0,
                "path": [
                    [-0.02, 0.0, 0.02],
                    [-HALF, 0.0, 0.01],
                    [-HALF, 0.0, -3e-3],
                    [HALF, 0.0, -3e-3],
                    [HALF, 0.0, 0.01],
                    [0.02, 0.0, 0.02],
                ],
                "start": {"kind": "fixed"},
                "end": {"kind": "driven", "waypoints": [[0.0, 0.02, 0.0, 0.02], *hand]},
            },
            "piercing": [{"name": "entry", "at": down, **hole}, {"name": "exit", "at": up, **hole}],
            "solve": {"dt": HOLD_STEP, "duration": HOLD + DURATION},
        }
    )


def run_ways(scenario: Scenario, size: float, step_counts: Sequence[int]) -> Iterator[Row]:
    """Run one organ in all ways with all steps. The linear step knows no compliance that the spline lacks at a hole:
    it, and what it is compared with, do without."""
    table, coarsest = scenario.tissue, step_counts[0]
    assert table is not None
    with_it = settle(assemble(scenario))
    without = settle(assemble(scenario.model_copy(update={"solve": scenario.solve.model_copy(update=LINEAR)})))
    references = [
        pull_and_release(*case, WAYS["monolithic"], 2 * step_counts[-1], coarsest) for case in (with_it, without)
    ]
    for way, n in product(WAYS, step_counts):
        (system, state), whole = (without, references[1]) if way == "linear" else (with_it, references[0])
        run = pull_and_release(system, state, WAYS[way], n, coarsest)
        away = np.linalg.norm(run.exit - whole.exit[: len(run.exit)], axis=1)
        yield Row(
            way=way,
            inertia=table.inertia,
            youngs_modulus=table.youngs_modulus,
            size=size,
            dt=DURATION / n,
            completed=run.completed,
            drift=run.drift,
            moved=run.moved,
            created=run.created / whole.external_work,
            external_work=whole.external_work,
            error=float(away.max()) / whole.moved if run.completed else float("nan"),
            solves=run.solves,
        )


def settle(assembly: Assembly) -> tuple[System, State]:
    """Simulate up to `HOLD`; return the system and its state."""
    run = begin(assembly.system, assembly.start(), try_step)
    for _ in range(round(HOLD / HOLD_STEP)):
        run = run.step(HOLD_STEP)
    return run.system, run.state


@dataclass(frozen=True)
class Way:
    """How a step is taken, and the energy [J] that it took from nowhere, of the step and of where the thread met the
    holes in the step before."""

    take: Take
    created: Callable[[System, Array, Step], float]


def constraint_energy(system: System, met: Array, step: Step) -> float:
    """Return the energy created by a linear step [J]: its constraint forces are those of its start, its elastic force
    the linearised one."""
    return -turned_over(step)[REMAINDER] - step.solution.linearisation


WAYS = {
    "monolithic": Way(try_step, staggered.work_of_the_lag),
    "staggered": Way(staggered.staggered_step, staggered.work_of_the_lag),
    "linear": Way(linear_step, constraint_energy),
}
LINEAR = {"scheme": "linear"}


@dataclass(frozen=True)
class Outcome:
    """What one run showed, up to where it broke off: [m], [m], [J], [J], places of the exit `(k, 3)` [m] at the times
    that all runs share, and the number of linear systems."""

    completed: bool
    drift: float
    moved: float
    created: float
    external_work: float
    exit: Array
    solves: int


def pull_and_release(system: System, state: State, way: Way, n: int, shared: int) -> Outcome:
    """Pull and release in `n` steps, none of them halved: a step that fails ends the run."""
    now, met, places = begin(system, state, way.take, halvings=0, downhill=False), state.y, [state.y[1, :3]]
    drift = moved = created = work = 0.0
    solves = 0

    def run(completed: bool) -> Outcome:
        return Outcome(completed, drift, moved, created, work, np.array(places), solves)

    for number in range(1, n + 1):
        before = now.energies
        try:
            now = now.step(DURATION / n)
        except CouplingError:
            return run(False)
        step = now.taken[-1]
        created += way.created(system, met, step)
        met = step.solution.iterate.y
        drift = max(drift, largest_residual(system, now.state, now.configuration.at))
        moved = max(moved, float(np.linalg.norm((now.state.y - state.y)[:, :3], axis=1).max()))
        work += hand_work(before, now.energies)
        solves += now.iterations
        if number % (n // shared) == 0:
            places.append(now.state.y[1, :3])
    return run(True)


def hand_work(before: Energies, after: Energies) -> float:
    """Return the work that the hand puts in during a step, nothing while it takes [J]."""
    return max(0.0, after.external_work - before.external_work)


def runs_of(rows: Sequence[Row], way: str, inertia: bool, youngs_modulus: float) -> list[Row]:
    """Return the runs of one organ one way, finest step first."""
    found = [r for r in rows if (r.way, r.inertia, r.youngs_modulus) == (way, inertia, youngs_modulus)]
    return sorted(found, key=lambda row: row.dt)


def organs(rows: Sequence[Row]) -> list[tuple[bool, float]]:
    """Return the inertia and Young's modulus [Pa] of every organ."""
    return list(dict.fromkeys((row.inertia, row.youngs_modulus) for row in rows))


def largest_stable(runs: Sequence[Row]) -> float:
    """Return the largest step below which every one is stable [s], zero if the finest is not; `runs` finest first."""
    stable = 0.0
    for run in runs:
        if not run.stable:
            break
        stable = run.dt
    return stable


# --- table and figure -------------------------------------------------------------------------------------


def table(rows: Sequence[Row]) -> Table:
    """Make one line an organ and way."""
    steps = " / ".join(f"{dt / MILLI:g}" for dt in COMPARED) + " ms"
    head = (
        "organ",
        "E [kPa]",
        "hole moves [mm]",
        "way",
        "largest stable step [ms]",
        f"drift at {steps} [mm]",
        f"energy created at {steps} [% of the hand's work]",
        f"error of the exit at {EQUAL} linear systems [% of its way]",
    )
    return Table(head, [table_line(rows, way, *organ) for organ in organs(rows) for way in WAYS])


def table_line(rows: Sequence[Row], way: str, inertia: bool, youngs_modulus: float) -> list[str]:
    """Return the drift and energy at the steps next to those of COMPARED."""
    runs = runs_of(rows, way, inertia, youngs_modulus)
    chosen = [min(runs, key=lambda run: abs(np.log(run.dt / dt))) for dt in COMPARED]
    error = error_at(EQUAL, runs)
    return [
        "with inertia" if inertia else "quasi-static",
        f"{youngs_modulus / KILO:g}",
        f"{max(run.moved for run in runs_of(rows, 'monolithic', inertia, youngs_modulus)) / MILLI:.2g}",
        way,
        stable_text(runs),
        " / ".join(f"{run.drift / MILLI:.2g}" if run.completed else "broke off" for run in chosen),
        " / ".join(f"{100.0 * run.created:+.2g}" if run.completed else "broke off" for run in chosen),
        "none" if np.isnan(error) else f"{100.0 * error:.2g}",
    ]


def error_at(cost: float, runs: Sequence[Row]) -> float:
    """Return the error of the stable runs at a number of linear systems, straight between its neighbours in logarithms;
    NaN where the ladder of steps does not reach it."""
    known = sorted((run.solves, run.error) for run in runs if run.stable)
    if not known or not known[0][0] <= cost <= known[-1][0]:
        return float("nan")
    solves, errors = np.log(np.array(known)).T
    return float(np.exp(np.interp(np.log(cost), solves, errors)))


def stable_text(runs: Sequence[Row]) -> str:
    """Write the largest stable step [ms] as far as the ladder of steps tells; where only coarse ones are stable,
    those."""
    stable = [run.dt / MILLI for run in runs if run.stable]
    largest = largest_stable(runs) / MILLI
    if not stable:
        return "none"
    if len(stable) == len(runs):
        return f"≥ {largest:.2g}"
    return f"{largest:.2g}" if largest else "only " + ", ".join(f"{dt:.2g}" for dt in stable)


def remarks(rows: Sequence[Row]) -> list[str]:
    """List the organs too soft for small strains, and a mesh too coarse for the footprint."""
    out = too_coarse("every run", rows[0].size, FOOTPRINT)
    for inertia, E in organs(rows):
        name = f"{'organ with inertia' if inertia else 'quasi-static organ'} of {E / KILO:g} kPa"
        out += beyond_linear(name, runs_of(rows, "monolithic", inertia, E)[0].moved, FOOTPRINT)
    out.append(
        "linear: held against a thread without the compliance that a spline lacks at a hole, which it cannot have"
    )
    return out


def figure(rows: Sequence[Row]) -> Figure:
    """Draw which steps are stable, error over cost, drift and created energy over the step: a line of panels for each
    kind of organ."""
    kinds = list(dict.fromkeys(row.inertia for row in rows))
    drawing, grid = panels(len(kinds), 4)
    for line, inertia in zip(grid, kinds, strict=True):
        stability_map(line[0], rows, inertia)
        error_over_cost(line[1], rows, inertia)
        for axes, value in ((line[2], drift), (line[3], created_share)):
            for way, (E, marker) in product(("staggered", "linear"), organ_markers(rows, inertia)):
                curve(axes, runs_of(rows, way, inertia, E), value, COLOUR_OF[way], marker, f"{way}, {E / KILO:g} kPa")
        drift_axes(line[2])
        energy_axes(line[3])
    return drawing


def organ_markers(rows: Sequence[Row], inertia: bool) -> list[tuple[float, str]]:
    """Return the stiffness [Pa] and marker of every organ of a kind."""
    return list(zip([E for kind, E in organs(rows) if kind == inertia], MARKERS, strict=False))


def drift(run: Row) -> float:
    """Return the drift of a run [mm]."""
    return run.drift / MILLI


def created_share(run: Row) -> float:
    """Return the energy that a run created over the work of the hand."""
    return run.created


def stability_map(axes: Axes, rows: Sequence[Row], inertia: bool) -> None:
    """Draw every run at its step and stiffness, the ways one below the other."""
    stiffnesses = [E for E, _ in organ_markers(rows, inertia)]
    for level, E in enumerate(stiffnesses):
        for k, way in enumerate(WAYS):
            states(axes, runs_of(rows, way, inertia, E), level + 0.25 * (1 - k), COLOUR_OF[way])
    for way, colour in COLOUR_OF.items():
        axes.plot([], [], "s", color=colour, label=way)
    axes.set(ylim=(-0.6, len(stiffnesses) - 0.1), ylabel="Young's modulus [kPa]")
    axes.set_yticks(range(len(stiffnesses)), [f"{E / KILO:g}" for E in stiffnesses])
    axes.set_title(("organ with inertia" if inertia else "quasi-static organ") + "; □ creates energy, × breaks off")
    axes.legend(loc="upper left", ncols=3, columnspacing=1.0, handletextpad=0.1)
    over_steps(axes)


def states(axes: Axes, runs: Sequence[Row], level: float, colour: str) -> None:
    """Draw one line of the map: filled where stable, hollow where energy was created, a cross where the run broke
    off."""
    for run in runs:
        face = colour if run.stable else "white"
        marker = "s" if run.completed else "x"
        axes.plot(run.dt / MILLI, level, marker, color=colour, markerfacecolor=face, markersize=4)


def error_over_cost(axes: Axes, rows: Sequence[Row], inertia: bool) -> None:
    """Draw the error of the exit over the linear systems solved, of the stable runs of one stiffness."""
    E = min((E for kind, E in organs(rows) if kind == inertia), key=lambda E: abs(np.log(E / SHOWN)))
    for way, marker in zip(WAYS, MARKERS, strict=False):
        runs = [run for run in runs_of(rows, way, inertia, E) if run.stable]
        values = [run.error for run in runs]
        axes.plot([run.solves for run in runs], values, color=COLOUR_OF[way], marker=marker, label=way)
    axes.set(xscale="log", yscale="log", xlabel="linear systems solved [-]", ylabel="error of the exit / its way [-]")
    axes.set_title(f"{E / KILO:g} kPa, stable runs")
    axes.legend()


def curve(axes: Axes, runs: Sequence[Row], value: Callable[[Row], float], colour: str, marker: str, label: str) -> None:
    """Draw one organ: filled where stable, hollow where not; nothing where the run broke off."""
    dt, y = np.array([run.dt for run in runs]) / MILLI, np.array([value(run) for run in runs])
    done, stable = np.array([run.completed for run in runs]), np.array([run.stable for run in runs])
    axes.plot(dt[done], y[done], color=colour)
    for chosen, face in ((stable, colour), (done & ~stable, "white")):
        axes.plot(dt[chosen], y[chosen], marker, color=colour, markerfacecolor=face)
    axes.plot([], [], marker=marker, color=colour, label=label)


def drift_axes(axes: Axes) -> None:
    """Draw the drift over the step."""
    axes.set(yscale="log", ylabel="largest drift |P − x| [mm]")
    axes.set_title("filled: stable, hollow: creates energy")
    axes.legend(fontsize=6)
    over_steps(axes)


def energy_axes(axes: Axes) -> None:
    """Draw the created energy over the step: linear near zero, where its sign matters."""
    axes.set(ylim=(-1.0, 1e3), ylabel="created energy / work of the hand [-]")
    axes.set_yscale("symlog", linthresh=CREATED)
    axes.axhline(CREATED, color="black", linewidth=0.8, linestyle="--")
    over_steps(axes)


def over_steps(axes: Axes) -> None:
    """Set up the axis of the time step."""
    axes.set(xscale="log", xlim=(0.06, 13.0), xlabel="time step [ms]")
    ticks(axes, "x", TICKS)


STUDY = Study(
    main=main,
    question="What does one system of thread and organ buy over the staggered variant of §4.4 and the linear step?",
    independent="a stable exchange destroys energy, and it diverges where the thread's stiffness times the organ's "
    "compliance is above one; every error falls with the step",
    consistency="the same scenario from the same state all ways, over stiffness, step and inertia",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={"stiffnesses": (2e3, 2.5e5), "step_counts": (10, 40, 320), "size": 5e-3},
)
