"""`suture bench finite`: times of an organ at finite strain, in statics and in dynamics.

Statics: the scene `skin` on P1 cells, from the mesh's matrices to the last of ten load steps.
Dynamics: a step of the main job in stiffening tissue and in linear tissue, in turn. All times are
processor times on one thread, so other work on the machine has no effect.
"""

from collections.abc import Mapping
from pathlib import Path
from statistics import median
from time import process_time

from threadpoolctl import threadpool_limits

import tissue
from coupling.run import begin
from studies.arrays import MILLI
from studies.bench.rows import EVERY_CASE, Numbers, keep, printed, steps_in_turn
from studies.bench.step import COUPLED, FIXED, SCENES, SIZES, sized
from studies.scenario import load
from studies.simulation.assembly import assemble

SKIN = SCENES / "skin.toml"
AT_REST = {"15k": (2.4e-3, 1.0e-3), "37k": (2.2e-3, 0.6e-3)}  # cell size far from and at the holes [m]
LOAD_STEPS = 10
STIFFENING = ['tissue.material="exponential"', "tissue.stiffening=5.0", "tissue.rayleigh=[5.7, 0.0]"]
WARM_UP, STEPS = 10, 25  # in dynamics; only the latter steps are timed


def main(
    json_path: Path | None = None,
    solver: str = "auto",
    at_rest: Mapping[str, tuple[float, float]] = AT_REST,
    in_time: tuple[float, float] = SIZES["10k"],
) -> int:
    """Measure, print, and add to the JSON file if given; return the exit status."""
    choice = f'tissue.solver="{solver}"'
    pulls = (measure_pull(case, [*sized(mesh), choice]) for case, mesh in at_rest.items())
    rows = printed("finite", pulls)
    with threadpool_limits(limits=1, user_api="blas"):
        step = measure_step("10k", [*sized(in_time), choice])
    print(EVERY_CASE["in_time"].format(**step))
    return keep(json_path, {"finite_at_rest": rows, "finite_in_time": step})


def measure_pull(case: str, overrides: list[str]) -> Numbers:
    """Return the numbers of a static pull of the thread through skin, in load steps.

    `start` is the time before the first load step, `pull` the time of all load steps [s].
    """
    scenario = load(SKIN, ['tissue.element="P1"', *overrides])
    began = process_time()
    assembly = assemble(scenario)
    organ, run = assembly.organ, begin(assembly.system, assembly.start())
    assert isinstance(organ, tissue.FiniteOrgan)
    start = process_time() - began
    began = process_time()
    for number in range(LOAD_STEPS):
        run = run.load((number + 1) / LOAD_STEPS, scenario.solve.duration)
    found = {"case": case, "tissue_unknowns": organ.size, "solver": organ.choice.name}
    return found | {"load_steps": LOAD_STEPS, "start": start, "pull": process_time() - began}


def measure_step(case: str, overrides: list[str]) -> Numbers:
    """Return the numbers of a step of the main job in stiffening and in linear tissue, in turn.

    They are the median times of a step [ms], their ratio, and the mean numbers of Newton
    corrections.
    """
    scenarios = [load(COUPLED, [*FIXED, *overrides, *more]) for more in (STIFFENING, [])]
    assemblies = [assemble(scenario) for scenario in scenarios]
    runs, dt = [begin(each.system, each.start()) for each in assemblies], scenarios[0].solve.dt
    taken = list(steps_in_turn(runs, lambda run: run.step(dt), WARM_UP + STEPS))[WARM_UP:]
    step, linear = (median(times[k] for _, times in taken) / MILLI for k in (0, 1))
    counts = [sum(made[k].iterations for made, _ in taken) / STEPS for k in (0, 1)]
    found = {"case": case, "tissue_unknowns": int(assemblies[0].organ.size)}
    found |= {"step": step, "linear": linear}
    found |= dict(zip(("corrections", "linear_corrections"), counts, strict=True))
    return found | {"times_as_long": step / linear}
