"""`suture bench finite`: times of an organ at finite strain, in statics and in dynamics.

Statics: the scene `skin` on P1 cells, from the mesh's matrices to the last of ten load steps. Dynamics: a step
of the main job in stiffening tissue and in linear tissue, in turn. All times are processor times on one thread,
so other work on the machine has no effect.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from time import process_time

from threadpoolctl import threadpool_limits

import tissue
from coupling.run import begin
from studies.bench.rows import keep, printed
from studies.bench.step import COUPLED, FIXED, MILLI, SCENES, SIZES
from studies.scenario import load
from studies.simulation.assembly import assemble

SKIN = SCENES / "skin.toml"
AT_REST = {"15k": (2.4e-3, 1.0e-3), "37k": (2.2e-3, 0.6e-3)}  # cell size far from and at the holes [m]
LOAD_STEPS = 10
STIFFENING = ['tissue.material="exponential"', "tissue.stiffening=5.0", "tissue.rayleigh=[5.7, 0.0]"]
WARM_UP, STEPS = 10, 25  # in dynamics; only the latter steps are timed


@dataclass(frozen=True)
class AtRest:
    """A static pull in `load_steps`: `start` is the time before the first of them, `pull` their time [s]."""

    case: str
    tissue_unknowns: int
    solver: str
    load_steps: int
    start: float
    pull: float


@dataclass(frozen=True)
class InTime:
    """A step of an organ at finite strain and of a linear one: medians [ms], and their mean numbers of Newton
    corrections."""

    case: str
    tissue_unknowns: int
    step: float
    linear: float
    corrections: float
    linear_corrections: float

    @property
    def times_as_long(self) -> float:
        """Time of the step at finite strain over the linear one."""
        return self.step / self.linear


def main(
    json_path: Path | None = None,
    solver: str = "auto",
    at_rest: Mapping[str, tuple[float, float]] = AT_REST,
    in_time: tuple[float, float] = SIZES["10k"],
) -> int:
    """Measure, print, and add to the JSON file if given; return the exit status."""

    def pulls() -> Iterator[AtRest]:
        for case, mesh in at_rest.items():
            yield measure_pull(case, [*sized(mesh), f'tissue.solver="{solver}"'])

    rows = printed("finite", pulls())
    with threadpool_limits(limits=1, user_api="blas"):
        step = measure_step("10k", [*sized(in_time), f'tissue.solver="{solver}"'])
    print(
        f"\nin time, {step.tissue_unknowns} unknowns: {step.step:.1f} ms a step ({step.corrections:.1f} corrections), "
        f"linear {step.linear:.1f} ms ({step.linear_corrections:.1f}); {step.times_as_long:.1f} times as long"
    )
    in_time_found = asdict(step) | {"times_as_long": step.times_as_long}
    return keep(json_path, {"finite_at_rest": [asdict(row) for row in rows], "finite_in_time": in_time_found})


def sized(mesh: tuple[float, float]) -> list[str]:
    """Return the overrides for the size of cells far from and at the holes [m]."""
    return [f"tissue.mesh.h={mesh[0]}", f"tissue.mesh.h_site={mesh[1]}", "tissue.mesh.accuracy=given"]


def measure_pull(case: str, overrides: list[str]) -> AtRest:
    """Measure a static pull of the thread through skin, in load steps."""
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
    """Measure steps of the main job in stiffening tissue and in linear tissue, in turn."""
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
