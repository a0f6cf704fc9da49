"""First and second derivatives of the constraints, and the whole Newton matrix, against differences by slope; one
Newton correction by the assembled and by the condensed road."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from coupling.answer import all_holds
from coupling.integrators import BackwardEuler
from coupling.kernels import constraints
from coupling.kernels.constraints import (
    driving_force,
    passage,
    phi,
    phi_s,
    site_force,
    spread,
    thread_force,
)
from coupling.paper.assembled import Equation, Monolith, assemble, equation_of
from coupling.step.newton import LONGEST_MOVE, Problem, allowed_share, correct, evaluate
from coupling.step.stepping import dynamic_problem, organ_answer
from coupling.system import Friction, Piercing, System
from tests.bounds import IDENTITY, TWO_SOLVERS
from tests.coupling.test_friction_own import Howell
from tests.thread.threads import (
    ABSCISSAE,
    LENGTH,
    RADIUS,
    Strand,
    X,
    Z,
    assert_slope,
    bent,
    block_organ,
    hairpin,
    hairpin_sites,
    hairpin_system,
    laid,
    uniform,
)
from thread.ends import Clamped, Fixed, Free
from thread.thread import Thread

DT = 2e-3
RNG = np.random.default_rng(11)


@dataclass(frozen=True)
class Point:
    """Numbers of no special kind that Φ depends on: `q` (n, 3), `s` (2,), `y` (2, 9), and multipliers `lam` (2, 5).
    The first hole imposes a direction, the second does not."""

    thread: Thread
    q: np.ndarray
    s: np.ndarray
    y: np.ndarray
    lam: np.ndarray

    def at(self, dq: Any = 0.0, ds: Any = 0.0, dy: Any = 0.0) -> tuple[constraints.Passage, np.ndarray, np.ndarray]:
        """The passage, λ and y, moved."""
        return passage(self.thread.spline, self.q + dq, self.s + ds), self.lam, self.y + dy

    def potential(self, **move: Any) -> np.ndarray:
        """λ·Φ."""
        return np.array(np.sum(self.lam * phi(*self.at(**move))))


@pytest.fixture
def point() -> Point:
    thread = uniform(1.0, 10, Strand(EI=1.0))
    s = np.array([0.31, 0.77])
    lam = RNG.standard_normal((2, 5))
    return Point(thread, bent(thread.spline), s, RNG.standard_normal((2, 9)), lam)


def test_phi_is_what_the_equations_say(point: Point) -> None:
    """Independent check: g = P − x, c₁ = T·u, c₂ = T·v (eqs. 4, 8, 9), by the curve of the spline."""
    at, _, y = point.at()
    D = point.thread.spline.curve(point.q, point.s)
    for k in range(2):
        x, u, v = y[k].reshape(3, 3)
        exact = np.concatenate([D[k, 0] - x, [D[k, 1] @ u, D[k, 1] @ v]])
        assert np.abs(phi(at, 0.0 * point.lam, y)[k] - exact).max() <= IDENTITY * np.abs(exact).max()


def test_forces_are_the_slopes_of_lambda_phi(point: Point) -> None:
    """Independent check: Φ_qᵀλ, Φ_sᵀλ, Φ_yᵀλ and Φ are the derivatives of the potential by q, s, y, λ."""
    at, lam, y = point.at()
    dq, ds, dy = 0.1 * RNG.standard_normal(point.q.shape), 0.02 * RNG.standard_normal(2), RNG.standard_normal((2, 9))
    dlam = RNG.standard_normal(lam.shape)
    on_thread = spread(thread_force(at, lam, y), at, point.thread.n)
    assert_slope(lambda h: point.potential(dq=h * dq), np.array(np.sum(on_thread * dq)))
    assert_slope(lambda h: point.potential(ds=h * ds), np.array(driving_force(at, lam, y) @ ds))
    assert_slope(lambda h: point.potential(dy=h * dy), np.array(np.sum(site_force(at, lam, y) * dy)))
    assert_slope(lambda h: replace(point, lam=lam + h * dlam).potential(), np.array(np.sum(phi(at, lam, y) * dlam)))
    assert_slope(lambda h: phi(*point.at(ds=h * ds)), phi_s(at, lam, y) * ds[:, None])


def test_mixed_directions_of_lambda_phi(point: Point) -> None:
    """Independent check: all of q, s, y moved at once, so no pair of arguments is left out."""
    at, lam, y = point.at()
    dq, ds, dy = 0.1 * RNG.standard_normal(point.q.shape), 0.02 * RNG.standard_normal(2), RNG.standard_normal((2, 9))
    slope = np.sum(spread(thread_force(at, lam, y), at, point.thread.n) * dq)
    slope += driving_force(at, lam, y) @ ds + np.sum(site_force(at, lam, y) * dy)
    assert_slope(lambda h: point.potential(dq=h * dq, ds=h * ds, dy=h * dy), np.array(slope))


# -- the whole matrix ------------------------------------------------------------------------------------------------


ROUGH = Friction(static=0.4, kinetic=0.3, grip=0.05, channel=2e-3)
CHANNELLED = Friction(channel=2e-3, own=Howell())
HELD = (Clamped(hairpin(RADIUS, LENGTH)(np.array(0.0)), -Z), Fixed(hairpin(RADIUS, LENGTH)(np.array(LENGTH))))


@dataclass(frozen=True)
class Case:
    """What varies: organ, holes, active set, ε, and which holes the thread is in."""

    organ: Callable[[], Any]
    holes: tuple[Piercing, Piercing] = (Piercing("entry"), Piercing("exit"))
    sigma: tuple[float, float] = (1.0, 1.0)
    epsilon: float = 0.0
    present: tuple[bool, bool] = (True, True)
    ends: tuple[Any, Any] = (Free(), Free())


p1_dynamic = cache(lambda: block_organ("P1", True, rayleigh=(3.0, 1e-3)))
p2_static_fibre = cache(lambda: block_organ("P2", False, np.array([0.3, 0.1, 1.0])))
p1_static = cache(lambda: block_organ("P1", False))
CASES = {
    "ideal": Case(p1_dynamic),
    "fibre frames of a P2 organ": Case(p2_static_fibre),
    "clamped end": Case(p1_static, ends=HELD),
    "slip both ways": Case(p1_dynamic, (Piercing("a", friction=ROUGH), Piercing("b", friction=ROUGH)), (1.0, -1.0)),
    "slip without direction": Case(
        p1_static, (Piercing("a", directed=False, friction=Friction(0.3, 0.2)), Piercing("b")), (-1.0, 1.0)
    ),
    "slip of both kinds": Case(
        p1_dynamic, (Piercing("a", friction=ROUGH), Piercing("b", directed=False, friction=ROUGH)), (1.0, -1.0)
    ),
    "stick and anchor": Case(p1_static, (Piercing("a", friction=ROUGH), Piercing("b", slides=False)), (0.0, 0.0)),
    "law of one's own": Case(
        p1_dynamic,
        (Piercing("a", friction=Friction(0.1, 0.1, own=Howell())), Piercing("b", friction=CHANNELLED)),
        (1.0, -1.0),
    ),
    "inertia of s": Case(p1_dynamic, (Piercing("a", directed=False), Piercing("b")), epsilon=2e-4),
    "inertia of s and friction": Case(
        p1_static, (Piercing("a", friction=ROUGH), Piercing("b")), (-1.0, 1.0), epsilon=2e-4
    ),
    "one hole left": Case(p1_static, present=(True, False), sigma=(1.0, 0.0)),
    "fixed in space": Case(hairpin_sites, ends=HELD),
}


@dataclass(frozen=True)
class Setting:
    """A step's problem and an iterate in no equilibrium."""

    system: System
    problem: Problem
    organ: Equation
    z: Monolith

    def moved(self, d: Monolith, h: float) -> Monolith:
        """The iterate `h` times the direction `d` further, its axial forces those of the strain."""
        z = self.z
        q, U = z.q + h * d.q, z.U + h * d.U
        N = self.system.thread.EA * self.system.thread.points(q).strain
        y = all_holds(self.system, self.organ.y0 + self.organ.Y @ U)
        return replace(z, q=q, N=N, s=z.s + h * d.s, lam=z.lam + h * d.lam, y=y, U=U)

    def residual(self, z: Monolith) -> np.ndarray:
        """All equations of the assembled system."""
        return -assemble(self.problem, z, evaluate(self.problem, z)).right

    def direction(self, block: str) -> Monolith:
        """A direction of no special kind in the unknowns of a block ("all": in all of them), in sizes that matter."""
        rng, z = np.random.default_rng(3), self.z
        dq, dU = 2e-4 * rng.standard_normal(z.q.shape), 1e-4 * rng.standard_normal(z.U.shape)
        ds = 0.2 * LENGTH / (z.q.shape[0] - 3) * rng.choice([-1.0, 1.0], z.s.shape)
        ds[len(self.system.piercings) :] = 0.0  # a clamp holds an end of the thread
        dlam = rng.standard_normal(z.lam.shape) * [0.2, 0.2, 0.2, 2e-4, 2e-4]
        dq.ravel()[self.system.held] = 0.0
        on = {name: float(block in (name, "all")) for name in ("q", "U", "s", "lam")}
        return replace(z, q=on["q"] * dq, U=on["U"] * dU, s=on["s"] * ds, lam=on["lam"] * dlam)


@cache
def setting(name: str) -> Setting:
    case = CASES[name]
    organ = case.organ()
    system = hairpin_system(organ, case.ends, 40, case.holes, epsilon=case.epsilon)
    state = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    more = system.holds - 2
    state = replace(state, present=np.array(case.present + (True,) * more), s_dot=0.05 + 0.0 * state.s)
    scheme = BackwardEuler(DT)
    problem = dynamic_problem(system, state, DT, organ_answer(system, scheme, state))
    step = equation_of(problem)
    rng = np.random.default_rng(7)
    q = state.q + 3e-4 * rng.standard_normal(state.q.shape)
    U = 2e-4 * rng.standard_normal(organ.size)
    lam = rng.standard_normal(state.lam.shape) * [0.3, 0.3, 0.3, 3e-4, 3e-4]
    span = LENGTH / (system.thread.n - 3)
    s = np.append((state.s[:2] // span + np.array([0.4, 0.6])) * span, state.s[2:])  # off the knots
    sigma = np.array(case.sigma + (0.0,) * more)
    z = Monolith(q, state.N, s, lam, state.y, sigma, U)
    still = Setting(system, problem, step, z)
    return replace(still, z=still.moved(replace(z, q=0 * q, s=0 * s, lam=0 * lam, U=0 * U), 0.0))


@pytest.mark.parametrize("block", ["q", "U", "s", "lam", "all"])
@pytest.mark.parametrize("name", CASES)
def test_assembled_matrix_is_the_slope_of_the_residual(name: str, block: str) -> None:
    """Independent check: every block of columns, and within it every block of rows on its own scale, second-order terms
    of Φᵀλ and of friction included."""
    case = setting(name)
    if block == "U" and case.z.U.size == 0:
        assert name == "fixed in space"
        return
    d = case.direction(block)
    system = assemble(case.problem, case.z, evaluate(case.problem, case.z))
    flat = np.concatenate([d.q.ravel(), d.U, d.s, d.lam.ravel()])
    exact = system.matrix @ flat
    base = np.abs(case.residual(case.z))
    zero_rows = 0
    for rows in system.blocks.values():
        part, scale = exact[rows], max(base[rows].max(initial=0.0), np.abs(exact[rows]).max(initial=0.0))
        if part.size and np.abs(part).max() > 0.0:
            assert_slope(lambda h, rows=rows: case.residual(case.moved(d, h))[rows], part)
        elif part.size:
            zero_rows += 1
            difference = case.residual(case.moved(d, 1.0))[rows] - case.residual(case.moved(d, -1.0))[rows]
            assert np.abs(difference).max() <= IDENTITY * scale
    assert zero_rows < len(system.blocks)


@pytest.mark.parametrize("stiffen", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_one_correction_by_two_roads(name: str, stiffen: bool) -> None:
    """Consistency check: from any iterate the condensed Newton correction is that of the assembled matrix, in each
    unknown relative to its own correction; adding the constraints' stiffness to the thread's rows changes nothing."""
    case = setting(name)
    r = evaluate(case.problem, case.z)
    system = assemble(case.problem, case.z, r)
    x = splu(system.matrix).solve(system.right)
    dq = x[system.blocks["q"]].reshape(-1, 3)
    problem = replace(case.problem, stiffen=stiffen)
    cut, furthest = allowed_share(problem, dq), min(1.0, LONGEST_MOVE * LENGTH / np.abs(dq).max())
    assert 1e-3 < cut == furthest
    ds, dlam = x[system.blocks["s"]], x[system.blocks["lam"]].reshape(-1, 5)
    dy = case.organ.Y @ x[system.blocks["U"]]
    _, new = correct(problem, case.z, r)
    for got, exact in (
        (new.q - case.z.q, dq),
        (new.s - case.z.s, ds),
        ((new.lam - case.z.lam)[:, :3], dlam[:, :3]),
        ((new.lam - case.z.lam)[:, 3:], dlam[:, 3:]),
        ((new.y - case.z.y)[:2].ravel(), dy),
    ):
        still = IDENTITY * LENGTH * (exact.any() == 0)
        assert np.abs(got - cut * exact).max() <= TWO_SOLVERS * cut * np.abs(exact).max() + still
    N = case.system.thread.next_axial_force(r.points, cut * dq)
    assert np.abs(new.N - N).max() <= TWO_SOLVERS * np.abs(N).max()


def test_ends_and_axes_of_the_cases() -> None:
    """Consistency check: the cases are what their names say."""
    assert setting("clamped end").system.holds == 3
    assert setting("ideal").z.U.size > 100
    assert np.abs(setting("ideal").z.lam).min() > 0.0
    assert abs(setting("ideal").system.thread.spline.curve(setting("ideal").z.q, ABSCISSAE)[0, 1] @ X) > 0.0
