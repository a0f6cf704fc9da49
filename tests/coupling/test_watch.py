"""No step is accepted that lies uphill, and no thread leaves a hole over an end that is held."""

import tomllib
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import coupling.run.watch
import coupling.step.stepping
from coupling.errors import LentError, StepError, UphillError
from coupling.kernels.iteration import ROUND_OFF
from coupling.kernels.steps.watch import given_back
from coupling.reports.audit import Energies, is_of_bdf2
from coupling.run.run import Run, begin
from coupling.run.watch import CREATED, LOOSENED, SHARE, TRACE, Watch, memory_of
from coupling.step.stepping import Step, advance, bdf2_step, try_step
from coupling.system import Piercing, State, System
from studies.scenario import parse
from studies.simulation import prepare
from tests.bounds import FIRST_ORDER, IDENTITY
from tests.thread.threads import LENGTH, X, Z, laid, line, straight, uniform, without_organ
from thread.ends import Driven, End, Fixed, Free

SHORT = 0.04  # [m], of a thread at rest
SMALL = 1e-3  # of a taut thread's length: a way across by which its strain of 0.01 changes by less than 1e-5

# A pull of 0.07 N grows in 50 ms on a thread of a few milligrams that lies slack through two holes: it takes up its
# slack within a step, and an abscissa crosses many spans.
SLACK = """
[thread]
suture = "7-0 nylon"
knots = "fixed"
path = [[-0.04, 0, 0.02], [-0.005, 0, 0.008], [-0.005, 0, -0.006],
        [0.005, 0, -0.006], [0.005, 0, 0.008], [0.04, 0, 0.02]]
start = { kind = "fixed" }
end = { kind = "pulled", force = [0.063, 0, 0.0301], ramp = 0.05 }
[[piercing]]
name = "entry"
at = [-0.005, 0, 0]
direction = [0, 0, 1]
[[piercing]]
name = "exit"
at = [0.005, 0, 0]
direction = [0, 0, 1]
[solve]
dt = 1e-3
duration = 0.05
"""


@cache
def taut(dt: float, downhill: bool) -> tuple[Run, float]:
    """The thread pulled taut, and the largest share of the energy there is that one of its steps made."""
    simulation = prepare(parse(tomllib.loads(SLACK.replace("dt = 1e-3", f"dt = {dt!r}"))))
    run, most = replace(simulation.beginning(), downhill=downhill), 0.0
    while run.number < simulation.steps:
        before, run = run.energies, simulation.next(run)
        made = before.numerical_dissipation - run.energies.numerical_dissipation
        most = max(most, made / run.energies.at_stake)
    return run, most


def test_slack_is_taken_up_downhill() -> None:
    """Independent check: the minimum reached downhill never lies above where it began, and what the two holes bear at
    the end is what steps a quarter as long say; without the watch too."""
    force, fine, unwatched = (
        np.linalg.norm(taut(*which)[0].state.lam[:, :3], axis=1)
        for which in ((1e-3, True), (2.5e-4, True), (1e-3, False))
    )
    assert np.abs(force - fine).max() <= FIRST_ORDER * fine.max()
    assert np.abs(unwatched - fine).max() <= FIRST_ORDER * fine.max()
    for watched in (True, False):
        run, most = taut(1e-3, watched)
        assert most <= TRACE
        assert run.energies.numerical_dissipation > 0.0


def energies(work: float, kinetic: float, numerical: float) -> Energies:
    return Energies(kinetic, 0.0, 0.0, work, 0.0, 0.0, numerical, 0.0)


@pytest.mark.parametrize(
    ("work", "kinetic", "watch", "bound"),
    [
        (1.0, 1.0, {"least": 1.0}, SHARE * 2.0),
        (1e-9, 1.0, {"least": 1.0}, TRACE * 1.0),
        (1e-9, 1.0, {}, CREATED * 1.0),
        (1e-9, 1.0, {"refitted": True}, LOOSENED * 1.0),
    ],
    ids=["of what the step turns over", "of what there is", "while it can be halved", "on other packets"],
)
def test_a_step_is_judged_at_its_bound(
    monkeypatch: pytest.MonkeyPatch, work: float, kinetic: float, watch: dict[str, Any], bound: float
) -> None:
    """Independent check: energy made just below the bound passes, just above it is refused and not booked."""
    before = energies(0.0, kinetic if work < 1.0 else 0.0, 0.0)
    for share, refused in ((0.999, False), (1.001, True)):
        after = energies(work, kinetic, -share * bound)
        monkeypatch.setattr(coupling.run.watch, "audit_step", lambda system, energies, step, after=after: after)
        system, state = over_its_start(Free())
        watcher, step = Watch([before], **watch), try_step(system, state, 1e-4)
        if refused:
            with pytest.raises(StepError, match="create energy"):
                watcher(system, step)
        else:
            watcher(system, step)
        assert watcher.energies == ([before] if refused else [before, after])
        Watch([before], downhill=False)(system, step)


def test_what_a_shock_lends_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: a step of BDF2 that gives back its loan passes up to a trace of what there is; beyond, the
    watch asks for one without memory, and the step is taken by backward Euler, as long as it was."""
    run = shaken()
    for _ in range(3):
        run = run.step(2e-4)
    step = bdf2_step(run.system, run.state, 2e-4)
    assert is_of_bdf2(step)
    before = replace(run.energies, loan=run.energies.at_stake)
    for share, forgotten in ((0.999, False), (1.001, True)):
        made = before.numerical_dissipation - share * TRACE * before.at_stake
        after = replace(before, numerical_dissipation=made)
        monkeypatch.setattr(coupling.run.watch, "audit_step", lambda system, energies, step, after=after: after)
        watcher = Watch([before])
        if forgotten:
            with pytest.raises(LentError, match="would return"):
                watcher(run.system, step)
        else:
            watcher(run.system, step)

    def watch(system: System, step: Step) -> None:
        if is_of_bdf2(step):
            raise LentError(step.old.time, step.dt, "it would return")

    (part,) = advance(run.system, run.state, 2e-4, bdf2_step, watch=watch)
    assert part.dt == 2e-4 and not is_of_bdf2(part)


def shaken() -> Run:
    """A taut thread without damping, holes and weight, whose end a hand shakes across it by SMALL of its length, back
    and forth at random every millisecond."""
    times, z = np.linspace(0.0, 0.02, 21), SMALL * LENGTH * np.random.default_rng(3).uniform(-1.0, 1.0, 21)
    z[0] = 0.0
    hand = Driven(np.column_stack([times, 1.01 * LENGTH + 0.0 * times, 0.0 * times, z]))
    system = without_organ(uniform(LENGTH, 20), (Fixed(0.0 * X), hand))
    at_rest, q = laid(system, [], line(0.0 * X, X)), straight(system.thread.spline) * [1.01, 1.0, 1.0]
    taut = replace(at_rest, q=q, v=0.0 * q, N=system.thread.EA * system.thread.points(q).strain)
    return begin(system, taut, bdf2_step, downhill=False)


@pytest.mark.parametrize("dt", [2e-4, 1e-3])
def test_bdf2_gives_back_its_loan_alone(dt: float) -> None:
    """Independent check (G-stability): a linear motion without losses makes in a step of BDF2 what the one before lent
    and no more, of the energy that is in the motion; without the loan it would seem to make much."""
    run, there, made, beyond = shaken(), [shaken().energies.elastic], [], []
    for _ in range(20):
        before, run = run, run.step(dt)
        made.append(before.energies.numerical_dissipation - run.energies.numerical_dissipation)
        beyond.append(made[-1] - given_back(memory_of(run.taken[0]), before.energies.loan))
        there.append(run.energies.kinetic + run.energies.elastic)
    moving = max(there) - there[0]
    assert max(beyond) <= SMALL * moving
    assert max(made) > 10.0 * SMALL * moving


def test_a_step_that_makes_energy_is_halved_by_its_own_integrator() -> None:
    """Consistency check: parts of BDF2 where it goes on, down to a sixteenth; then, where it still makes energy, by
    backward Euler, and in halves of that."""
    run = shaken()
    for _ in range(3):
        run = run.step(2e-4)
    refused: list[Step] = []

    def watch(system: System, step: Step) -> None:
        if step.dt > least:
            refused.append(step)
            raise UphillError(step.old.time, step.dt, "uphill")

    for level, by_bdf2 in ((2, True), (5, False)):
        least = 1.01 * 2e-4 / 2**level
        parts = advance(run.system, run.state, 2e-4, bdf2_step, watch=watch)
        assert all(is_of_bdf2(step) for step in refused[:5])
        assert is_of_bdf2(parts[0]) == by_bdf2
        assert abs(sum(step.dt for step in parts) - 2e-4) <= 1e-15
        refused.clear()


@pytest.mark.parametrize("end", [Fixed(SHORT * X), Free()], ids=["held", "free"])
@pytest.mark.parametrize("compiled", [False, True])
def test_a_thread_at_rest_makes_no_energy(end: End, compiled: bool) -> None:
    """Independent check: a straight thread on which nothing acts stays, and no step is halved for the energy of its
    round-off, which is all that there is; by BDF2 such a step was refused down to the smallest part."""
    system = replace(without_organ(uniform(SHORT, 20), (Fixed(0.0 * X), end)), compiled=compiled)
    run = begin(system, laid(system, [], line(0.0 * X, X)), bdf2_step)
    after = run.steps(1e-3, 60)
    assert not after.events
    assert np.abs(after.state.q - run.state.q).max() <= IDENTITY * SHORT


@pytest.mark.parametrize(("strain", "refused"), [(ROUND_OFF, False), (1e-6, True)])
def test_the_energy_of_round_off_may_be_made(monkeypatch: pytest.MonkeyPatch, strain: float, refused: bool) -> None:
    """Independent check: all of ½ EA L ε², where the strain ε is round-off; of a larger one no more than CREATED."""
    system, state = over_its_start(Free())
    stored = 0.5 * system.thread.EA * LENGTH * strain**2
    before, after = energies(0.0, stored, 0.0), energies(0.0, stored, -(1.001 * CREATED if refused else 1.0) * stored)
    monkeypatch.setattr(coupling.run.watch, "audit_step", lambda system, energies, step: after)
    watcher, step = Watch([before]), try_step(system, state, 1e-4)
    if refused:
        with pytest.raises(StepError, match="create energy"):
            watcher(system, step)
    else:
        watcher(system, step)
    assert len(watcher.energies) == (1 if refused else 2)


def over_its_start(start: End) -> tuple[System, State]:
    """A straight thread through a hole near its start."""
    way = Driven(np.array([[0.0, *(LENGTH * X)]]))
    hole = ((0.01 * LENGTH * X, X),)
    system = without_organ(uniform(LENGTH, 20), (start, way), (Piercing("hole"),), hole)
    return system, laid(system, [0.01 * LENGTH], line(0.0 * X, X))


def jumping(system: System, state: State, dt: float) -> Step:
    """A step at whose end the thread has left its first hole over its start."""
    step = try_step(system, state, dt)
    return replace(step, new=replace(step.new, s=step.new.s - LENGTH)) if state.present[0] else step


def test_a_thread_leaves_a_hole_over_a_free_end_alone() -> None:
    """Independent check: an end that something holds cannot pass the hole, so the step is halved and then refused by
    name; a free one passes, and the hole is empty."""
    system, state = over_its_start(Free())
    assert not advance(system, state, 1e-4, jumping)[-1].new.present[0]
    for start in (Fixed(0.0 * X), Driven(np.array([[0.0, 0.0, 0.0, 0.0], [1.0, *(0.01 * Z)]]))):
        system, state = over_its_start(start)
        with pytest.raises(StepError, match="its start is held"):
            advance(system, state, 1e-4, jumping)
