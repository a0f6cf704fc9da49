"""The compliance that the spline lacks at a hole goes by the tension: what exchanging it for another one stores."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import coupling.reports.audit
from coupling.kernels.constraints import Passage, held_energy, meeting
from coupling.kernels.holes import hold_at
from coupling.kernels.steps.audit import Met, bears, exchange_between, exchange_in_place
from coupling.reports.audit import BORNE, audit_step, passing_of
from coupling.run.run import Run, begin
from coupling.run.watch import CREATED
from coupling.step.stepping import try_step
from coupling.system import Piercing
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.coupling.wholes import whole
from tests.thread.threads import ORIGIN, PP, Array, laid, uniform, without_organ
from thread.ends import Driven, Fixed

SPANS, RATIO, HOLD = 8, 10.0, 1.0  # of the thread; of a span to √(EI/HOLD); [N]
TURN, BEFORE = np.radians(60.0), np.radians(30.0)  # of the thread at the hole, in all and up to its direction
STEPS, DT, RATE = 60, 1e-3, 40.0  # [-], [s], [1/s]


@whole
def stored_more(D: Array, c: Array, directed: bool, lam: Array, y: Array, rows: Array, after: Array) -> float:
    """What the exchange of a hold's compliance for another one stores."""
    return exchange_in_place(hold_at(D, c, directed, False, False, 0.0, lam, y), rows, after)


@whole
def let_go_between(was: Any, now: Any, mid: Array, back: Array, directed: bool, lam: Array, y: Array) -> float:
    """What a hold stores less as its compliance changes from the start of a step to its end, under the same forces."""
    one = hold_at(was.D[0], was.c[0], directed, False, False, 0.0, lam, y)
    other = hold_at(now.D[0], now.c[0], directed, False, False, 0.0, lam, y)
    return exchange_between(one, other, Met(was, now, mid, back), 0)


@whole
def is_borne(D: Array, c: Array, directed: bool, lam: Array, y: Array, after: Array, borne: float) -> bool:
    """Whether another compliance bears a hold where it is."""
    return bears(hold_at(D, c, directed, False, False, 0.0, lam, y), after, borne)


def only_hold(at: Passage, run: Run) -> tuple[Any, ...]:
    """The hold of a run with the thread as it passes there, for the kernels."""
    passing, state = passing_of(at), run.state
    return passing.D[0], passing.c[0], bool(at.directed[0]), state.lam[0], state.y[0]


def along(angle: float) -> Array:
    """Unit vector at `angle` below x in the plane of x and z."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)])


def strummed(directed: bool = True) -> Run:
    """A thread without damping and friction on long spans, drawn round a hole by a hand that swings between strains of
    2 and of 6 HOLD/EA."""
    span = RATIO * np.sqrt(PP.EI / HOLD)
    length, s = SPANS * span, (SPANS // 2 + 0.3) * span
    t = np.linspace(0.0, 1.0, 2001)
    far = length - s + length * HOLD / PP.EA * (2.0 + 4.0 * np.sin(2.0 * np.pi * RATE * t) ** 2)
    far[0] = length - s
    hand = Driven(np.column_stack([t, far[:, None] * along(TURN)]))
    hole, sites = Piercing("hole", directed=directed), ((ORIGIN, along(BEFORE)),)
    system = without_organ(uniform(length, SPANS + 3), (Fixed(-s * along(0.0)), hand), (hole,), sites)

    def path(at: Array) -> Array:
        beyond = (np.asarray(at) - s)[..., None]
        return np.where(beyond < 0.0, beyond * along(0.0), beyond * along(TURN))

    return begin(system, laid(system, [s], path), try_step)


def exchanged(run: Run, ratio: float) -> tuple[Passage, Passage]:
    """The passage of a run's state, and the same with √(EI/T) of a `ratio` to what it was."""
    before, layers = run.system.passage_of(run.state), run.state.layers
    assert layers is not None
    c = run.system.thread.missing_compliance(run.state.s, None, ratio * layers)
    return before, replace(before, c=c)


def after_some_steps(directed: bool) -> Run:
    run = strummed(directed)
    for _ in range(5):
        run = run.step(DT)
    return run


@pytest.mark.parametrize("ratio", [0.7, 1.5])
def test_what_an_exchange_stores_under_a_force(ratio: float) -> None:
    """Independent check: a spring c⁻ at the displacement c⁻λ stores ½(c⁻λ)²/c⁻, one of c⁺ there ½(c⁻λ)²/c⁺."""
    run = after_some_steps(False)
    before, after = exchanged(run, ratio)
    old, new = before.c[0, 0, 0], after.c[0, 0, 0]
    tangent = before.T[0] / np.linalg.norm(before.T[0])
    force = np.linalg.norm(np.cross(run.state.lam[0, :3], tangent))  # across the thread
    expected = 0.5 * (old * force) ** 2 * (1.0 / new - 1.0 / old)
    found = stored_more(*only_hold(before, run), run.system.rows[0], after.c[0, 0])
    assert abs(found - expected) <= RESIDUAL * abs(expected)


@pytest.mark.parametrize("ratio", [0.7, 1.5])
def test_what_an_exchange_stores_under_force_and_couple(ratio: float) -> None:
    """Independent check: what a hole stores at the displacement and turn d is the most of d·x − Ψ over the forces x
    across the thread and the couples (Legendre), Ψ being what it stores under x and the force along the thread."""
    run = after_some_steps(True)
    before, after = exchanged(run, ratio)
    lam, y = run.state.lam, run.state.y
    met, unit_tangent = meeting(before, lam, y), before.T / np.linalg.norm(before.T, axis=1, keepdims=True)
    off, turn = met.place - before.P, met.tangent - before.T
    along = lam[0, :3] @ unit_tangent[0]
    sides = np.linalg.svd(unit_tangent)[2][1:]  # across the thread
    d = np.concatenate([sides @ off[0], turn[0] @ y.reshape(3, 3)[1:].T])
    x = np.concatenate([sides @ lam[0, :3], lam[0, 3:]])

    def stored(at: Passage, x: Array) -> float:
        there = np.concatenate([x[:2] @ sides + along * unit_tangent[0], x[2:]])
        return float(d @ x - held_energy(at, there[None], y)[0])

    scale = np.abs(x).max() * np.array([1.0, 1.0, 1e-3, 1e-3])
    unit = stored(before, x)
    most = minimize(lambda z: -stored(after, scale * z) / unit, x / scale, method="Nelder-Mead", tol=1e-14)
    most = minimize(lambda z: -stored(after, scale * z) / unit, most.x, method="Nelder-Mead", tol=1e-14)
    found = stored_more(*only_hold(before, run), run.system.rows[0], after.c[0, 0])
    assert abs(found - (-most.fun * unit - unit)) <= TWO_SOLVERS * unit


@pytest.mark.parametrize("ratio", [0.7, 1.5])
@pytest.mark.parametrize("directed", [False, True])
def test_what_an_exchange_between_two_ends_stores(directed: bool, ratio: float) -> None:
    """Independent check: under forces that stay, ½λ(c⁻ − c⁺)λ is by how much less Ψ is, with its share c₃, which is
    where a thread leaves the direction of its hole."""
    run = after_some_steps(directed)
    before, after = exchanged(run, ratio)
    lam, y = run.state.lam, run.state.y
    was, now = passing_of(before), passing_of(after)
    found = let_go_between(was, now, after.c[:, 0], before.c[:, 0], directed, lam[0], y[0])
    stored = [held_energy(at, lam, y)[0] for at in (before, after)]
    assert abs(found - (stored[0] - stored[1])) <= RESIDUAL * max(stored)
    if directed:
        flat = [held_energy(replace(at, c=at.c * np.array([1.0, 1.0, 1.0, 0.0])), lam, y)[0] for at in (before, after)]
        assert abs(found - (flat[0] - flat[1])) > 1e3 * RESIDUAL * max(stored)  # there is something to be seen


def most_made(run: Run) -> float:
    """The most that a step makes of what is at stake, of `STEPS` from a run on."""
    most = -np.inf
    for _ in range(STEPS):
        before, run = run.energies, run.step(DT)
        for step in run.taken:
            after = audit_step(run.system, before, step)
            most = max(most, (before.numerical_dissipation - after.numerical_dissipation) / after.at_stake)
            before = after
    return most


def test_backward_euler_only_takes_as_the_tension_swings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Independent check: a step goes downhill in the potential that it has, so what is exchanged before it in place
    leaves nothing that it could make. By the mean of both ends it would seem to."""
    assert most_made(replace(strummed(), downhill=False)) <= CREATED
    monkeypatch.setattr(coupling.reports.audit, "BORNE", np.inf)
    assert most_made(replace(strummed(), downhill=False)) > 100.0 * CREATED


def test_a_knot_without_tension_bears_no_displacement() -> None:
    """Independent check: at a knot a cubic spline has the jump of shear that a force makes, and lacks nothing under it;
    within a span it does."""
    run = after_some_steps(True)
    thread, at = run.system.thread, run.system.passage_of(run.state)
    knot, span = thread.spline.breaks[4], np.diff(thread.spline.breaks)[4]
    for s, borne in ((knot, False), (knot + 0.3 * span, True)):
        there = [thread.missing_compliance(np.array([s]), None, layers) for layers in (run.state.layers, None)]
        taut, slack = (replace(at, c=c) for c in there)
        assert is_borne(*only_hold(taut, run), slack.c[0, 0], BORNE) == borne
