"""Threads, organs and starts shared by the tests of thread and coupling; and derivatives checked by slope."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.linalg import null_space

import tissue
from coupling.errors import StepError
from coupling.integrators import BackwardEuler
from coupling.kernels.bordered import columns
from coupling.rest.equilibrium import load_steps
from coupling.rest.laying import start
from coupling.step.newton import Iterate, Problem, Solution, solve
from coupling.step.stepping import Step, advance, dynamic_problem, organ_answer, predict, try_step
from coupling.system import Piercing, State, System
from tests.bounds import IDENTITY, SLOPE
from thread.banded import diagonal_of
from thread.ends import End, Fixed, Free, Pulled
from thread.frames import Frame
from thread.knots import uniform_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Points, Thread

Array = NDArray[np.float64]
Path = Callable[[Array], Array]

X, Y, Z = np.eye(3)
ORIGIN = np.zeros(3)
FREE = (Free(), Free())
FEW = 12  # corrections, half of those allowed


@dataclass(frozen=True)
class Strand:
    """A section given by its products: `diameter` [m], `rhoA` [kg/m], `EA` [N], `EI`, `GJ` [N m²]."""

    diameter: float = 0.3195e-3
    rhoA: float = 7.25571e-5
    EA: float = 240.521
    EI: float = 1.534527e-6
    GJ: float = 1.096091e-6

    @property
    def rhoJ(self) -> float:
        """Polar moment of inertia of the mass per length [kg m]."""
        return self.rhoA * self.diameter**2 / 8


PP = Strand()  # 2-0 polypropylene: E = 3 GPa, 905 kg/m³, solid circle


def thread_on(knots: Array, section: Strand = PP, **options: Any) -> Thread:
    """A thread on given knots."""
    return Thread(Spline(knots), section, **options)


def uniform(length: float, n: int, section: Strand = PP, **options: Any) -> Thread:
    """A thread of `n` control points with equal spans."""
    return thread_on(uniform_knots(length, n), section, **options)


def greville(spline: Spline) -> Array:
    """Abscissae of the control points of a straight thread, shape `(n,)` [m]: the blossom of s."""
    return (spline.knots[1:-3] + spline.knots[2:-2] + spline.knots[3:-1]) / 3.0


def straight(spline: Spline, origin: Array = ORIGIN, along: Array = X) -> Array:
    """Control points of the straight thread P(s) = origin + s along, exact, shape `(n, 3)` [m]."""
    return origin + greville(spline)[:, None] * along


def bent(spline: Spline, seed: int = 0) -> Array:
    """A thread bent and stretched by a tenth in no special way, shape `(n, 3)` [m]."""
    rng = np.random.default_rng(seed)
    x = greville(spline) / spline.end
    a, b = rng.uniform(-0.1, 0.1, (2, 4, 3))
    waves = np.pi * x[:, None] * np.arange(1, 5)
    return straight(spline) + spline.end * (np.sin(waves) @ (a / np.arange(1, 5)[:, None]) + np.cos(waves) @ (0.3 * b))


def dense(band: Array) -> Array:
    """A banded matrix as a full one."""
    size = band.shape[1]
    full = np.zeros((size, size))
    for r in range(len(band)):
        offset = r - diagonal_of(band)
        column = np.arange(max(0, -offset), min(size, size - offset))
        full[column + offset, column] = band[r, column]
    return full


def laid(system: System, s: Any, path: Path) -> State:
    """The consistent start of a thread along a path given by its arc length."""
    return start(system, np.asarray(s, float), path(gauss_rule(system.thread.spline, MASS_POINTS).s), 1.0)


def line(origin: Array, along: Array) -> Path:
    """A straight path."""
    return lambda s: origin + np.asarray(s)[..., None] * along


def hairpin(radius: float, length: float) -> Path:
    """Down a leg, half a circle below z = 0, up the other leg: through two holes 2 `radius` apart, at right angles."""
    arc = np.pi * radius
    leg = 0.5 * (length - arc)

    def at(s: Array) -> Array:
        s = np.asarray(s, float)
        angle = np.clip((s - leg) / radius, 0.0, np.pi)
        above = np.where(s < leg, leg - s, np.where(s > leg + arc, s - leg - arc, 0.0))
        return np.stack([-radius * np.cos(angle), 0.0 * s, above - radius * np.sin(angle)], axis=-1)

    return at


def without_organ(
    thread: Thread, ends: tuple[End, End] = FREE, piercings: tuple[Piercing, ...] = (), sites: Any = (), **options: Any
) -> System:
    """A system whose holes are fixed in space: `sites` as (point, direction)."""
    placed = tissue.fixed_sites([tissue.Site(point, direction=direction) for point, direction in sites])
    return System(thread, ends, placed, piercings, **options)


def last_by_newton(steps: list[Step], dt: float) -> tuple[Step, Problem, Iterate, Solution]:
    """The last of the steps of `dt` that Newton's method finds from where the motion leads in few corrections, without
    going downhill: its problem, the first iterate, and the solution. A long way depends on the solver's round-off."""
    for step in reversed(steps):
        system = step.solution.problem.system
        problem = dynamic_problem(system, step.old, dt, organ_answer(system, BackwardEuler(dt), step.old))
        first = predict(problem, step.old)
        try:
            solution = solve(problem, first)
        except StepError:
            continue
        if solution.iterations <= FEW:
            return step, problem, first, solution
    raise AssertionError("Newton's method finds none of the steps from where the motion leads")


def load_step(system: System, state: State, share: float, duration: float) -> list[Step]:
    """The steps to the part `share` of the loads at rest."""
    return list(load_steps(system, state, share, duration))


def run(system: System, state: State, dt: float, steps: int) -> list[Step]:
    """`steps` times `dt` further, halved where need be."""
    out: list[Step] = []
    for _ in range(steps):
        out += advance(system, state, dt)
        state = out[-1].new
    return out


def taken(system: System, state: State, dt: float, steps: int) -> list[Step]:
    """The same, every step as taken, none halved."""
    out: list[Step] = []
    for _ in range(steps):
        out.append(try_step(system, state, dt))
        state = out[-1].new
    return out


def allowed(system: System, state: State) -> Array:
    """A basis of the motions that the ends allow: the constraints are linear in the control values."""
    thread = system.thread
    at = system.passage_of(state)
    size = thread.n * thread.coordinates
    V = columns(at, thread.n, thread.coordinates).reshape(size, system.holds, 3, 3)
    clamps = [V[:, k, 1] @ state.y[k, part] for k in range(system.holds) for part in (slice(3, 6), slice(6, 9))]
    rows = np.vstack([np.eye(size)[system.held], *clamps])
    return null_space(rows) if len(rows) else np.eye(size)


def stiffness(system: System, state: State, N: Array | None = None) -> Array:
    """The tangent over the motions that the ends allow; with the axial force `N` in place of the strain's."""
    points, B = system.thread.points(state.q, state.frame), allowed(system, state)
    return B.T @ dense(system.thread.tangent(points, system.thread.EA * points.strain if N is None else N)) @ B


def inertia(system: System, state: State) -> Array:
    """The mass over the motions that the ends allow."""
    B = allowed(system, state)
    return B.T @ dense(system.thread.mass_band) @ B


RADIUS, LENGTH = 5e-3, 0.076
SITES = (np.array([-RADIUS, 0.0, 0.0]), np.array([RADIUS, 0.0, 0.0]))
LEG = 0.5 * (LENGTH - np.pi * RADIUS)
ABSCISSAE = (LEG, LENGTH - LEG)


def block_organ(element: str, inertia: bool, direction: Any = "normal", E: float = 1e5, **options: Any) -> Any:
    """A small block, top at z = 0, held below, with the two sites of the hairpin on its top."""
    lines = np.linspace(-0.015, 0.015, 7), np.linspace(-0.01, 0.01, 5), np.linspace(-0.01, 0.0, 4)
    mesh = skfem.MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: np.isclose(x[2], -0.01)})
    body = tissue.elasticity(mesh, tissue.Material(E, 0.45, 1070.0), element, ("bottom",))
    holes = [tissue.Site(point, 2e-3, "parabolic", direction) for point in SITES]
    sites = tissue.build_sites(body, holes)
    return (tissue.DynamicOrgan if inertia else tissue.QuasiStaticOrgan)(body, sites, **options)


def hairpin_sites() -> tissue.FixedSites:
    """The two holes of the hairpin fixed in space. Their frames' normal is up: an entry and an exit."""
    return tissue.fixed_sites([tissue.Site(point, direction=Z) for point in SITES])


def hairpin_system(organ: Any, ends: tuple[End, End], n: int = 40, holes: Any = None, **options: Any) -> System:
    """The hairpin through two holes of an organ."""
    holes = (Piercing("entry"), Piercing("exit")) if holes is None else holes
    return System(uniform(LENGTH, n), ends, organ, holes, **options)


def pulled_hairpin(organ: Any, pull: Array, ramp: float, R: Array) -> tuple[System, State]:
    """The hairpin in an organ, turned by `R`: its start is held, its end drawn by R `pull` [N] that grows within `ramp`
    [s], under gravity."""
    path = hairpin(RADIUS, LENGTH)
    ends = Fixed(R @ path(np.array([0.0]))[0]), Pulled(R @ pull, np.array([[0.0, 0.0], [ramp, 1.0]]) if ramp else None)
    system = hairpin_system(organ, ends, 40, gravity=R @ (-9.81 * Z))
    return system, laid(system, ABSCISSAE, lambda s: path(s) @ R.T)


def moving(state: State, v: Array) -> State:
    """The state with the velocity `v`."""
    return replace(state, v=v)


def assert_slope(f: Callable[[float], Array], exact: Array, h: float = 1.0) -> None:
    """Central differences of `f` at 0 tend to `exact` with the square of their step, down to round-off.

    Steps `h`, `h`/10, …; a pair of errors counts while the smaller is a hundred times its round-off. A function whose
    first difference is exact to 1e-9 is a polynomial of degree two along the line, and counts as well.
    """
    exact = np.asarray(exact, float)
    size = np.abs(exact).max()
    assert size > 0.0, "nothing to check: the derivative is zero"
    steps = h * 10.0 ** -np.arange(5)
    errors = np.array([np.abs((f(x) - f(-x)) / (2 * x) - exact).max() for x in steps]) / size
    round_off = 2e-16 * np.abs(f(0.0)).max() / size / steps + 1e-15
    counts = errors[1:] > 100 * round_off[1:]
    decades = np.log10(errors[:-1][counts] / errors[1:][counts])
    assert errors.min() < 1e-5, f"errors {errors}"
    assert errors[0] < 1e-9 or (decades.size and abs(decades[-1] - 2.0) < SLOPE), f"errors {errors}"


def assert_derivatives(thread: Thread, frame: Frame | None, q: Array, d: Array) -> Points:
    """Force and tangent of a thread along `d` (n, c) by the slope of energy and force; the tangent is symmetric.

    Returns the thread at `q`.
    """
    gradient = lambda x: thread.gradient(thread.points(x, frame))  # noqa: E731
    assert_slope(lambda h: np.array(thread.energy(thread.points(q + h * d, frame))), np.array(np.sum(gradient(q) * d)))
    points = thread.points(q, frame)
    H = dense(thread.tangent(points, thread.EA * points.strain))
    assert_slope(lambda h: gradient(q + h * d).ravel(), H @ d.ravel())
    assert np.abs(H - H.T).max() <= IDENTITY * np.abs(H).max()
    return points
