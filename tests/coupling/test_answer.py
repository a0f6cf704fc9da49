"""A nonlinear organ through `Answer.again`: sites on springs that stiffen, coupled to a thread that is drawn taut.

Each of the nine numbers of a site gives way by y = y0 + C f + c f³ under its own force f. The organ's unknown is
U = y − y0; its own equation F(U) = f, F the inverse of that cubic, is solved by the same Newton as all the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_matrix, diags_array

from coupling.integrators import BackwardEuler, Scheme
from coupling.paper.assembled import Monolith, monolithic_solve
from coupling.step.newton import Iterate, Problem, Residual, correct, solve
from coupling.step.stepping import Step, dynamic_problem, organ_answer, predict, try_step
from coupling.system import System
from tests.bounds import TWO_SOLVERS
from tests.thread.threads import ABSCISSAE, LENGTH, RADIUS, Array, X, Z, hairpin, hairpin_sites, hairpin_system, laid
from thread.ends import Driven, Fixed
from tissue.organs.meshed import NO_LIPS, Equation, Lips

DT = 2e-3
C = np.tile([4e-3] * 3 + [1.5e2] * 6, 2)  # of one number of a site by its own force [m/N, 1/(N m)]
HALF = np.tile([0.1] * 3 + [1e-4] * 6, 2)  # force at which the cubic gives way by as much again [N, N m]
SETTLED = 1e-13  # of the largest force, by which the organ's own equation may be off
NOTHING = np.zeros(0)


def force_of(U: Array) -> Array:
    """The root f of C f + c f³ = U with c = C/HALF², shape `(9p,)`: a depressed cubic with one real root."""
    p = HALF**2
    return 2.0 * np.sqrt(p / 3.0) * np.sinh(np.arcsinh(1.5 * U / C * np.sqrt(3.0 / p)) / 3.0)


@dataclass(frozen=True)
class CubicAnswer:
    """The springs linearised at U: K dU = f − F(U), K = dF/dU."""

    y0: Array
    U: Array

    @property
    def F(self) -> Array:
        return force_of(self.U)

    @property
    def give(self) -> Array:
        """dU/df, shape `(9p,)`."""
        return C * (1.0 + 3.0 * (self.F / HALF) ** 2)

    @property
    def y_free(self) -> Array:
        return self.y0 + self.U - self.give * self.F

    @property
    def C(self) -> Array:
        return np.diag(self.give)

    linear, g_free, C_cy = False, NOTHING, np.zeros((0, 18))

    def gaps_by_forces(self, some: np.ndarray) -> Array:
        return np.zeros((0, 0))

    def accept(self, f_y: Array, p: Array) -> Array:
        return self.moved(f_y).U

    def again(self, f_y: Array, p: Array) -> "CubicAnswer":
        off = np.abs((f_y - self.F) * self.give).max()
        return self if off <= SETTLED * np.abs(self.U).max(initial=0.0) else self.moved(f_y)

    def moved(self, f_y: Array) -> "CubicAnswer":
        return CubicAnswer(self.y0, self.U + self.give * (f_y - self.F))

    @property
    def equation(self) -> Equation:
        K, none = 1.0 / self.give, csr_matrix((0, 18))
        return Equation(csr_matrix(diags_array(K)), K * self.U - self.F, self.y0, csr_matrix(np.eye(18)), NOTHING, none)


@dataclass(frozen=True)
class CubicSprings:
    """The organ of these springs; its state is U (18,)."""

    y0: Array

    def start(self) -> Array:
        return np.zeros(18)

    def answer(self, scheme: Scheme, past: Sequence[Array], time: float, share: float = 1.0) -> CubicAnswer:
        return CubicAnswer(self.y0, past[0])

    def site_variables(self, state: Array) -> Array:
        return self.y0 + state

    def lips(self, state: Array) -> Lips:
        return NO_LIPS


def scene() -> System[Array]:
    """The hairpin through two sites on cubic springs, one end held, the other drawn away at 20 mm/s."""
    path = hairpin(RADIUS, LENGTH)
    start, end = path(np.array([0.0, LENGTH]))
    hand = Driven(np.array([[0.0, *end], [1.0, *(end + 0.02 * Z + 0.005 * X)]]))
    organ: Any = CubicSprings(hairpin_sites().y0)
    return hairpin_system(organ, (Fixed(start), hand), 40)


def drawn(steps: int) -> tuple[System[Array], list[Step[Array]]]:
    """The first steps of that motion."""
    system, out = scene(), []
    state = laid(system, ABSCISSAE, hairpin(RADIUS, LENGTH))
    for _ in range(steps):
        out.append(try_step(system, state, DT))
        state = out[-1].new
    return system, out


SYSTEM, STEPS = drawn(100)


def test_the_springs_are_worked_into_their_cubic_range() -> None:
    """Independent check: at the end U = C f + c f³ with the thread's own forces, and the cubic part is no trifle."""
    last = STEPS[-1]
    f = last.solution.residual.f_y[:2].ravel()
    exact = C * (f + f**3 / HALF**2)
    for part in (slice(0, 3), slice(3, 9)):
        got, want = (x.reshape(2, 9)[:, part] for x in (last.new.organ, exact))
        assert np.abs(got - want).max() <= TWO_SOLVERS * np.abs(want).max()
    assert (f / HALF).max() ** 2 > 0.3
    assert np.abs(SYSTEM.organ.site_variables(last.new.organ) - last.new.y.ravel()).max() <= TWO_SOLVERS * RADIUS


@pytest.mark.parametrize("step", STEPS[20::40])
def test_condensed_and_assembled_agree(step: Step[Array]) -> None:
    """Consistency check: the step by the organ's answer and with the organ's unknowns in the whole matrix."""
    problem = dynamic_problem(SYSTEM, step.old, DT, organ_answer(SYSTEM, BackwardEuler(DT), step.old))
    first = predict(problem, step.old)
    z = monolithic_solve(problem, first, step.old.organ).iterate
    assert isinstance(z, Monolith)
    a = solve(problem, first).iterate
    pairs = [(a.q - step.old.q, z.q - step.old.q), (a.s, z.s), (a.y, z.y), (step.new.organ, z.U)]
    pairs += [(a.lam[:, :3], z.lam[:, :3]), (a.lam[:, 3:], z.lam[:, 3:])]
    for got, exact in pairs:
        assert np.abs(got - exact).max() <= TWO_SOLVERS * np.abs(exact).max()


def size(problem: Problem[Array], r: Residual) -> float:
    """Largest residual of a step, each over its own scale."""
    free = r.thread.ravel().copy()
    free[problem.system.held] = 0.0
    d = problem.system.thread.section.diameter
    parts = [free / r.force_scale, r.holds[:, 1:4] / d, r.holds[:, 4:], r.site[:, :3] / d, r.site[:, 3:]]
    return max(float(np.abs(part).max()) for part in parts)


def test_newton_converges_quadratically() -> None:
    """Independent check: of the last three residuals above round-off, from a step ten times as long, the logarithms
    double; with the first answer kept, as for a linear organ, they do not."""
    old = STEPS[-1].new
    dt = 10 * DT
    problem = dynamic_problem(SYSTEM, old, dt, organ_answer(SYSTEM, BackwardEuler(dt), old))
    seen: list[float] = []

    def watched(problem: Problem[Array], z: Iterate, r: Residual) -> tuple[Problem[Array], Iterate]:
        seen.append(size(problem, r))
        return correct(problem, z, r)

    solve(problem, predict(problem, old), watched)
    e = [x for x in seen if x > 1e-10][-3:]
    assert len(e) == 3 and e[0] < 0.3
    assert np.log(e[2] / e[1]) / np.log(e[1] / e[0]) > 1.7
