"""Staggered against monolithic (§4.4): what one system of thread and organ buys over the quasi-static variant.

A suture through two ideal holes of a soft block, one end held, the other drawn out and let back by a hand. From one
settled state the same scenario is stepped both ways over the organ's stiffness and the time step, with an organ that
has inertia and with one that has none. Measured are the drift |P(s) − x| at the holes, the energy that the lag between
thread and organ creates, over the work that the hand puts in, and which steps are stable. A consistency check of two of
our own paths; that the exchange destroys energy while it is stable is the theory it can be held against
(`coupling.staggered`).

    python -m studies.coupling_variants [FOLDER]
"""

import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from coupling import staggered
from coupling.audit import audited, initial_energies
from coupling.errors import CouplingError
from coupling.stepping import Take, advance, try_step
from coupling.system import State, System
from studies.assembly import assemble
from studies.files import write_bytes, write_text
from studies.scenario import Scenario, parse
from studies.simulation import largest_gap

HERE = Path(__file__).parent
STIFFNESSES = (2e3, 1e4, 5e4, 2.5e5)  # of the organ [Pa]: fat to firm phantom
STEP_COUNTS = (12, 17, 25, 35, 50, 71, 100, 141, 200, 283, 400)  # over DURATION
SIZE = 2.5e-3  # of the mesh [m]

HOLD, HOLD_STEP = 0.1, 2e-3  # the thread settles, always in one system [s]
DURATION = 0.1  # of pull and release [s]
WAY = 6e-3  # of the hand, out and back [m]
HALF = 5e-3  # of the distance of the holes [m]
CREATED = 0.1  # of the hand's work: a run whose lag has created more is unstable

MILLI, KILO = 1e-3, 1e3
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")  # Okabe & Ito, told apart by the colour-blind
MARKERS = ("o", "s", "^", "D")
COMPARED = (2.5e-4, 1e-3, 4e-3)  # steps in the table [s]
TICKS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # [ms]


@dataclass(frozen=True)
class Row:
    """One run. `created` is over `external_work`, what the hand puts in while it gives, in the monolithic run of the
    finest step."""

    coupling: str
    inertia: bool  # of the organ
    youngs_modulus: float  # [Pa]
    dt: float  # [s]
    completed: bool
    drift: float  # largest |P(s) − x| [m]
    moved: float  # farthest a hole moved [m]
    created: float  # [-]
    external_work: float  # [J]

    @property
    def stable(self) -> bool:
        """Whether the run came to its end, and not on energy from nowhere."""
        return self.completed and self.created <= CREATED


def main(
    stiffnesses: Sequence[float] = STIFFNESSES,
    step_counts: Sequence[int] = STEP_COUNTS,
    size: float = SIZE,
    inertias: Sequence[bool] = (True, False),
    folder: Path | None = None,
) -> list[Row]:
    """Every run; table, numbers and figure into `folder` if one is given."""
    rows: list[Row] = []
    with threadpool_limits(limits=1, user_api="blas"):
        for inertia in inertias:
            for E in stiffnesses:
                rows += compared(scenario(E, inertia, size), sorted(step_counts))
    if folder is not None:
        written(rows, folder)
    return rows


def scenario(youngs_modulus: float, inertia: bool = True, size: float = SIZE) -> Scenario:
    """A suture down into a block, under its surface, and up again; its end goes out and back, from `HOLD` on."""
    phase = np.linspace(0.0, 1.0, 33)
    out = WAY * np.sin(np.pi * phase) ** 2
    hand = [[HOLD + DURATION * t, 0.02 + 0.8 * x, 0.0, 0.02 + 0.6 * x] for t, x in zip(phase, out, strict=True)]
    hole = {"direction": "normal", "footprint": 2e-3, "subgrid": False}  # the same organ on every mesh it is run on
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


def compared(scenario: Scenario, step_counts: Sequence[int]) -> list[Row]:
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
            way,
            table.inertia,
            table.youngs_modulus,
            DURATION / n,
            run.completed,
            run.drift,
            run.moved,
            run.created / work,
            work,
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


def written(rows: Sequence[Row], folder: Path) -> None:
    """Table (Markdown), numbers (CSV) and figure (PNG, SVG) into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "table.md", table(rows))
    write_text(folder / "runs.csv", numbers(rows))
    drawn = figure(rows)
    for kind in ("png", "svg"):
        buffer = io.BytesIO()
        with rc_context({"svg.fonttype": "none", "svg.hashsalt": "coupling variants"}):
            drawn.savefig(buffer, format=kind, dpi=120, metadata={"Date": None} if kind == "svg" else None)
        write_bytes(folder / f"figure.{kind}", buffer.getvalue())


def numbers(rows: Sequence[Row]) -> str:
    """Every run, SI units."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [f.name for f in fields(Row)] + ["stable"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) | {"stable": row.stable} for row in rows)
    return text.getvalue()


def table(rows: Sequence[Row]) -> str:
    """One line an organ, in Markdown."""
    steps = " / ".join(f"{dt / MILLI:g}" for dt in COMPARED) + " ms"
    head = (
        f"| organ | E [kPa] | hole moves [mm] | drift, monolithic, at most [mm] | drift, staggered, at {steps} [mm] | "
        f"energy created, staggered, at {steps} [% of the hand's work] | largest stable step, monolithic [ms] | "
        "largest stable step, staggered [ms] |"
    )
    rule = "|" + " --- |" * head.count(" | ") + " --- |"
    return "\n".join([head, rule, *(table_line(rows, *organ) for organ in organs(rows))]) + "\n"


def table_line(rows: Sequence[Row], inertia: bool, youngs_modulus: float) -> str:
    """Drift and energy at the steps next to those of COMPARED."""
    whole = of(rows, "monolithic", inertia, youngs_modulus)
    parts = of(rows, "staggered", inertia, youngs_modulus)
    chosen = [min(parts, key=lambda run: abs(np.log(run.dt / dt))) for dt in COMPARED]
    cells = [
        "with inertia" if inertia else "quasi-static",
        f"{youngs_modulus / KILO:g}",
        f"{whole[0].moved / MILLI:.2g}",
        f"{max(run.drift for run in whole) / MILLI:.0e}",
        " / ".join(f"{run.drift / MILLI:.2g}" if run.completed else "broke off" for run in chosen),
        " / ".join(f"{100.0 * run.created:+.2g}" if run.completed else "broke off" for run in chosen),
        stable_text(whole),
        stable_text(parts),
    ]
    return "| " + " | ".join(cells) + " |"


def stable_text(runs: Sequence[Row]) -> str:
    """The largest stable step [ms] as far as the ladder of steps tells; where only coarse ones are stable, those."""
    stable = [run.dt / MILLI for run in runs if run.stable]
    largest = largest_stable(runs) / MILLI
    if not stable:
        return "none"
    if len(stable) == len(runs):
        return f"≥ {largest:.2g}"
    return f"{largest:.2g}" if largest else "only " + ", ".join(f"{dt:.2g}" for dt in stable)


def figure(rows: Sequence[Row]) -> Figure:
    """Drift and created energy over the step, a row of panels for each kind of organ."""
    kinds = list(dict.fromkeys(row.inertia for row in rows))
    drawing = Figure(figsize=(8.4, 3.4 * len(kinds)), layout="constrained")
    for line, inertia in zip(drawing.subplots(len(kinds), 2, squeeze=False), kinds, strict=True):
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
    axes.plot(dt[done], y[done], color=colour, linewidth=1.0)
    for chosen, face in ((stable, colour), (done & ~stable, "white")):
        axes.plot(dt[chosen], y[chosen], marker, color=colour, markerfacecolor=face, markersize=5)
    line = np.full(np.sum(~done), 0.97 - 0.05 * MARKERS.index(marker))
    axes.plot(dt[~done], line, "x", color=colour, markersize=5, transform=axes.get_xaxis_transform())
    axes.plot([], [], marker=marker, color=colour, markersize=5, label=label)


def drift_axes(axes: Axes, name: str) -> None:
    """Drift over the step."""
    axes.set(yscale="log", ylim=(0.001, 4.0), ylabel="largest drift |P − x| [mm]")
    axes.set_title(f"{name}, staggered", fontsize=10)
    axes.legend(title="Young's modulus", fontsize=8, title_fontsize=8, loc="lower right")
    over_steps(axes)


def energy_axes(axes: Axes, name: str) -> None:
    """Created energy over the step: linear near zero, where its sign matters."""
    axes.set(ylim=(-1.0, 1e5), ylabel="created energy / work of the hand [-]")
    axes.set_yscale("symlog", linthresh=CREATED)
    axes.axhline(CREATED, color="black", linewidth=0.8, linestyle="--")
    axes.set_title("filled: stable, hollow: not, ×: broke off", fontsize=10)
    over_steps(axes)


def over_steps(axes: Axes) -> None:
    """The axis of the time step."""
    axes.set(xscale="log", xlim=(0.2, 12.0), xlabel="time step [ms]")
    axes.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    axes.minorticks_off()
    axes.grid(alpha=0.3)


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "results" / "coupling_variants"
    print(table(main(folder=target)))
