"""The levels of a refinement of a scenario, and the convergence of a number over them.

Each level has finer cells, steps or spans, or smaller footprints.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import isfinite, isnan, nan, sqrt
from numbers import Integral, Real
from typing import Any

from studies.scenario import FileMesh, GivenMesh, Scenario, ScenarioError, because
from studies.verdicts import Verdict

LEVELS = 4
LEAST = 3  # number of levels needed for a verdict
RATIO = sqrt(2.0)  # between levels: the number of cells grows by 2.8, and Celik et al. 2008 recommend 1.3 or more
LEAST_RATIO = 1.1
NO_VERDICT = "no verdict"
END_POINTS = 3  # control points in addition to the spans of a cubic spline

Settings = dict[str, Any]
Finer = Callable[[Scenario, float], Settings]  # returns the keys of a scenario refined by a factor


@dataclass(frozen=True)
class Kind:
    """A quantity that can be refined.

    `words` is its name, `finer` returns the keys of a refined scenario, and `order` the theoretical
    order of the errors. `lacking` returns the reason why a scenario lacks the quantity, or None.
    `ratio` is the default ratio of its levels.
    """

    words: str
    finer: Finer
    order: Callable[[Scenario], float]
    lacking: Callable[[Scenario], str | None]
    ratio: float = RATIO


def finer_cells(scenario: Scenario, factor: float) -> Settings:
    """Return the refined sizes of the mesh."""
    mesh: Any = scenario.tissue.mesh if scenario.tissue else None
    sizes = {key: getattr(mesh, key, None) for key in ("h", "h_site")}
    return {f"tissue.mesh.{key}": size / factor for key, size in sizes.items() if size is not None}


def finer_holes(scenario: Scenario, factor: float) -> Settings:
    """Return the refined accuracy of the cells at the holes."""
    accuracy = scenario.tissue.mesh.accuracy if scenario.tissue else "given"
    return {} if accuracy == "given" else {"tissue.mesh.accuracy": accuracy / factor}


def finer_steps(scenario: Scenario, factor: float) -> Settings:
    """Return the refined time step, or the larger number of load steps.

    The time between frames is unchanged.
    """
    solve, every = scenario.solve, max(1, round(scenario.output.every * factor))
    if solve.kind == "static":
        return {"solve.load_steps": round(solve.load_steps * factor), "output.every": every}
    return {"solve.dt": solve.duration / round(solve.steps * factor), "output.every": every}


def finer_spans(scenario: Scenario, factor: float) -> Settings:
    """Return the larger number of control points."""
    return {"thread.control_points": round((scenario.thread.control_points - END_POINTS) * factor) + END_POINTS}


def smaller_footprints(scenario: Scenario, factor: float) -> Settings:
    """Return the smaller radii of the footprints."""
    return {f"piercing.{k}.footprint": hole.footprint / factor for k, hole in enumerate(scenario.piercing)}


def no_cells(scenario: Scenario) -> str | None:
    """Return the reason why a scenario has no cells to be refined, or None."""
    if scenario.tissue is None:
        return "the scenario has no organ"
    mesh = scenario.tissue.mesh
    if isinstance(mesh, FileMesh) and not mesh.is_surface:
        return f"the file {mesh.path} has fixed cells; give a surface to be filled, or several meshes by a sweep"
    if isinstance(mesh, GivenMesh):
        return "the given mesh has fixed cells; refine it, and prepare again"
    return None


def no_footprints(scenario: Scenario) -> str | None:
    """Return the reason why a scenario has no footprints to be made smaller, or None."""
    return None if any(hole.footprint for hole in scenario.piercing) else "no piercing has a footprint"


def no_accuracy(scenario: Scenario) -> str | None:
    """Return the reason why a scenario has no accuracy of cells at the holes, or None."""
    if scenario.tissue is None:
        return "the scenario has no organ"
    if scenario.tissue.mesh.accuracy == "given":
        return 'tissue.mesh.accuracy is "given"; set a number, for example 0.05'
    return no_footprints(scenario)


def order_of_cells(scenario: Scenario) -> float:
    """Return the order in the cell size of averages over a footprint: 2 for P1; 3 for P2.

    The order of P2 comes from h⁴ ln(a/h) (`studies.mesh_refinement`).
    """
    return 3.0 if scenario.tissue is not None and scenario.tissue.element == "P2" else 2.0


def order_of_steps(scenario: Scenario) -> float:
    """Return the order of the integrator, or 1 for load steps, which matter with friction."""
    solve = scenario.solve
    return 2.0 if solve.kind == "dynamic" and solve.integrator == "bdf2" else 1.0


KINDS = {
    "h": Kind("the size of the cells", finer_cells, order_of_cells, no_cells),
    "dt": Kind("the time step", finer_steps, order_of_steps, lambda scenario: None),
    # The bending moment has a kink at a hole, which a cubic cannot represent.
    "control_points": Kind("the spans of the thread", finer_spans, lambda scenario: 3.0, lambda scenario: None),
    "footprint": Kind("the radius of the footprints", smaller_footprints, lambda scenario: 2.0, no_footprints),
    # A level's size is the estimated error of the compliance, because the error of a number is
    # proportional to it.
    "accuracy": Kind(
        "the estimated error of the holes' compliance", finer_holes, lambda scenario: 1.0, no_accuracy, ratio=2.0
    ),
}
OVER = (*KINDS, "all")
DISCRETE = ("h", "dt", "control_points")  # refined by `all`; a footprint belongs to the model and not to the solution


@dataclass(frozen=True)
class Ladder:
    """Levels of a scenario, from the scenario itself, which is the coarsest.

    It has the refined quantities, the `settings` and `factor` of each level, and the theoretical
    order. For levels of accuracy it also has `estimates` of the relative error of the holes'
    compliance [-], NaN for a failed level. It then has the `unknowns` of the organ too. Otherwise
    both are empty.
    """

    kinds: tuple[str, ...]
    settings: tuple[Settings, ...]
    factors: tuple[float, ...]
    order: float
    estimates: tuple[float, ...] = ()
    unknowns: tuple[int | None, ...] = ()


def ladder(scenario: Scenario, over: str = "all", levels: int = LEVELS, ratio: float | None = None) -> Ladder:
    """Return the levels of a scenario, each finer by `ratio`; None means the default ratio.

    Raises `ScenarioError`.
    """
    kinds = kinds_of(scenario, over)
    step = max(KINDS[kind].ratio for kind in kinds) if ratio is None else ratio
    if not (isinstance(levels, Integral) and levels >= LEAST):
        raise ScenarioError(f"--levels {levels} is refused: a verdict needs {LEAST} or more levels")
    if not (isinstance(step, Real) and isfinite(step) and step >= LEAST_RATIO):
        raise ScenarioError(f"--ratio {ratio} is refused: give {LEAST_RATIO} or more, for example 1.5")
    factors = tuple(step**level for level in range(levels))
    settings = tuple(finer(scenario, kinds, factor) for factor in factors)
    order = min(KINDS[kind].order(scenario) for kind in kinds)
    levels_asked = zip(settings, factors, strict=True)
    rounded = tuple(effective(scenario, kinds, keys, factor) for keys, factor in levels_asked)
    if (distinct := len(set(rounded))) < LEAST:
        reason = because("ratio-rounded", distinct=distinct, levels=levels, least=LEAST)
        raise ScenarioError(f"--ratio {step:.4g} is refused: {reason}")
    return Ladder(kinds, settings, rounded, order)


def kinds_of(scenario: Scenario, over: str) -> tuple[str, ...]:
    """Return the refined quantities; for `all` every one that the scenario has.

    Raises `ScenarioError`.
    """
    if over == "all":
        return tuple(kind for kind in DISCRETE if KINDS[kind].lacking(scenario) is None)
    if not (isinstance(over, str) and over in KINDS):
        raise ScenarioError(f"--over {over} is refused: {because('over-unknown', known=', '.join(KINDS))}")
    if (reason := KINDS[over].lacking(scenario)) is not None:
        option = "--adaptive, or --over accuracy," if over == "accuracy" else f"--over {over}"
        raise ScenarioError(f"{option} is refused: {reason}")
    return (over,)


def finer(scenario: Scenario, kinds: tuple[str, ...], factor: float) -> Settings:
    """Return the keys of a scenario refined by a factor; empty for a factor of one."""
    if factor == 1.0:
        return {}
    return {key: value for kind in kinds for key, value in KINDS[kind].finer(scenario, factor).items()}


def effective(scenario: Scenario, kinds: tuple[str, ...], settings: Settings, factor: float) -> float:
    """Return the factor of a level from its keys, with rounded steps and spans."""
    if kinds == ("dt",) and "solve.load_steps" in settings:
        return float(settings["solve.load_steps"] / scenario.solve.load_steps)
    if kinds == ("dt",) and "solve.dt" in settings:
        return float(scenario.solve.dt / settings["solve.dt"])
    if kinds == ("control_points",) and settings:
        spans = settings["thread.control_points"] - END_POINTS
        return float(spans / (scenario.thread.control_points - END_POINTS))
    return factor


@dataclass(frozen=True)
class Refined:
    """Convergence of a quantity.

    `numbers` begin with the coarsest level, and are NaN for a failed level. It has the `factors` of
    the levels and the theoretical order. The verdict is None with fewer than three numbers. For
    levels of accuracy it also has the `estimates` of the relative error of the holes'
    compliance [-]; otherwise they are empty. `notes` are lines on unsupported numbers and failures of
    levels.
    """

    quantity: str
    unit: str
    factors: tuple[float, ...]
    numbers: tuple[float, ...]
    theory: float
    verdict: Verdict | None
    why_not: str = ""
    estimates: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Refined({self.quantity} [{self.unit}]: {self.text})"

    @property
    def finest(self) -> float:
        """The number of the finest completed level, NaN without one."""
        return next((number for number in reversed(self.numbers) if not isnan(number)), nan)

    @property
    def interval(self) -> tuple[float, float] | None:
        """The interval of the grid-convergence index about the finest number, or None."""
        if self.verdict is None or not isfinite(self.verdict.index):
            return None
        half = self.verdict.index * abs(self.finest)
        return self.finest - half, self.finest + half

    @property
    def converged(self) -> bool:
        """Whether the number is called converged."""
        return self.verdict is not None and self.verdict.kind == "converged"

    @property
    def text(self) -> str:
        """The verdict in words."""
        return f"{NO_VERDICT}: {self.why_not}" if self.verdict is None else self.verdict.text

    def record(self) -> dict[str, Any]:
        """Return the content of ``verdict.json``."""
        judged = {"order": None, "limit": None, "index": None, "kind": NO_VERDICT}
        judged |= asdict(self.verdict) if self.verdict else {}
        plain = {"quantity": self.quantity, "unit": self.unit, "factors": self.factors, "numbers": self.numbers}
        plain |= {"estimates": self.estimates} if self.estimates else {}
        return {**plain, "order_of_theory": self.theory, **judged, "interval": self.interval, "verdict": self.text}
