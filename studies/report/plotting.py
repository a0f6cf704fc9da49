"""``suture plot``: columns of a run over time, in one figure with a panel for each unit."""

from collections.abc import Sequence
from pathlib import Path

from studies.figure import COLOURS, literal, panels, styled
from studies.output.reading import OpenRun, ResultsError, open_run
from studies.report.charts import AXES, Series, series_of
from studies.scenario.refusal import nearest


def plot(folder: Path, names: Sequence[str], out: Path | None) -> list[str]:
    """Draw columns over time into a figure; return the lines for a person.

    Raises `ResultsError` for an unknown name, and for a file of another kind.
    """
    run = open_run(folder)
    lines = [line_of(run, name) for name in names]
    target = out or folder / "plot.png"
    if target.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise ResultsError(f"--out {target} is refused: name it {target.stem}.png, .svg or .pdf")
    units = list(dict.fromkeys(line.unit for line in lines))
    with styled():
        figure, axes = panels(len(units), 1)
        figure.set_size_inches(7.0, 1.0 + 2.6 * len(units))
        for unit, axis in zip(units, axes[:, 0], strict=True):
            for number, line in enumerate(line for line in lines if line.unit == unit):
                axis.plot(line.time, line.values, color=COLOURS[number % len(COLOURS)], label=literal(line.name))
            axis.set(xlabel="time [s]", ylabel=f"[{unit}]" if unit else "")
            axis.legend()
        axes[0, 0].set_title(literal(run.title), fontsize=9, wrap=True)
        figure.savefig(target, dpi=150)
    return [f"plot       {target}: {', '.join(names)}"]


def line_of(run: OpenRun, name: str) -> Series:
    """Return a column by its name, in the unit of the charts.

    Examples are `piercings.exit.tension_after`, `loads.top.share`, `energy.kinetic`,
    `piercings.exit.force` for the length of a vector and `piercings.exit.force_x` for a component.

    Raises `ResultsError` with the names that contain it, or with the nearest name.
    """
    known = {one.name: one for one in series_of(run, run.name, most=None) if one.column not in AXES}
    if name not in known:
        alike = [key for key in known if name in key]
        suggestion = nearest(name, alike or list(known))
        hint = f"the nearest is {suggestion}; " if suggestion else ""
        siblings = [key for key in known if key.partition(".")[0] == (suggestion or name).partition(".")[0]]
        there = ", ".join(alike or siblings or known)
        raise ResultsError(f"{name} is refused: the run has no such column; {hint}it has {there}")
    return known[name]
