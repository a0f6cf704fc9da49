"""Staggered against monolithic (§4.4): what one system of thread and organ buys over the quasi-static variant.

A suture through two ideal holes of a soft block, one end held, the other drawn out and let back by a hand. From one
settled state the same scenario is stepped both ways over the organ's stiffness and the time step, with an organ that
has inertia and with one that has none. Measured are the drift |P(s) − x| at the holes, the energy that the lag between
thread and organ creates, over the work that the hand puts in, and which steps are stable. A consistency check of two of
our own paths; that the exchange destroys energy while it is stable is the theory it can be held against
(`coupling.staggered`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from coupling import staggered
from coupling.audit import audited, initial_energies
from coupling.errors import CouplingError
from coupling.stepping import Take, advance, try_step
from coupling.system import State, System
from studies.assembly import assemble
from studies.figure import COLOURS, MARKERS, panels, ticks
from studies.limits import beyond_linear, too_coarse
from studies.scenario import Scenario, parse
from studies.simulation import largest_gap
from studies.study import Study, Table, unit

STIFFNESSES = (2e3, 1e4, 5e4, 2.5e5)  # of the organ [Pa]: fat to firm phantom
STEP_COUNTS = (12, 17, 25, 35, 50, 71, 100, 141, 200, 283, 400)  # over DURATION
SIZE = 2.5e-3  # of the mesh [m]
FOOTPRINT = 2e-3  # [m]

HOLD, HOLD_STEP = 0.1, 2e-3  # the thread settles, always in one system [s]
DURATION = 0.1  # of pull and release [s]
WAY = 6e-3  # of the hand, out and back [m]
HALF = 5e-3  # of the distance of the holes [m]
CREATED = 0.1  # of the hand's work: a run whose lag has created more is unstable

MILLI, KILO = 1e-3, 1e3
COMPARED = (2.5e-4, 1e-3, 4e-3)  # steps in the table [s]
TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # [ms]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One run. `created` is over `external_work`, what the hand puts in while it gives, in the monolithic run of the
    finest step."""

    coupling: str
    inertia: bool  # of the organ
    youngs_modulus: float = unit("Pa")
    size: float = unit("m")  # of the mesh
    dt: float = unit("s")
    completed: bool
    drift: float = unit("m")  # largest |P(s) − x|
    moved: float = unit("m")  # farthest a hole moved
    created: float = unit("-")
    external_work: float = unit("J")

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
    """Every run."""
    with threadpool_limits(limits=1, user_api="blas"):
        for inertia, E in product(inertias, stiffnesses):
            yield from compared(scenario(E, inertia, size), size, sorted(step_counts))


def scenario(youngs_modulus: float, inertia: bool = True, size: float = SIZE) -> Scenario:
    """A suture down into a block, under its surface, and up again; its end goes out and back, from `HOLD` on."""
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


def compared(scenario: Scenario, size: float, step_counts: Sequence[int]) -> list[Row]:
    """One organ, both ways, all steps."""
    assembly = assemble(scenario)
    system, state = assembly.system, assembly.start()
    for _ in range(round(HOLD / HOLD_STEP)):
        state = advance(system, state, HOLD_STEP)[-1].new
    ways = {"monolithic": try_step, "staggered": staggered.take}
    runs = {(way, n): stepped(system, state, take, n) for way, take in ways.items() for n in step_counts}
    work = runs["monolithic", step_counts[-1]].external_work
    table = scenario.tissue
    assert table is not None
    return [
        Row(
            coupling=way,
            inertia=table.inertia,
            youngs_modulus=table.youngs_modulus,
            size=size,
            dt=DURATION / n,
            completed=run.completed,
            drift=run.drift,
            moved=run.moved,
            created=run.created / work,
            external_work=work,
        )
        for (way, n), run in runs.items()
    ]


@dataclass(frozen=True)
class Run:
    """What one run showed, up to where it broke off: [m], [m], [J], [J]."""

    completed: bool
    drift: float
    moved: float
    created: float
    external_work: float


def stepped(system: System, state: State, take: Take, n: int) -> Run:
    """Pull and release in `n` steps, none of them halved: a step that fails ends the run."""
    first, met, energies = state, state.y, initial_energies(system, state)
    drift = moved = created = work = 0.0
    for _ in range(n):
        try:
            step = take(system, state, DURATION / n)
        except CouplingError:
            return Run(False, drift, moved, created, work)
        created += staggered.work_of_the_lag(system, met, step)
        before, energies = energies, audited(system, energies, step)
        state, met = step.new, step.solution.iterate.y
        drift = max(drift, largest_gap(system, state))
        moved = max(moved, float(np.linalg.norm((state.y - first.y)[:, :3], axis=1).max()))
        work += max(0.0, energies.external_work - before.external_work)
    return Run(True, drift, moved, created, work)


def of(rows: Sequence[Row], coupling: str, inertia: bool, youngs_modulus: float) -> list[Row]:
    """The runs of one organ one way, finest step first."""
    found = [r for r in rows if (r.coupling, r.inertia, r.youngs_modulus) == (coupling, inertia, youngs_modulus)]
    return sorted(found, key=lambda row: row.dt)


def organs(rows: Sequence[Row]) -> list[tuple[bool, float]]:
    """Inertia and Young's modulus [Pa] of every organ."""
    return list(dict.fromkeys((row.inertia, row.youngs_modulus) for row in rows))


def largest_stable(runs: Sequence[Row]) -> float:
    """The largest step below which every one is stable [s], zero if the finest is not; `runs` finest first."""
    stable = 0.0
    for run in runs:
        if not run.stable:
            break
        stable = run.dt
    return stable


# --- table and figure -------------------------------------------------------------------------------------


def table(rows: Sequence[Row]) -> Table:
    """One line an organ."""
    steps = " / ".join(f"{dt / MILLI:g}" for dt in COMPARED) + " ms"
    head = (
        "organ",
        "E [kPa]",
        "hole moves [mm]",
        "drift, monolithic, at most [mm]",
        f"drift, staggered, at {steps} [mm]",
        f"energy created, staggered, at {steps} [% of the hand's work]",
        "largest stable step, monolithic [ms]",
        "largest stable step, staggered [ms]",
    )
    return Table(head, [table_line(rows, *organ) for organ in organs(rows)])


def table_line(rows: Sequence[Row], inertia: bool, youngs_modulus: float) -> list[str]:
    """Drift and energy at the steps next to those of COMPARED."""
    whole = of(rows, "monolithic", inertia, youngs_modulus)
    parts = of(rows, "staggered", inertia, youngs_modulus)
    chosen = [min(parts, key=lambda run: abs(np.log(run.dt / dt))) for dt in COMPARED]
    return [
        "with inertia" if inertia else "quasi-static",
        f"{youngs_modulus / KILO:g}",
        f"{whole[0].moved / MILLI:.2g}",
        f"{max(run.drift for run in whole) / MILLI:.0e}",
        " / ".join(f"{run.drift / MILLI:.2g}" if run.completed else "broke off" for run in chosen),
        " / ".join(f"{100.0 * run.created:+.2g}" if run.completed else "broke off" for run in chosen),
        stable_text(whole),
        stable_text(parts),
    ]


def stable_text(runs: Sequence[Row]) -> str:
    """The largest stable step [ms] as far as the ladder of steps tells; where only coarse ones are stable, those."""
    stable = [run.dt / MILLI for run in runs if run.stable]
    largest = largest_stable(runs) / MILLI
    if not stable:
        return "none"
    if len(stable) == len(runs):
        return f"≥ {largest:.2g}"
    return f"{largest:.2g}" if largest else "only " + ", ".join(f"{dt:.2g}" for dt in stable)


def remarks(rows: Sequence[Row]) -> list[str]:
    """Organs too soft for small strains, and a mesh too coarse for the footprint."""
    out = too_coarse("every run", rows[0].size, FOOTPRINT)
    for inertia, E in organs(rows):
        name = f"{'organ with inertia' if inertia else 'quasi-static organ'} of {E / KILO:g} kPa"
        out += beyond_linear(name, of(rows, "monolithic", inertia, E)[0].moved, FOOTPRINT)
    return out


def figure(rows: Sequence[Row]) -> Figure:
    """Drift and created energy over the step, a row of panels for each kind of organ."""
    kinds = list(dict.fromkeys(row.inertia for row in rows))
    drawing, grid = panels(len(kinds), 2)
    for line, inertia in zip(grid, kinds, strict=True):
        name = "organ with inertia" if inertia else "quasi-static organ"
        for (kind, E), colour, marker in zip(
            [organ for organ in organs(rows) if organ[0] == inertia], COLOURS, MARKERS, strict=False
        ):
            runs = of(rows, "staggered", kind, E)
            label = f"{E / KILO:g} kPa"
            curve(line[0], runs, [run.drift / MILLI for run in runs], colour, marker, label)
            curve(line[1], runs, [run.created for run in runs], colour, marker, label)
        drift_axes(line[0], name)
        energy_axes(line[1], name)
    return drawing


def curve(axes: Axes, runs: Sequence[Row], values: Sequence[float], colour: str, marker: str, label: str) -> None:
    """One organ: filled where stable, hollow where not; a cross at the upper edge where the run broke off, so that it
    has no value."""
    dt = np.array([run.dt for run in runs]) / MILLI
    y, done = np.array(values), np.array([run.completed for run in runs])
    stable = np.array([run.stable for run in runs])
    axes.plot(dt[done], y[done], color=colour)
    for chosen, face in ((stable, colour), (done & ~stable, "white")):
        axes.plot(dt[chosen], y[chosen], marker, color=colour, markerfacecolor=face)
    line = np.full(np.sum(~done), 0.97 - 0.05 * MARKERS.index(marker))
    axes.plot(dt[~done], line, "x", color=colour, transform=axes.get_xaxis_transform())
    axes.plot([], [], marker=marker, color=colour, label=label)


def drift_axes(axes: Axes, name: str) -> None:
    """Drift over the step."""
    axes.set(yscale="log", ylim=(0.001, 4.0), ylabel="largest drift |P − x| [mm]")
    axes.set_title(f"{name}, staggered")
    axes.legend(title="Young's modulus", loc="lower right")
    over_steps(axes)


def energy_axes(axes: Axes, name: str) -> None:
    """Created energy over the step: linear near zero, where its sign matters."""
    axes.set(ylim=(-1.0, 1e5), ylabel="created energy / work of the hand [-]")
    axes.set_yscale("symlog", linthresh=CREATED)
    axes.axhline(CREATED, color="black", linewidth=0.8, linestyle="--")
    axes.set_title("filled: stable, hollow: not, ×: broke off")
    over_steps(axes)


def over_steps(axes: Axes) -> None:
    """The axis of the time step."""
    axes.set(xscale="log", xlim=(0.2, 12.0), xlabel="time step [ms]")
    ticks(axes, "x", TICKS)


STUDY = Study(
    main=main,
    question="What does one system of thread and organ buy over the quasi-static, staggered variant of §4.4?",
    independent="a stable exchange destroys energy, and it diverges where the thread's stiffness times the organ's "
    "compliance is above one",
    consistency="the same scenario from the same state both ways, over stiffness, step and inertia",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={"stiffnesses": (2e3, 2.5e5), "step_counts": (12, 25, 100, 200), "size": 5e-3},
)
