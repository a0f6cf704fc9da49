"""The iteration compiled and in Python on the same kernels: the same answer after as many corrections."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coupling.calls import asked_before_corrections
from coupling.errors import StepError
from coupling.integrators import BackwardEuler
from coupling.kernels import iteration
from coupling.kernels.bordered import PHI
from coupling.step import newton, solver, tables
from coupling.step.descent import descend
from coupling.step.newton import Iterate, Problem, Solution
from coupling.step.stepping import dynamic_problem, organ_answer, predict
from coupling.step.tables import tables_of
from studies.scenario import Scenario, load
from studies.simulation import prepare
from tests.bounds import AXIAL, RESIDUAL
from thread.ends import Free

ROUGH = "friction={static=0.2,kinetic=0.1,grip=0.002}"
WAY = [[-0.005, 0, 0.02], [-0.005, 0, -0.0055], [0.005, 0, -0.0055], [0.005, 0, 0.02]]
DRAWN: dict[str, Any] = {
    "thread": {
        "suture": "2-0 polypropylene",
        "control_points": 40,
        "path": WAY,
        "damping": 20.0,
        "start": {"kind": "pulled", "force": [0.0, 0.0, 0.05], "ramp": 0.01},
        "end": {"kind": "driven", "waypoints": [[0.0, 0.005, 0, 0.02], [0.05, 0.005, 0, 0.0225]]},
    },
    "piercing": [
        {"name": "entry", "at": [-0.005, 0, 0], "direction": [0, 0, -1], "friction": {"static": 0.2, "kinetic": 0.1}},
        {"name": "exit", "at": [0.005, 0, 0], "direction": [0, 0, 1], "friction": {"static": 0.2, "kinetic": 0.1}},
    ],
    "solve": {"dt": 2.5e-3, "duration": 0.05},
}


def drawn(piercing: dict[str, Any] | None = None, **thread: Any) -> Scenario:
    """A thread drawn over two points in space, with other keys of the thread and of both piercings."""
    table = deepcopy(DRAWN)
    table["thread"].update(thread)
    for hole in table["piercing"]:
        hole.update(piercing or {})
    return Scenario.model_validate(table)


def pulled_through() -> Scenario:
    """A hand pulls the thread through one hole, the other is a fixed point of it; one end is clamped, one fixed."""
    scene = deepcopy(DRAWN)
    scene["thread"] |= {
        "knots": "fixed",
        "start": {"kind": "clamped"},
        "end": {"kind": "pulled", "force": [0, 0, 0.02], "ramp": 0.01},
    }
    scene["piercing"] = [
        {"name": "entry", "at": [-0.005, 0, 0], "direction": [0, 0, -1]},
        {"name": "exit", "at": [0.005, 0, 0], "direction": "free", "kind": "anchored", "pull": [[0, 0], [0.05, 0.1]]},
    ]
    return Scenario.model_validate(scene)


AT_REST = ["solve.kind=static"]
PULLED = [
    "solve.load_steps=1",
    "thread.start.force=[-0.125, 0, 0.083]",
    "thread.start.ramp=0",
    'thread.end={ kind = "pulled", force = [0.125, 0, 0.083] }',
]
SCENES = {
    "figure 1": (lambda: load("paper_figure_1", [f"piercing.{hole}.{ROUGH}" for hole in ("entry", "exit")]), 10),
    "organ": (
        lambda: load("two_piercings", ["tissue.mesh.h=8e-3", "tissue.mesh.accuracy=given", "tissue.mesh.h_site=4e-3"]),
        8,
    ),
    "rough holes": (lambda: drawn({"channel": 5e-3}), 8),
    "rings": (lambda: drawn({"direction": "free"}, knots="fixed"), 6),
    "taut on long spans": (lambda: drawn(suture="8-0 nylon"), 6),
    "limp": (lambda: drawn({"friction": None}, bending=False, control_points=60), 4),
    "pulled": (pulled_through, 8),
    "stitch": (lambda: load("running_stitch", ["tissue.mesh.h=8e-3", "tissue.mesh.accuracy=given"]), 3),
    "rings at rest": (lambda: load("paper_figure_1", [*AT_REST, "solve.load_steps=2"]), 2),
    "organ at rest": (
        lambda: load("two_piercings", [*AT_REST, *PULLED, "tissue.mesh.h=8e-3", "tissue.mesh.accuracy=given"]),
        1,
    ),
    "friction at rest": (lambda: load("paper_figure_1", [*AT_REST, f"piercing.exit.{ROUGH}", "solve.load_steps=1"]), 1),
}
NEAR = 1e-4  # of the unknowns: where residuals are compared
LONG = 20  # corrections, over which a difference in the last bit may change how many there are


@dataclass(frozen=True)
class Asked:
    """What is asked of the solver, and what numpy answers."""

    problem: Problem
    start: Iterate
    found: Solution


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Asked]]:
    """All that is asked of the solver, in its order."""
    asked: list[Asked] = []

    def solve_once(problem: Problem, start: Iterate, downhill: int) -> Solution:
        if downhill:
            return descend(problem, start)
        found = newton.solve(problem, start)
        asked.append(Asked(problem, start, found))
        return found

    monkeypatch.setattr(solver, "solve_once", solve_once)
    yield asked


def off_by_round_off(problem: Problem, solution: Solution) -> bool:
    """Whether a solution misses the tolerance of forces by less than the round-off of forces that cancel, which is
    another one in loops: a laid thread has 1e12 times the stiffness of its bed."""
    free = np.abs(solution.residual.thread)
    free.ravel()[problem.system.held] = 0.0
    limit = newton.force_tolerance(problem, solution.residual) + newton.rounded_force(problem)
    return bool(free[:, :3].max() <= limit and np.abs(solution.residual.holds[:, PHI]).max() <= RESIDUAL)


@pytest.mark.parametrize("name", SCENES)
def test_both_ways_agree(name: str, solved: list[Asked]) -> None:
    """Consistency check: as many corrections in all, but for one; and of them all unknowns, constraint forces and
    residuals, each relative to its own scale."""
    scene, steps = SCENES[name]
    ready = prepare(scene())
    now = ready.beginning()
    for _ in range(steps):
        now = ready.next(now)
    assert len(solved) >= steps
    more: list[int] = []
    for asked in solved:
        problem, by_numpy = asked.problem, asked.found
        assert solver.is_covered(problem)
        by_loops = solver.solve_compiled(problem, asked.start)
        if by_numpy.iterations <= LONG:
            more.append(abs(by_loops.iterations - by_numpy.iterations))
        for unknown, scale in scales(problem, by_numpy).items():
            one, other = getattr(by_loops.iterate, unknown), getattr(by_numpy.iterate, unknown)
            rounded = newton.rounded_force(problem) if unknown in {"N", "lam"} else 0.0
            assert np.abs(one - other).max(initial=0.0) <= RESIDUAL * scale + rounded, unknown
        assert np.array_equal(by_loops.iterate.sigma, by_numpy.iterate.sigma)
        assert newton.is_converged(problem, by_loops.iterate, by_loops.residual) or off_by_round_off(problem, by_loops)
        agree_on_residuals(problem, by_loops)
        newton.direction(problem, by_loops.iterate, by_loops.residual)  # not singular: an equilibrium is corrected
    assert sum(more) <= 1  # a residual at its tolerance takes one more in one of both


def test_what_is_known_of_a_thread_stays_known_when_a_hand_takes_an_end() -> None:
    """Independent check: a system with another end, as a host program makes in every step, has the same tables; one
    with another thread its own."""
    system = prepare(drawn()).assembly.system
    led = replace(system, ends=(Free(), Free()))
    assert tables_of(led.thread) is tables_of(system.thread)
    assert tables_of(replace(system.thread, damping=1.0)) is not tables_of(system.thread)


def scales(problem: Problem, solution: Solution) -> dict[str, float]:
    """Return the scale of each unknown: the thread's length, its axial stiffness by what is known of a strain, the
    largest force."""
    thread, force = problem.system.thread, solution.residual.force_scale
    stiff = AXIAL / RESIDUAL * thread.EA + force
    return {"q": thread.spline.end, "s": thread.spline.end, "y": 1.0, "N": stiff, "lam": stiff}


def agree_on_residuals(problem: Problem, solution: Solution) -> None:
    """Assert that residuals of the loops, their thread at the holes and its dependence on them are those of numpy.

    They are compared near the solution, where no residual is zero, without a correction.
    """
    z = solution.iterate
    z = replace(z, q=(1.0 + NEAR) * z.q, lam=(1.0 + NEAR) * z.lam, y=(1.0 - NEAR) * z.y)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(newton, "MAX_ITERATIONS", 0)
        ended = tables.run(problem, z)
    assert (ended.how, ended.corrections) == (iteration.NOT_CONVERGED, 0)
    exact, found = newton.evaluate(problem, z), ended.found
    rounded, at = newton.rounded_force(problem), exact.passage
    for name, of_loops, of_numpy in (
        ("f_y", found.f_y, exact.f_y), ("push", found.push, exact.push), ("balance", found.balance, exact.thread),
        ("holds", found.holds, exact.holds),
    ):  # fmt: skip
        scale = max(np.abs(of_numpy).max(initial=0.0), exact.force_scale)
        assert np.abs(of_loops - of_numpy).max(initial=0.0) <= RESIDUAL * scale + rounded, name
    assert np.abs(found.site - exact.site).max() <= RESIDUAL * np.abs(z.y).max()
    assert np.array_equal(found.passing.first, at.first)
    pairs = [(found.passing.b, at.b), (found.passing.D, at.D)]
    for got, want in pairs:
        largest = np.abs(want).max(axis=(0, 2), initial=0.0)  # of each derivative
        assert (np.abs(got - want).max(axis=(0, 2), initial=0.0) <= RESIDUAL * largest).all()
    assert np.abs(found.stretched.strain - exact.points.strain).max() <= RESIDUAL
    if at.ridden is not None:
        for name in ("by_s", "by_ss", "by_qs", "mass"):
            got, want = getattr(found.ridden, name), getattr(at.ridden, name)
            assert np.abs(got - want).max() <= RESIDUAL * np.abs(want).max() + (rounded if name == "by_s" else 0.0), (
                name
            )


@pytest.mark.parametrize("corrections", [0, 1, 7])
def test_corrections_of_the_loops_count_in_a_load_step(corrections: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: what bounds a load step is put before a solve by the loops as often as they correct, and
    once at least; of one that fails too."""
    problem, start = first_problem()
    found: Any = SimpleNamespace(holds=np.ones((2, 6)), balance=np.zeros((4, 3)))
    ended = tables.Ended(iteration.NOT_CONVERGED, corrections, start, found)
    monkeypatch.setattr(tables, "run", lambda *given: ended)
    asked: list[int] = []
    with asked_before_corrections(lambda: asked.append(1)), pytest.raises(StepError, match="no convergence"):
        solver.solve(problem, start)
    assert len(asked) == max(corrections, 1)


def first_problem(**thread: Any) -> tuple[Problem, Iterate]:
    """The first step of the thread through two smooth holes, and an iterate that is a millimetre off at the second."""
    assembly = prepare(drawn({"friction": None}, **({"knots": "fixed"} | thread))).assembly
    system, state, dt = assembly.system, assembly.start(), DRAWN["solve"]["dt"]
    problem = dynamic_problem(system, state, dt, organ_answer(system, BackwardEuler(dt), state))
    start = predict(problem, state)
    return problem, replace(start, s=start.s + np.array([0.0, 1e-3]))


def with_friction(problem: Problem) -> Problem:
    """The holes have friction, and hold the thread until they are asked."""
    rough = np.ones_like(problem.law.rough)
    return replace(problem, law=problem.law._replace(rough=rough, static=np.full(2, 1e-6), kinetic=np.full(2, 1e-6)))


FAILURES: dict[str, tuple[dict[str, Any], Any, str, dict[str, Any]]] = {
    "too many corrections": ({"MAX_ITERATIONS": 2}, lambda problem: problem, "no convergence in 2 Newton", {}),
    "too many sets": ({"MAX_SETS": 1}, with_friction, "stick and slip", {}),
    "no number": ({}, lambda problem: replace(problem, load=np.full_like(problem.load, np.nan)), "not finite", {}),
    "free of its holes": (  # whose abscissae then have no equation; on knots that travel they have the thread's own
        {},
        lambda problem: replace(problem, rows=np.zeros_like(problem.rows)),
        "holds' matrix",
        {"knots": "fixed"},
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_both_ways_fail_alike(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: where there is no solution, loops say why, name the same hole and count as many corrections,
    and numpy does not iterate once more to say it."""
    limits, spoiled, cause, thread = FAILURES[name]
    problem, start = first_problem(**thread)
    for limit, value in limits.items():
        monkeypatch.setattr(newton, limit, value)
    problem, said = spoiled(problem), []
    asked: list[int] = []
    for compiled in (False, True):
        asked.clear()
        of_kind = replace(problem, system=replace(problem.system, compiled=compiled))
        if compiled:
            monkeypatch.setattr(newton, "solve", None)
        with asked_before_corrections(lambda: asked.append(1)), pytest.raises(StepError, match=cause) as raised:
            solver.solve(of_kind, start)
        worst = "" if "MAX_SETS" in limits else raised.value.piercing  # of a set that is solved, round-off names one
        said.append((raised.value.cause, worst, max(len(asked), 1)))
    assert said[0] == said[1]


@pytest.mark.parametrize(("ready", "known"), [(False, []), (False, ["one"]), (True, [])])
def test_that_the_step_is_compiled_is_said_and_that_it_is_done(
    ready: bool, known: list[str], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Independent check: loops that are neither on disk nor in memory yet are told of before and after, no others."""
    solved: list[int] = []

    def solve(number: int) -> None:
        solved.append(number)

    monkeypatch.setattr(solve, "signatures", known, raising=False)
    monkeypatch.setattr(tables.iteration, "solve", solve)
    monkeypatch.setattr(tables, "is_ready", lambda: ready)
    with caplog.at_level("INFO", logger="coupling.step.tables"):
        tables.run_loops(3)
    assert solved == [3]
    told = [(record.getMessage().partition(" (")[0], hasattr(record, "over")) for record in caplog.records]
    new = [("compiling the step", False), ("compiled the step in 0 s", True)]
    assert told == ([] if ready or known else new)
