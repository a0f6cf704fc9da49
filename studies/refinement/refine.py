"""A refinement into a folder: the levels are run as a sweep, and each quantity gets its verdict."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import isnan, nan
from pathlib import Path

from studies.output.files import write_json, write_text
from studies.output.remarks import CATALOGUE
from studies.refinement.ladder import KINDS, LEAST, LEVELS, Ladder, Refined, ladder
from studies.scenario import ScenarioError, because, parsed
from studies.study import Table
from studies.sweeps.sweep import Base, Tell, base_tables, sweep
from studies.sweeps.table import Column, SweepTable, asked_column
from studies.verdicts import verdict
from studies.workers import Workers, nothing

ACCURACY = "accuracy"  # the kind of levels of `adaptive`
NO_ORDER = ("unresolved", "zero")  # kinds of verdicts
ESTIMATE = "compliance_error"  # of a piercing in the summary


def refine(
    base: Base,
    quantity: str | Sequence[str],
    folder: Path | str,
    over: str = "all",
    levels: int = LEVELS,
    ratio: float | None = None,
    workers: Workers | None = None,
    tell: Tell = nothing,
    adaptive: bool = False,
) -> tuple[Refined, ...]:
    """Refine a scenario level by level into a folder, and return the result for each quantity.

    - `base`: a file, a shipped scene by its name, tables, or a scenario.
    - `quantity`: numbers of the summary by their dotted names, as in `studies.output.columns`.
    - `over`: "h", "dt", "control_points", "footprint", "accuracy" (of the cells at the holes), or
      "all", the first three.
    - `ratio`: ratio of the levels; None means √2, or 2 for the accuracy.
    - `workers`: as in `studies.sweeps.sweep`.
    - `adaptive`: the same as `over="accuracy"`.

    Raises `ScenarioError`, for an unknown quantity before the first level is run, and
    `studies.workers.WorkersError`.
    """
    from studies.figure import write_figure  # refused before the runs if matplotlib is missing
    from studies.refinement.figure import figure

    names = list(quantity) if isinstance(quantity, Sequence) and not isinstance(quantity, str) else [quantity]
    if not names or not all(isinstance(name, str) for name in names):
        raise ScenarioError(f"quantity = {quantity!r} is refused; give the name of a number of the summary, or several")
    if adaptive and over not in ("all", ACCURACY):
        raise ScenarioError(f"--over {over} is refused: {because('over-adaptive')}")
    plain = base_tables(base)
    rungs = ladder(parsed(plain), ACCURACY if adaptive else over, levels, ratio)

    def check(table: SweepTable) -> list[Column]:
        return [asked_column(table, name, "--quantity") for name in names]

    table = sweep(plain, rungs.settings, folder, workers, tell, "refinement", check)
    rungs = as_estimated(as_meshed(rungs, table), table)
    found = tuple(refined(name, rungs, table) for name in names)
    write(found, rungs, Path(folder))
    write_figure(partial(figure, rungs=rungs), found, "refinement", Path(folder))
    return found


def as_meshed(rungs: Ladder, table: SweepTable) -> Ladder:
    """Return the levels with the factors of their real meshes.

    They are unchanged unless cells are refined and all meshes were made. The factor is (cells of
    the level over cells of the coarsest level)^⅓ (Celik et al. 2008).
    """
    cells = table["cells"].values
    if "h" not in rungs.kinds or None in cells:
        return rungs
    return replace(rungs, factors=tuple((float(n) / float(cells[0])) ** (1 / 3) for n in cells if n and cells[0]))


def as_estimated(rungs: Ladder, table: SweepTable) -> Ladder:
    """Return the levels with their estimated errors at the holes, if an accuracy is refined.

    Their factors are the ratios of these estimates.
    """
    if rungs.kinds != (ACCURACY,):
        return rungs
    columns = [column.values for column in table.columns if column.name.endswith(f".{ESTIMATE}")]
    rows = zip(*columns, strict=True) if columns else [()] * len(table)
    estimates = tuple(max((float(value) for value in row if value is not None), default=nan) for row in rows)
    begin = next((estimate for estimate in estimates if estimate > 0.0), nan)
    pairs = zip(rungs.factors, estimates, strict=True)
    factors = tuple(begin / estimate if estimate > 0.0 else factor for factor, estimate in pairs)
    return replace(rungs, factors=factors, estimates=estimates, unknowns=tuple(table["tissue_dofs"].converted))


def refined(name: str, rungs: Ladder, table: SweepTable) -> Refined:
    """Return the convergence of a quantity over the levels of a table.

    Raises `ScenarioError` if the quantity is not a number.
    """
    column = asked_column(table, name, "--quantity")
    ended = zip(table["exit_status"].values, column.converted, strict=True)
    values = tuple(nan if status or value is None else float(value) for status, value in ended)
    sizes = rungs.estimates or [1.0 / factor for factor in rungs.factors]
    pairs = [(size, number) for size, number in zip(sizes, values, strict=True) if not isnan(number)]
    judged, why = None, too_few(sizes, values, rungs.kinds)
    if not why:
        refined_by, numbers = zip(*pairs, strict=True)
        judged = verdict(refined_by, numbers, rungs.order, estimated=bool(rungs.estimates))
    given = column.name, column.unit, rungs.factors, values, rungs.order
    return Refined(*given, judged, why, rungs.estimates, notes_on(table))


def too_few(sizes: Sequence[float], values: Sequence[float], kinds: Sequence[str]) -> str:
    """Return why a quantity has too few levels for a verdict; empty if it has enough.

    Its `values` are NaN for a failed level. Levels of one size, such as those whose cell counts
    round to the same mesh, count once.
    """
    levels = dict[float, list[int]]()
    for level, (size, value) in enumerate(zip(sizes, values, strict=True)):
        if not isnan(value):
            levels.setdefault(size, []).append(level)
    if len(levels) >= LEAST:
        return ""
    same = [" and ".join(map(str, equal)) for equal in levels.values() if len(equal) > 1]
    distinct = " distinct" if same else ""
    why = f"only {len(levels)}{distinct} of {len(values)} levels have the number, but {LEAST} are needed"
    if not same:
        return why
    alike = "mesh, because its number of cells did not change" if "h" in kinds else f"size ({KINDS[kinds[0]].words})"
    return f"{why}: levels {', '.join(same)} have the same {alike}; give a larger --ratio or more --levels"


def notes_on(table: SweepTable) -> tuple[str, ...]:
    """Return lines on the levels: the remarks on unsupported numbers, and the reason of each failure."""
    codes, failures = dict[str, list[str]](), []
    for case, (remarks, error) in enumerate(zip(table["remarks"].values, table["error"].values, strict=True)):
        for code in str(remarks).split("; "):
            if CATALOGUE.get(code.partition(" ")[0], {}).get("severity") == "unsupported":
                codes.setdefault(code, []).append(str(case))
        failures += [f"case {case} is not completed: {'; '.join(str(error).splitlines())}"] if error else []
    found = "; ".join(f"{code} in case {', '.join(cases)}" for code, cases in codes.items())
    return (*([f"not supported: {found}"] if found else []), *failures)


def markdown(found: Sequence[Refined], rungs: Ladder) -> str:
    """Return the verdicts in Markdown."""
    rows = [in_words(one) for one in found]
    table = Table(list(rows[0]), [list(row.values()) for row in rows])
    return "\n\n".join([title(found[0], rungs), *found[0].notes, table.markdown])


def title(one: Refined, rungs: Ladder) -> str:
    """Return the refined quantity, the factors and the unknowns, in words."""
    what = ", ".join(KINDS[kind].words for kind in rungs.kinds)
    factors = ", ".join(f"{factor:.3g}" for factor in one.factors)
    unknowns = f" Unknowns of the organ: {', '.join(map(str, rungs.unknowns))}." if rungs.unknowns else ""
    return f"Refined: {what}, by {factors}. Theoretical order {one.theory:g}.{unknowns}"


def in_words(one: Refined) -> dict[str, str]:
    """Return the findings as texts for a person, by their headings."""
    judged = one.verdict
    known = None if judged is None or judged.kind in NO_ORDER else judged.order
    order = "" if known is None else "swings" if isnan(known) else f"{known:.2f}"
    limit = "" if judged is None or isnan(judged.limit) else f"{judged.limit:.6g}"
    between = "" if one.interval is None else "{:.6g} to {:.6g}".format(*one.interval)
    numbers = ", ".join("failed" if isnan(number) else f"{number:.6g}" for number in one.numbers)
    estimates = ", ".join("none" if isnan(error) else f"{100.0 * error:.2g} %" for error in one.estimates)
    return {
        "quantity": f"`{one.quantity}`",
        "unit": one.unit,
        "levels, coarsest first": numbers,
        **({"estimate, error of the compliance": estimates} if estimates else {}),
        "order": order,
        "limit": limit,
        "interval": between,
        "verdict": one.text,
    }


def write(found: Sequence[Refined], rungs: Ladder, folder: Path) -> None:
    """Write ``verdict.md`` and ``verdict.json``."""
    write_text(folder / "verdict.md", markdown(found, rungs))
    quantities = [one.record() for one in found]
    write_json(folder / "verdict.json", {"over": rungs.kinds, "unknowns": rungs.unknowns, "quantities": quantities})
