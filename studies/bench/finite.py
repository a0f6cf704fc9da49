"""`suture bench finite`: what an organ at finite strain costs, at rest and in time.

At rest, the scene `skin` on P1 cells: from the mesh's matrices to the last of ten load steps. In time, a step of the
main job in tissue that stiffens beside one in linear tissue, in turn. Times are those of the processor, on one thread:
other work on the machine does not count.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import process_time

from threadpoolctl import threadpool_limits

import tissue
from coupling.run import begin
from studies.bench.step import COUPLED, FIXED, MILLI, SCENES, SIZES
from studies.output.files import read_json, write_json
from studies.output.provenance import provenance
from studies.scenario import load
from studies.simulation.assembly import assemble

SKIN = SCENES / "skin.toml"
AT_REST = {"15k": (2.4e-3, 1.0e-3), "37k": (2.2e-3, 0.6e-3)}  # far from and at the holes [m]
LOAD_STEPS = 10
STIFFENING = ['tissue.material="exponential"', "tissue.stiffening=5.0", "tissue.rayleigh=[5.7, 0.0]"]
WARM_UP, STEPS = 10, 25  # in time, of which the latter are timed


@dataclass(frozen=True)
class AtRest:
    """A static pull in `load_steps`: `start` until the first of them, `pull` for them [s]."""

    case: str
    tissue_unknowns: int
    solver: str
    load_steps: int
    start: float
    pull: float


@dataclass(frozen=True)
class InTime:
    """A step of an organ at finite strain and of a linear one: medians [ms], and their mean Newton corrections."""

    case: str
    tissue_unknowns: int
    step: float
    linear: float
    corrections: float
    linear_corrections: float

    @property
    def times_as_long(self) -> float:
        """The step at finite strain over the linear one."""
        return self.step / self.linear


def main(
    json_path: Path | None = None,
    solver: str = "auto",
    at_rest: Mapping[str, tuple[float, float]] = AT_REST,
    in_time: tuple[float, float] = SIZES["10k"],
) -> int:
    """Measure, print, and add to the JSON where asked; return the exit status."""
    print(f"{'at rest':10} {'unknowns':>9} {'solver':>10} {'load steps':>11} {'start [s]':>10} {'pull [s]':>9}")
    rows = []
    with threadpool_limits(limits=1, user_api="blas"):
        for case, mesh in at_rest.items():
            rows.append(measure_pull(case, [*sized(mesh), f'tissue.solver="{solver}"']))
            print(pull_line(rows[-1]), flush=True)
        step = measure_step("10k", [*sized(in_time), f'tissue.solver="{solver}"'])
    print(
        f"\nin time, {step.tissue_unknowns} unknowns: {step.step:.1f} ms a step ({step.corrections:.1f} corrections), "
        f"linear {step.linear:.1f} ms ({step.linear_corrections:.1f}); {step.times_as_long:.1f} times as long"
    )
    if json_path is not None:
        found = {
            "finite_at_rest": [asdict(row) for row in rows],
            "finite_in_time": asdict(step) | {"times_as_long": step.times_as_long},
        }
        write_json(json_path, {"provenance": provenance()} | read_json(json_path) | found)
    return 0


def sized(mesh: tuple[float, float]) -> list[str]:
    """Return the overrides that set the size of cells far from and at the holes [m]."""
    return [f"tissue.mesh.h={mesh[0]}", f"tissue.mesh.h_site={mesh[1]}"]


def measure_pull(case: str, overrides: list[str]) -> AtRest:
    """Draw the thread through skin in load steps."""
    scenario = load(SKIN, ['tissue.element="P1"', *overrides])
    began = process_time()
    made = assemble(scenario)
    organ, run = made.organ, begin(made.system, made.start())
    assert isinstance(organ, tissue.FiniteOrgan)
    start = process_time() - began
    began = process_time()
    for number in range(LOAD_STEPS):
        run = run.load((number + 1) / LOAD_STEPS, scenario.solve.duration)
    return AtRest(case, organ.size, organ.choice.name, LOAD_STEPS, start, process_time() - began)


def measure_step(case: str, overrides: list[str]) -> InTime:
    """Step the main job in tissue that stiffens and in linear tissue, in turn."""
    scenarios = [load(COUPLED, [*FIXED, *overrides, *more]) for more in (STIFFENING, [])]
    made = [assemble(scenario) for scenario in scenarios]
    runs, dt = [begin(each.system, each.start()) for each in made], scenarios[0].solve.dt
    times: list[list[float]] = [[], []]
    corrections: list[list[int]] = [[], []]
    for _ in range(WARM_UP + STEPS):
        for k, run in enumerate(runs):
            began = process_time()
            runs[k] = run.step(dt)
            times[k].append(process_time() - began)
            corrections[k].append(runs[k].iterations)
    step, linear = (median(each[WARM_UP:]) / MILLI for each in times)
    counts = (sum(each[WARM_UP:]) / STEPS for each in corrections)
    return InTime(case, int(made[0].organ.size), step, linear, *counts)


def pull_line(row: AtRest) -> str:
    """Write a row of the table."""
    sizes = f"{row.case:10} {row.tissue_unknowns:9d} {row.solver:>10} {row.load_steps:11d}"
    return f"{sizes} {row.start:10.1f} {row.pull:9.1f}"
