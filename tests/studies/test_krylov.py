"""A scenario whose organ is solved in its Krylov space: the whole organ's numbers, what is said, and where it is so."""

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import tissue
from coupling.step import solver
from studies.output.records import StepRecord
from studies.scenario import ScenarioError, load, parse
from studies.simulation import prepare
from studies.simulation.recorded import begin
from studies.simulation.sharing import Shared
from studies.simulation.simulation import Simulation
from tests.bounds import RESIDUAL
from tissue.organs import krylov

COARSE = [
    "thread.control_points=60",
    "tissue.mesh.h_site=2.0e-3",
    "tissue.mesh.h=5.0e-3",
    "tissue.mesh.accuracy=given",
    "solve.duration=0.05",
    "thread.start.ramp=0.02",
]
KRYLOV, WHOLE = 'solve.organ="krylov"', 'solve.organ="whole"'
SOFT = ["tissue.youngs_modulus=1e5", "thread.start.force=[-0.015, 0, 0.01]", "thread.start.ramp=2e-3"]
SHAKEN = ["tissue.youngs_modulus=4e4", "tissue.rayleigh=[0, 0]", "thread.start.force=[-0.015, 0, 0.01]"]
SHAKEN += ["thread.start.ramp=0.002", "solve.dt=2e-4", "solve.duration=6e-3"]
# Scenes, and of some whether the space lasts to their end.
LASTS = {"friction": True, "gravity and a load": True, "shaken, undamped": False}
SCENES = {
    "friction": ["piercing.exit.friction={ static = 0.12, kinetic = 0.1 }"],
    "gravity and a load": [
        "solve.gravity=[0, 0, -9.81]",
        "tissue.load=[{ boundary = 'top', pressure = 200.0, ramp = 0.02 }]",
    ],
    "undamped, backward Euler": ["tissue.rayleigh=[0, 0]", 'solve.integrator="euler"'],
    "soft, steps of a tenth": [*SOFT, "solve.dt=1e-4", "solve.duration=5e-3"],
    "shaken, undamped": SHAKEN,
}


def prepared(*more: str) -> Simulation:
    return prepare(load("two_piercings", [*COARSE, *more]))


def stepped(simulation: Simulation) -> list[StepRecord]:
    return [step for step, _ in simulation.advance()]


def forces(steps: Sequence[StepRecord]) -> np.ndarray:
    """Forces of the holes at every step, `(steps, p, 3)` [N]."""
    return np.array([[hole.force for hole in step.piercings] for step in steps])


@pytest.mark.parametrize("scene", SCENES)
def test_forces_are_those_of_the_whole_organ(scene: str) -> None:
    """Consistency check: at every step within 1e-10 of the largest, in as many steps; the energy audit closes as
    well, and where the motion leaves the space the organ is solved whole from there."""
    small, whole = (stepped(prepared(*SCENES[scene], way)) for way in (KRYLOV, WHOLE))
    largest = np.abs(forces(whole)).max()
    assert len(small) == len(whole)
    assert np.abs(forces(small) - forces(whole)).max() <= RESIDUAL * largest
    for step in small[1:]:
        assert step.krylov is not None
        assert step.krylov.residual <= 2.0 * krylov.ACCURACY  # with what round-off of places may leave
        assert abs(step.energy.balance_error) <= 10.0 * RESIDUAL * small[-1].energy.external_work  # of 30 steps
    assert small[0].krylov is not None and small[0].krylov.vectors > 0
    lasts = small[-1].krylov is not None and small[-1].krylov.vectors > 0
    assert lasts == LASTS.get(scene, lasts)


def test_without_its_check_forces_are_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: with one block whose steps nobody asks what they leave, the same run misses its forces by a
    hundred times what is allowed: it is the check that makes them those of the whole organ."""
    monkeypatch.setattr(krylov, "START", 1)
    whole, asked = (stepped(prepared(way)) for way in (WHOLE, KRYLOV))
    monkeypatch.setattr(solver, "Certified", type(None))
    unasked = stepped(prepared(KRYLOV))
    largest = np.abs(forces(whole)).max()
    assert np.abs(forces(asked) - forces(whole)).max() <= RESIDUAL * largest
    assert np.abs(forces(unasked) - forces(whole)).max() >= 100 * RESIDUAL * largest


@pytest.mark.parametrize(("scene", "at", "vectors"), [("friction", 20, None), ("shaken, undamped", 12, 0)])
def test_a_run_goes_on_from_a_checkpoint_to_the_same_bits(scene: str, at: int, vectors: int | None) -> None:
    """Consistency check: in a space that was widened, and once the organ is solved whole; the run that goes on is of a
    longer duration than the one that left the checkpoint."""
    keys = [*SCENES[scene], KRYLOV]
    whole = stepped(prepared(*keys))
    short = prepare(load("two_piercings", [*COARSE, *keys, f"solve.duration={at * (2e-4 if vectors == 0 else 1e-3)}"]))
    left = stepped(short)[-1]
    assert left.krylov is not None and left.memory is not None
    assert left.krylov.vectors == 0 if vectors == 0 else left.krylov.vectors > 90
    *_, (last, _) = prepared(*keys).advance(left.memory)
    assert last.memory is not None and whole[-1].memory is not None
    assert last.memory.keys() == whole[-1].memory.keys()
    for name, value in last.memory.items():
        assert np.array_equal(value, whole[-1].memory[name]), name


# Stiff thread through four holes close together, that both ends pull at from the first moment.
SUDDEN = """
[tissue]
youngs_modulus = 316994
poisson_ratio = 0.3
density = 1070.0
clamp = ["left", "right"]
mesh = { kind = "block", generator = "structured", size = [0.0438592, 0.022, 0.014], h = 5e-3, h_site = 0.00194 }
[thread]
suture = "6-0 polyester"
control_points = 61
damping = 50
path = [
    [-0.0206497, -0.000273262, 0.0140711], [-0.0152782, -0.000273262, 0.00455906],
    [-0.00845044, -0.000273262, -0.00153423], [-0.00232148, 0.000543145, -0.00199162],
    [0.00228079, 0.000543145, 0.00591824], [-0.000105778, -0.000542082, 0.00472471],
    [0.00651778, -0.000542082, -0.00158997], [0.00886136, -0.000135247, -0.0018968],
    [0.0140572, -0.000135247, 0.00563648], [0.0170974, 0.00977302, 0.0104288], [0.0201376, 0.00369201, 0.0152211],
]
start = { kind = "pulled", force = [-0.491718, 0, 0.870754], ramp = 0 }
end = { kind = "pulled", force = [0.507614, 0.31951, 0.800151], ramp = 0 }
[[piercing]]
name = "first"
at = [-0.0101696, -0.000273262, 0]
direction = "free"
footprint = 0.00194
[[piercing]]
name = "second"
at = [-0.00116267, 0.000543145, 0]
direction = [0.502907, 0, 0.86434]
footprint = 0.00194
[[piercing]]
name = "third"
at = [0.00485003, -0.000542082, 0]
direction = [0.723781, 0, -0.69003]
footprint = 0.00194
[[piercing]]
name = "fourth"
at = [0.0101696, -0.000135247, 0]
direction = [0.567765, 0, 0.82319]
footprint = 0.00194
[solve]
dt = 5e-4
duration = 5e-4
newton = "numpy"
"""


def test_a_step_without_a_solution_in_the_space_is_asked_of_the_whole_organ() -> None:
    """Consistency check: a sudden load whose first step goes downhill. In the space the way would lead to another
    equilibrium."""
    ends = []
    for way in ("whole", "krylov"):
        tables = tomllib.loads(SUDDEN)
        tables["solve"]["organ"] = way
        tables["thread"]["knots"] = "fixed"
        simulation = prepare(parse(tables))
        ends.append(simulation.next(simulation.beginning()))
    whole, small = ends
    assert [step.dt for step in small.taken] == [step.dt for step in whole.taken]
    assert np.array_equal(small.state.s, whole.state.s)  # from the same start, by the same answer


def test_a_step_that_leaves_the_space_starts_where_that_of_the_whole_organ_does() -> None:
    """Consistency check: a sudden load in a short step, which no space follows: the first step is that of the whole
    organ to the bits, from the same start by the same answer."""
    sudden = [*SHAKEN, "thread.start.ramp=0", "solve.dt=1e-4", 'solve.newton="numpy"']
    ends = []
    for way in (WHOLE, KRYLOV):
        simulation = prepared(*sudden, way)
        ends.append(simulation.next(simulation.beginning()))
    organ = ends[1].system.organ
    assert isinstance(organ, tissue.KrylovOrgan) and organ.vectors(ends[1].state.organ) == 0
    assert np.array_equal(ends[0].state.q, ends[1].state.q)


def test_holes_that_begin_later_and_a_cut() -> None:
    """Consistency check: a hole that begins strikes the tissue, which is solved whole from there; a thread that is cut
    leaves the space as it is, or asks for more of it; forces are the whole organ's."""
    later = ['thread.knots="fixed"', "piercing.exit.from=0.01", "cut=[{ s = 0.05, time = 0.03 }]"]
    small, whole = (stepped(prepared(*later, way)) for way in (KRYLOV, WHOLE))
    known = ~np.isnan(forces(whole))
    assert np.array_equal(known, ~np.isnan(forces(small)))
    off = np.abs(forces(small) - forces(whole))[known]
    assert off.max() <= RESIDUAL * np.abs(forces(whole)[known]).max()
    assert {event.kind for step in small for event in step.events} >= {"begins", "cut"}


def test_the_summary_says_how_the_organ_was_solved() -> None:
    """Independent check: the vectors of the end, and the largest residual of the run; nothing where there is no
    space."""
    said = {}
    for way in (KRYLOV, WHOLE):
        simulation = prepared("solve.duration=0.02", way)
        tally = simulation.tally()
        for step, _ in simulation.advance():
            tally.count(step)
            tally.last_step = step
        said[way] = tally.summary("completed"), simulation.methods["organ"]
    summary, method = said[KRYLOV]
    assert method == "krylov" and summary["krylov"]["vectors"] >= 90
    assert 0.0 < summary["krylov"]["residual"] <= 2.0 * krylov.ACCURACY
    assert said[WHOLE][1] == "whole" and "krylov" not in said[WHOLE][0]


def recorded(folder: Path, *more: str, resume: bool = False) -> tuple[list[StepRecord], str]:
    """Record a run that leaves its space when a hole begins; return the steps that were made, and the organ's method
    as the folder has it."""
    folder.mkdir(exist_ok=True)
    begun = begin(
        prepared(KRYLOV, "piercing.exit.from=9e-3", "output.every=4", "solve.duration=0.016", *more), folder, resume
    )
    assert begun is not None
    steps = []
    with begun[0] as recorder:
        for step, frame in begun[1]:
            recorder.record(step, frame)
            steps.append(step)
    said = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["provenance"]
    assert said == json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    return steps, said["methods"]["organ"]


def test_the_methods_say_from_which_step_on_the_organ_was_solved_whole(tmp_path: Path) -> None:
    """Independent check: the first step without vectors; none of a run that ends before it, and the same one of a run
    that is gone on with from a checkpoint before it or after it."""
    steps, said = recorded(tmp_path / "once")
    first = next(step.step for step in steps if step.krylov is not None and not step.krylov.vectors)
    assert said == f"krylov, whole from step {first}"
    for name, last, before in (("early", first - 2, "krylov"), ("late", first + 4, said)):
        assert recorded(tmp_path / name, f"solve.duration={last * 1e-3}")[1] == before
        again, now = recorded(tmp_path / name, resume=True)
        assert now == said and again[0].step == last - last % 4


FINE = ["tissue.mesh.h_site=1.5e-3", "tissue.mesh.h=3.0e-3", "tissue.mesh.accuracy=given"]
AUTO = {
    "where it pays": (FINE, tissue.KrylovOrgan),
    "whatever the duration": ([*FINE, "solve.duration=2e-3"], tissue.KrylovOrgan),
    "a small organ": ([], tissue.DynamicOrgan),
    "asked for": ([KRYLOV], tissue.KrylovOrgan),
    "not wanted": ([*FINE, WHOLE], tissue.DynamicOrgan),
    "a hole that begins later": ([*FINE, "piercing.exit.from=0.01"], tissue.DynamicOrgan),
    "no inertia": ([*FINE, "tissue.inertia=false"], tissue.QuasiStaticOrgan),
    "the paper's variant": ([*FINE, 'solve.coupling="staggered"'], tissue.DynamicOrgan),
    "no factor": ([*FINE, 'tissue.solver="multigrid"'], tissue.DynamicOrgan),
    "nothing that holds it": ([*FINE, "tissue.clamp=[]"], tissue.DynamicOrgan),
}


@pytest.mark.parametrize("case", AUTO)
def test_where_an_organ_is_solved_in_its_space(case: str) -> None:
    """Independent check: by its unknowns, its holes and what is done to it, not by how long the run is."""
    keys, kind = AUTO[case]
    assert type(prepared(*keys).assembly.organ) is kind


def test_the_memory_of_a_machine_does_not_choose(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: where there is no memory for the space, a scenario whose organ is solved there on another
    machine is refused, with the key that solves it whole: it would neither have the same numbers nor go on from a
    checkpoint."""
    monkeypatch.setattr("tissue.organs.krylov.free_memory", lambda: 1e5)
    with pytest.raises(tissue.TissueError, match=r'GB are available; .* or set solve\.organ = "whole"'):
        prepared(*FINE)
    assert isinstance(prepared(*FINE, WHOLE).assembly.organ, tissue.DynamicOrgan)


def test_a_checkpoint_of_an_organ_solved_otherwise_is_refused() -> None:
    """Independent check: what is kept of an organ in its Krylov space is no state of the whole one, which a machine
    with less memory may take; that is said in words."""
    kept = stepped(prepared(KRYLOV, "solve.duration=2e-3"))[-1].memory
    with pytest.raises(ScenarioError, match=r"it was solved in its Krylov space, but .* continue where the run began"):
        next(iter(prepared(WHOLE).advance(kept)))


def test_an_organ_is_shared_by_what_is_solved_alike() -> None:
    """Consistency check: cases that differ in duration share organ and space, one that is staggered does not."""
    store = Shared()
    one, longer, staggered = (
        prepare(load("two_piercings", [*COARSE, *FINE, *more]), store).assembly.organ
        for more in ([], ["solve.duration=0.1"], ['solve.coupling="staggered"'])
    )
    assert one is longer and isinstance(one, tissue.KrylovOrgan) and isinstance(staggered, tissue.DynamicOrgan)


REFUSED = {
    "static": ['solve.kind="static"'],
    "quasi-static": ["tissue.inertia=false"],
    "finite strain": ['tissue.material="neo-hookean"', "tissue.rayleigh=[1, 0]"],
    "contact": ['contact=[{ between = ["left", "right"] }]'],
    "the paper's variant": ['solve.coupling="staggered"'],
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_space_is_refused(case: str) -> None:
    """Independent check: by its key, before anything is made."""
    with pytest.raises(ScenarioError, match=r"solve\.organ = .krylov. is refused.*(leave|add)"):
        load("two_piercings", [KRYLOV, *REFUSED[case]])
