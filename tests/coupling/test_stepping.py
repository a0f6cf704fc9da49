"""What a step does when it fails, a thread that leaves its holes, a taut thread, and statics as the end of dynamics."""

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import coupling.step.newton
import coupling.step.solver
import tissue
from coupling.errors import CouplingError, InversionError, StepError
from coupling.kernels.constraints import phi
from coupling.reports.audit import audit_step, initial_energies
from coupling.reports.observation import observe
from coupling.step.stepping import HALVINGS, advance, try_step, with_sense
from coupling.system import Friction, Piercing, State, System
from tests.bounds import GAP, IDENTITY, TWO_SOLVERS
from tests.thread.threads import (
    ABSCISSAE,
    FREE,
    LENGTH,
    ORIGIN,
    RADIUS,
    X,
    Z,
    block_organ,
    hairpin,
    hairpin_sites,
    hairpin_system,
    laid,
    load_step,
    run,
)
from thread.ends import Driven, Fixed, Free, Pulled
from thread.errors import ThreadError

PATH = hairpin(RADIUS, LENGTH)
START, END = PATH(np.array([0.0, LENGTH]))


def scene(ends: Any, organ: Any = None, n: int = 40, **options: Any) -> tuple[System, State]:
    """The hairpin at rest, fixed in space unless there is an organ."""
    system = hairpin_system(organ or hairpin_sites(), ends, n, **options)
    return system, laid(system, ABSCISSAE, PATH)


def pulled_up(way: float, speed: float = 0.02) -> Driven:
    """The end driven up by `way` at `speed`."""
    return Driven(np.array([[0.0, *END], [way / speed, *(END + way * Z)]]))


def arrays(state: State) -> list[np.ndarray]:
    return [x.copy() for x in vars(state).values() if isinstance(x, np.ndarray)]


# -- failure ---------------------------------------------------------------------------------------------------------


def test_a_step_that_cannot_converge_raises_and_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: one Newton iteration is not enough for any step, so 2⁻⁸ of the step fails as well; the error
    tells time and step, and the state is what it was."""
    system, state = scene((Fixed(START), pulled_up(5e-3)))
    before = arrays(state)
    monkeypatch.setattr(coupling.step.newton, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(coupling.step.solver, "PATIENCE", 1)
    with pytest.raises(StepError) as caught:
        advance(system, state, 2e-3)
    error = caught.value
    assert (error.time, error.dt) == (0.0, 2e-3 / 2**HALVINGS)
    assert "t = 0 s" in str(error)
    assert all(np.array_equal(a, b) for a, b in zip(before, arrays(state), strict=True))
    monkeypatch.undo()
    assert advance(system, state, 2e-3)[-1].new.time == 2e-3


def test_a_thrown_thread_takes_half_steps_and_few_ways_downhill(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check (Newton's second law): a thread that a dead load F draws out of its holes gains the momentum
    F Δt in each step. There were 14 ways downhill when each step that failed tried one before it was halved."""
    pull, dt, ways = np.array([0.3, 0.0, 0.4]), 1e-3, []
    descend = coupling.step.solver.descend
    monkeypatch.setattr(coupling.step.solver, "descend", lambda *args: ways.append(1) or descend(*args))
    system, state = scene((Free(), Pulled(pull)), compiled=True)
    momenta = []
    for _ in range(4):
        state = advance(system, state, dt)[-1].new
        momenta.append(system.thread.momentum(state.v)[:, :3].sum(axis=0))
    assert not state.present.any()
    assert np.abs(np.diff(momenta, axis=0)[-2:] - pull * dt).max() <= TWO_SOLVERS * np.linalg.norm(pull) * dt
    assert len(ways) <= 7


def test_a_step_error_names_the_piercing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: the worst constraint of a step that failed is told."""
    system, state = scene((Fixed(START), pulled_up(5e-3)))
    monkeypatch.setattr(coupling.step.newton, "MAX_ITERATIONS", 1)
    monkeypatch.setattr(coupling.step.solver, "PATIENCE", 1)
    with pytest.raises(StepError) as caught:
        advance(system, state, 2e-3)
    assert caught.value.piercing in ("entry", "exit")
    assert caught.value.piercing in str(caught.value)


@pytest.mark.parametrize("load", [np.nan, np.inf])
def test_a_load_that_is_no_number_is_a_step_error(load: float) -> None:
    """Independent check: what runs away is caught, not handed on as a state; the end itself refuses such a load."""
    with pytest.raises(ThreadError, match="finite"):
        Pulled(np.array([load, 0.0, 0.0]))
    system, state = scene((Fixed(START), Fixed(START)))
    bad = replace(system, gravity=np.array([load, 0.0, 0.0]))
    with pytest.raises(StepError), np.errstate(all="ignore"):
        try_step(bad, state, 2e-3)


@pytest.mark.parametrize("unknown", ["q", "s", "lam", "y"])
def test_an_iterate_just_off_the_solution_is_not_accepted(unknown: str) -> None:
    """Independent check: a solution is accepted; moved by ten times GAP of the diameter (its forces by as much of
    themselves) in one unknown at one hole, it is not."""
    system, state = scene((Fixed(START), pulled_up(5e-3)), block_organ("P1", False))
    solution = run(system, state, 2e-3, 3)[-1].solution
    problem, z = solution.problem, solution.iterate
    assert coupling.step.newton.is_converged(problem, z, coupling.step.newton.evaluate(problem, z))
    off = {name: getattr(z, name).copy() for name in ("q", "s", "lam", "y")}
    scale = {"lam": np.abs(z.lam[0, 0])}.get(unknown, system.thread.section.diameter)
    place = system.thread.n // 2 if unknown == "q" else 0
    off[unknown][place] += 10 * GAP * scale * (1.0 if unknown == "s" else np.eye(off[unknown].shape[1])[0])
    moved = replace(z, **off)
    assert not coupling.step.newton.is_converged(problem, moved, coupling.step.newton.evaluate(problem, moved))


def test_a_failing_step_is_halved() -> None:
    """Consistency check: with steps above 0.6 ms refused, 2 ms are taken in four, the same four as by hand."""
    system, state = scene((Fixed(START), pulled_up(5e-3)))
    asked: list[float] = []

    def refusing(system: System, state: State, dt: float) -> Any:
        asked.append(dt)
        if dt > 0.6e-3:
            raise StepError(state.time, dt, "refused")
        return try_step(system, state, dt)

    halved = advance(system, state, 2e-3, refusing)
    assert [step.dt for step in halved] == [0.5e-3] * 4
    assert asked == [2e-3, 1e-3, 0.5e-3, 0.5e-3, 1e-3, 0.5e-3, 0.5e-3]
    by_hand = run(system, state, 0.5e-3, 4)
    assert np.array_equal(halved[-1].new.q, by_hand[-1].new.q)
    assert abs(halved[-1].new.time - 2e-3) <= IDENTITY


def test_a_flipped_tangent_is_an_inversion() -> None:
    """Independent check: a thread whose tangent reverses in a directed hole is refused by name, also where the frame
    goes on as it was; in a hole without direction it may."""
    holes = (Piercing("entry"), Piercing("exit"))
    system, state = scene((Free(), Free()), holes=holes)
    assert list(state.sense) == [-1.0, 1.0]  # down through the first, up through the second
    at = system.passage_of(state)
    D = at.D.copy()
    D[1, 1, 2] *= -1.0
    mirrored = replace(at, D=D)
    with pytest.raises(InversionError, match="'exit'") as caught:
        with_sense(system, state, state, mirrored)
    assert caught.value.time == 0.0
    loose = replace(system, piercings=tuple(replace(hole, directed=False) for hole in holes))
    assert list(with_sense(loose, state, state, mirrored).sense) == [-1.0, -1.0]


def test_a_frame_that_turns_through_itself_is_no_inversion() -> None:
    """Independent check: a frame that a linear organ lets follow a thread at the angle φ has u = u₀ − (u₀·t) t, of the
    length |cos φ|; on the way from 80° to 100° u × v turns against the thread, which does not jump. The triple product
    of a vector that turns on and its frame is cos φ."""
    system, state = scene((Free(), Free()), holes=(Piercing("entry"), Piercing("exit")))

    def at_angle(degrees: float) -> State:
        phi = np.radians(degrees)
        t = np.array([np.sin(phi), 0.0, np.cos(phi)])
        u, v = X - (X @ t) * t, np.array([0.0, 1.0, 0.0])
        turn = np.array([[np.cos(phi), 0.0, np.sin(phi)], [0.0, 1.0, 0.0], [-np.sin(phi), 0.0, np.cos(phi)]])
        q = state.q @ turn.T
        y = state.y.copy()
        y[1, 3:6], y[1, 6:] = u, v
        return replace(state, q=q, y=y)

    before, after = at_angle(80.0), at_angle(100.0)
    assert np.linalg.norm(np.cross(*after.y[1, 3:].reshape(2, 3))) == pytest.approx(-np.cos(np.radians(100.0)))
    before = with_sense(system, state, before, system.passage(before.q, before.s))
    after = with_sense(system, before, after, system.passage(after.q, after.s))
    assert [before.sense[1], after.sense[1]] == [1.0, -1.0]


@pytest.mark.parametrize("values", [(0.1, 0.2, 0.0), (-0.1, -0.2, 0.0), (0.2, 0.1, -1.0), (np.nan, np.nan, 0.0)])
def test_bad_friction_is_refused(values: tuple[float, float, float]) -> None:
    """Independent check: kinetic above static, negative and no numbers."""
    with pytest.raises(CouplingError, match="friction"):
        Friction(*values)


def test_holes_and_sites_must_pair() -> None:
    """Independent check: one site for one piercing."""
    with pytest.raises(CouplingError, match="2 sites"):
        hairpin_system(hairpin_sites(), (Free(), Free()), holes=(Piercing("only"),))


@pytest.mark.parametrize("given", [None, X])
def test_a_direction_is_imposed_where_there_is_one(given: Any) -> None:
    """Independent check: a hole that imposes a direction on a site without one, in space or in an organ, is refused
    with its name and the remedy; with a direction, or none imposed, it is not."""
    in_space = tissue.fixed_sites([tissue.Site(ORIGIN, direction=given)] * 2)
    for organ in (in_space, block_organ("P1", False, given)):
        hairpin_system(organ, FREE, holes=(Piercing("one", directed=False), Piercing("two", directed=False)))
        with nullcontext() if given is not None else pytest.raises(CouplingError, match="'two': directed"):
            hairpin_system(organ, FREE, holes=(Piercing("one", directed=False), Piercing("two")))


def test_a_thread_drawn_out_of_both_holes_goes_on() -> None:
    """Independent check: drawn out by its end, it leaves the entry, then the exit, stays out, and the run goes on to
    its end with no force from a hole it has left; the exit is left when as much has been drawn as lay before it."""
    system, state = scene((Free(), pulled_up(1.4 * LENGTH, 1.0)))
    first, dt, seen = state, 1e-3, []
    while state.time < 1.3 * LENGTH:
        for step in advance(system, state, dt):
            state = step.new
            assert np.all(state.lam[~state.present] == 0.0)
            at = system.passage_of(state)
            gap = np.abs(phi(at, state.lam, state.y))[state.present]
            assert gap.max(initial=0.0) <= GAP
            assert np.all(state.s[state.present] >= 0.0)
        seen.append([o.state for o in observe(system, first, state)])
    words = np.array(seen)
    assert list(words[0]) == ["slip", "slip"]
    assert list(words[-1]) == ["left", "left"]
    gone = [int(np.argmax(words[:, k] == "left")) for k in (0, 1)]
    assert 0 < gone[0] < gone[1]
    assert all(np.all(words[g:, k] == "left") for k, g in enumerate(gone))
    assert abs(gone[1] * dt - ABSCISSAE[1]) < 0.05 * LENGTH  # at 1 m/s; the bend springs out of the entry by itself
    assert np.all(state.q[:, 2] > END[2] - LENGTH)


# -- a taut thread ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["fixed in space", "P1 dynamic", "P1 quasi-static"])
def test_a_taut_thread(kind: str) -> None:
    """Independent check: pulled tight round two holes with directions until the hand feels more than 1 N; every step
    taken whole or halved ends with |Φ| ≤ GAP of the diameter, the audit closes, and the pull rises."""
    organ = None if kind == "fixed in space" else block_organ("P1", "dynamic" in kind, E=3e5)
    way = 14.5e-3
    system, state = scene((Fixed(START), pulled_up(way, 0.1)), organ, 60)
    energies, dt, pulls = initial_energies(system, state), 1e-3, []
    while state.time < way / 0.1 - 0.5 * dt and (not pulls or pulls[-1] < 1.05):
        for step in advance(system, state, dt):
            state, energies = step.new, audit_step(system, energies, step)
            at = system.passage_of(state)
            violation = np.abs(phi(at, state.lam, state.y))
            assert violation[:, :3].max() <= GAP * system.thread.section.diameter
            assert violation[:, 3:].max() <= GAP
        pulls.append(float(np.linalg.norm(state.reaction[1])))
    assert pulls[-1] > 1.0
    assert abs(energies.balance_error) <= TWO_SOLVERS * abs(energies.external_work)


# -- statics as the end of dynamics ----------------------------------------------------------------------------------


def test_statics_is_where_a_damped_run_ends() -> None:
    """Consistency check: load steps of equilibrium and a damped dynamic run under the same dead load, a hairpin in a
    quasi-static organ, one hole anchored; to TWO_SOLVERS in every unknown."""
    holes = (Piercing("anchor", slides=False), Piercing("exit"))
    organ = block_organ("P1", False, gravity=(0.0, 0.0, -9.81))
    ends = (Free(), Pulled(np.array([0.02, 0.01, 0.05])))
    system, state = scene(ends, organ, holes=holes, gravity=-9.81 * Z)
    system = replace(system, thread=replace(system.thread, damping=20.0))
    static = state
    for k in range(1, 5):
        static = load_step(system, static, k / 4, 1.0)[-1].new
    moving = state
    for dt in (1e-3,) * 20 + (0.1,) * 20 + (10.0,) * 10:
        moving = advance(system, moving, dt)[-1].new
    assert np.abs(static.q - state.q).max() > 1e-3 * LENGTH
    assert np.abs(moving.q - static.q).max() <= TWO_SOLVERS * LENGTH
    assert np.abs(moving.s - static.s).max() <= TWO_SOLVERS * LENGTH
    assert np.abs(moving.y - static.y).max() <= TWO_SOLVERS
    for part in (slice(0, 3), slice(3, 5)):
        size = np.abs(static.lam[:, part]).max()
        assert np.abs(moving.lam[:, part] - static.lam[:, part]).max() <= TWO_SOLVERS * size
    assert np.abs(moving.v).max() < 1e-9
    assert np.all(static.v == 0.0)
    assert np.abs(static.reaction[1] - [0.02, 0.01, 0.05]).max() <= IDENTITY
    assert abs(static.q[-1] @ X) > 0.0
