"""`suture bench step`: times of a step in shipped scenes, with the default integrator.

Each scene is run from start to end. For each scene there are three times. The first is a single
step, as a host program calls it (`coupling.run.run.Run.steps`), over whole runs of at most MOST
steps. The second is a step of the whole run in one call, and the third a step of a recorded run.
Only the last one computes the times of events. With an organ, the floor is also given: one
back-substitution by the factor of the meshed organ. All times are processor times on one thread.
Loops are loaded or compiled before; `suture bench many` measures their compilation.
"""

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from time import process_time

import numpy as np

import tissue
from coupling.integrators import BDF2
from studies.arrays import MILLI
from studies.bench.rows import EVERY_CASE, Numbers, keep, printed, steps_in_turn, time_call
from studies.scenario import Scenario, load
from studies.simulation import prepare

SCENES = Path(__file__).parents[1] / "scenario" / "scenes"
COUPLED = SCENES / "two_piercings.toml"
SIZES = {"4k": (6.0e-3, 2.5e-3), "10k": (4.0e-3, 1.2e-3), "43k": (2.0e-3, 0.7e-3)}  # far from and at the holes [m]
FIXED = EVERY_CASE["fixed"]
COMPILED = 'solve.newton="compiled"'
CASES = EVERY_CASE["step"]
MOST = 10_000  # steps
LONGEST = 60.0  # s of the processor, after which no new run of a scene is started
LATE = 99.9  # per cent of the steps
WARM_UP = 3  # number of steps that load the loops
REPEATED = 3  # number of whole runs, and of back-substitutions


def sized(mesh: tuple[float, float]) -> list[str]:
    """Return the overrides for the size of cells far from and at the holes [m]."""
    return [f"tissue.mesh.h={mesh[0]}", f"tissue.mesh.h_site={mesh[1]}", "tissue.mesh.accuracy=given"]


def main(json_path: Path | None = None, solver: str = "auto") -> int:
    """Measure every case and print the table; return the exit status.

    The numbers are written as JSON if a file is given.
    """
    return keep(json_path, {"milliseconds_per_step": printed("step", measurements(solver))})


def measurements(solver: str) -> Iterator[Numbers]:
    """Yield the measurements of every case with a solver of the organ."""
    for case, (scene, overrides) in CASES.items():
        own = [f'tissue.solver="{solver}"'] if scene == COUPLED.stem else []
        yield measure_case(case, load(scene, [*overrides, *own, COMPILED]))


def measure_case(case: str, scenario: Scenario) -> Numbers:
    """Return the numbers of one case, with times in milliseconds; single steps are measured first.

    `median`, `late` (99.9 % are below) and `worst` are of single steps, over `steps` steps.
    `at_once` is a step of all in one call, `recorded` a step of a recorded run. `floor` is a
    back-substitution, None without an organ's factor.
    """
    ready, dt = prepare(scenario), scenario.solve.dt
    ready.beginning().steps(dt, WARM_UP)
    alone, iterations, began = list[float](), 0, process_time()
    while not alone or (len(alone) + ready.steps <= MOST and process_time() - began < LONGEST):
        for [run], times in steps_in_turn([ready.beginning()], lambda run: run.steps(dt, 1), ready.steps):
            alone += times
            iterations += run.iterations
    begun = ready.beginning()
    at_once = [time_call(lambda: begun.steps(dt, ready.steps)) for _ in range(REPEATED)]
    recorded = [time_call(lambda: deque(ready.advance(), maxlen=0)) for _ in range(REPEATED)]
    middle, late = np.percentile(alone, [50.0, LATE]).tolist()
    count = len(alone)
    found = {"case": case, "tissue_unknowns": ready.assembly.organ.size, "steps": count}
    found |= {"newton_iterations": iterations / count, "median": middle / MILLI}
    found |= {"late": late / MILLI, "worst": max(alone) / MILLI}
    found |= {"at_once": median(at_once) / ready.steps / MILLI}
    found |= {"recorded": median(recorded) / ready.steps / MILLI}
    return found | {"floor": floor_of(ready.assembly.organ, BDF2(dt, dt))}


def floor_of(organ: object, scheme: BDF2) -> float | None:
    """Return the time of one back-substitution of an organ with the factor of a scheme [ms].

    None if the organ has no factor.
    """
    full = organ.full if isinstance(organ, tissue.KrylovOrgan) else organ
    if not isinstance(full, tissue.DynamicOrgan | tissue.QuasiStaticOrgan):
        return None
    factor, right = full.operator(scheme.a, scheme.d).factor, np.random.default_rng(0).standard_normal(full.size)
    return median(time_call(lambda: factor.solve(right)) for _ in range(REPEATED)) / MILLI
