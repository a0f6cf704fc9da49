"""Conjugate gradients and multigrid: the direct solver's answers, work that grows no faster than the mesh, failures."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import bsr_matrix, csr_matrix
from skfem import MeshTet

import tissue
from coupling.integrators import Equilibrium
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tissue.organs.meshed import compliance
from tissue.solvers import iterative
from tissue.solvers.iterative import ConjugateGradients
from tissue.solvers.multigrid import Blocks, multigrid, rigid_motions
from tissue.solvers.passes import product_by_rows

Array = NDArray[np.float64]
DT = 1.0e-3
SINGLE = 1e-6  # of the size of a sum: a dozen roundings of 6e-8
HOLES = [tissue.Site((x, 0.02, 0.02), 3.0e-3, direction="normal") for x in (0.025, 0.035)]
GROWTH = 1.5  # of the iterations while h falls to a quarter: without multigrid they grow like 1/h, fourfold


def body_of(cells: int, element: str = "P1", nu: float = 0.45) -> tissue.Elasticity:
    """A block of 3 : 2 : 1, `cells` along its shortest side."""
    lines = [np.linspace(0.0, 0.02 * side, side * cells + 1) for side in (3, 2, 1)]
    named = {"bottom": lambda x: x[2] < 1e-9, "right": lambda x: x[0] > 0.06 - 1e-9}
    mesh = MeshTet.init_tensor(*lines).with_boundaries(named)
    return tissue.elasticity(mesh, tissue.Material(1.0e5, nu, 1070.0), element, ("bottom",))


def system_of(body: tissue.Elasticity, a: float = 0.0) -> tuple[csr_matrix, Array]:
    """a M + K over the free unknowns, and their places."""
    free = body.free
    return csr_matrix((body.K + a * body.M)[free][:, free]), body.basis.doflocs[:, free].T


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize("a", [0.0, 1.0 / DT**2])
def test_conjugate_gradients_give_the_direct_answer(element: str, a: float) -> None:
    """Consistency check of two solvers, one column and more than fit side by side."""
    A, places = system_of(body_of(6 if element == "P1" else 3, element), a)
    b = np.random.default_rng(1).standard_normal((A.shape[0], iterative.COLUMNS + 2))
    exact = tissue.factorize(A, places).solve(b)
    solver = tissue.conjugate_gradients(A, places)
    x = solver.solve(b)
    assert np.abs(x - exact).max() <= TWO_SOLVERS * np.abs(exact).max()
    assert np.linalg.norm(A @ x - b) <= RESIDUAL * np.linalg.norm(b)
    assert np.abs(solver.solve(b[:, 0]) - exact[:, 0]).max() <= TWO_SOLVERS * np.abs(exact).max()
    assert np.array_equal(tissue.conjugate_gradients(A, places).solve(b), x)


def test_iterations_do_not_grow_with_the_mesh() -> None:
    """Independent check: with the rigid motions in the coarse spaces the work per unknown is bounded. 600 to 33 000
    unknowns.
    """
    counts = []
    for cells in (3, 6, 12):
        A, places = system_of(body_of(cells))
        b = np.random.default_rng(1).standard_normal(A.shape[0])
        counts.append(tissue.conjugate_gradients(A, places).iterate(b)[1])
    assert max(counts) <= GROWTH * counts[0]


def test_conjugate_directions_end_with_the_eigenvalues() -> None:
    """Independent check: without a preconditioner there are no more iterations than distinct eigenvalues (Golub and Van
    Loan, Matrix Computations, 11.3), for each of several columns; steepest descent would take hundreds."""
    eigenvalues = np.array([1.0, 3.0, 10.0, 30.0, 100.0])
    A = csr_matrix(np.diag(np.repeat(eigenvalues, 20)))
    b = np.random.default_rng(8).standard_normal((A.shape[0], 3))
    x, count = ConjugateGradients(A, eigenvalues[-1], lambda r: r).iterate(b)
    assert count == eigenvalues.size
    assert np.abs(A @ x - b).max() <= RESIDUAL * np.abs(b).max()


def test_the_cycle_is_symmetric_and_positive() -> None:
    """Independent check: what conjugate gradients require of a preconditioner, to single precision."""
    A, places = system_of(body_of(6))
    cycle = multigrid(A, places)
    x, y = np.random.default_rng(2).standard_normal((2, A.shape[0]))
    scale = np.sqrt((x @ cycle(x)) * (y @ cycle(y)))
    assert abs(y @ cycle(x) - x @ cycle(y)) <= 1e-5 * scale
    assert x @ cycle(x) > 0.0
    together = cycle(np.column_stack([x, y]))
    assert np.abs(together[:, 1] - cycle(y)).max() <= 1e-5 * np.abs(together).max()


@pytest.mark.parametrize("block", [(3, 3), (3, 6), (6, 3), (6, 6)])
@pytest.mark.parametrize("columns", [1, 2, 9])
def test_a_product_in_blocks_is_that_of_the_matrix(columns: int, block: tuple[int, int]) -> None:
    """Consistency check: of a matrix that is not square, with rows of blocks that are empty, to single precision."""
    rng = np.random.default_rng(6)
    pattern = rng.random((7, 5)) < 0.4
    pattern[2] = False
    whole = np.kron(pattern, np.ones(block))
    A = (whole * rng.standard_normal(whole.shape)).astype(np.float32)
    x = rng.standard_normal((A.shape[1], columns)).astype(np.float32)
    got, size = Blocks(bsr_matrix(A, blocksize=block)) @ x, np.abs(A) @ np.abs(x)
    assert not whole.any(axis=1).all()
    assert np.all(np.abs(got - A @ x) <= SINGLE * size)


@pytest.mark.parametrize("columns", [2, 9])
def test_a_product_by_rows_is_that_of_the_matrix(columns: int) -> None:
    """Consistency check: of rows of none to eight entries, which are added four at a time and what is left one by
    one."""
    rng = np.random.default_rng(7)
    pattern = np.arange(8) < np.arange(9)[:, None]
    A, x = pattern * rng.standard_normal(pattern.shape), rng.standard_normal((8, columns))
    own, got = csr_matrix(A), np.full((9, columns), np.nan)
    product_by_rows(own.indptr, own.indices, own.data, x, got)
    assert np.all(np.abs(got - A @ x) <= IDENTITY * (np.abs(A) @ np.abs(x)))


def test_columns_too_large_to_be_kept_have_the_same_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: of products into fields that are used again, and of those that scipy makes."""
    A, places = system_of(body_of(4))
    b, solver = np.random.default_rng(10).standard_normal((A.shape[0], 3)), tissue.conjugate_gradients(A, places)
    x, count = solver.iterate(b)
    monkeypatch.setattr(iterative, "KEPT", 0)
    again, as_many = solver.iterate(b)
    assert as_many == count
    assert np.abs(again - x).max() <= TWO_SOLVERS * np.abs(x).max()


def test_a_cycle_forgets_the_one_before() -> None:
    """Consistency check: the fields that cycles share carry nothing over, and what one has returned stays."""
    A, places = system_of(body_of(6))
    cycle, (x, y) = multigrid(A, places), np.random.default_rng(9).standard_normal((2, A.shape[0], 3))
    first = cycle(x)
    kept = first.copy()
    cycle(y)
    assert np.array_equal(first, kept)
    assert np.array_equal(cycle(x), kept)


def test_rigid_motions_take_no_force() -> None:
    """Independent check: a body that is not held resists none of the six, and they are linearly independent."""
    body = body_of(3)
    motions = rigid_motions(body.basis.doflocs.T)
    size = abs(body.K) @ abs(motions)
    assert np.abs(body.K @ motions).max() <= 1e-12 * size.max()
    assert np.linalg.matrix_rank(motions) == 6


def test_a_good_guess_saves_work_and_changes_no_answer() -> None:
    A, places = system_of(body_of(6), 1.0 / DT**2)
    solver = tissue.conjugate_gradients(A, places)
    x = np.random.default_rng(3).standard_normal(A.shape[0])
    near = x + 1e-4 * np.random.default_rng(4).standard_normal(x.size)
    cold, warm = solver.iterate(A @ x)[1], solver.iterate(A @ x, near)[1]
    assert warm < cold - 5
    assert np.abs(solver.solve(A @ x, lambda: near) - x).max() <= TWO_SOLVERS * np.abs(x).max()
    assert solver.iterate(np.zeros_like(x)) == (pytest.approx(np.zeros_like(x)), 0)
    assert solver.iterate(A @ x, x)[1] <= 1


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_what_rough_columns_leave_of_a_compliance_is_of_second_order(
    tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Independent check: columns with an error E leave −EᵀA E of their compliance, the square of their error in energy;
    without the correction they leave as much as they miss themselves."""
    monkeypatch.setattr(iterative, "ROUGH", tolerance)
    body = body_of(6)
    A, places = system_of(body)
    Y = tissue.build_sites(body, HOLES).Y
    exact = tissue.factorize(A, places).solve(Y.T.toarray())
    W, C = compliance(tissue.conjugate_gradients(A, places), Y, rough=True)
    E, true = W - exact, Y @ exact
    left, size = E.T @ (A @ E), np.abs(true).max()
    assert 1e-3 * tolerance**2 * size <= np.abs(left).max() <= tolerance**2 * size
    assert np.abs(true - C - left).max() <= IDENTITY * size
    assert np.abs(Y @ W - true).max() >= 10.0 * np.abs(C - true).max()


def test_a_quasi_static_organ_takes_its_loads_to_second_order_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check of two solvers: sites under forces, weight and a load, and their energies, by columns a ten
    thousandth off."""
    monkeypatch.setattr(iterative, "ROUGH", 1e-4)
    body = body_of(6)
    sites = tissue.build_sites(body, HOLES)
    load = tissue.SurfaceLoad("right", (0.0, 20.0, -300.0))
    force, answers, energies = np.linspace(0.1, 0.2, 18), [], []
    for solver in ("superlu", "multigrid"):
        organ = tissue.QuasiStaticOrgan(body, sites, (0.5, 0.0, -9.81), solver=solver, loads=[load])
        answer = organ.answer(Equilibrium(), [organ.start()])
        answers.append(np.column_stack([answer.y_free - organ.y0, answer.C]))
        energies.append(organ.energies(organ.start(), answer.accept(force)))
    assert np.abs(answers[0] - answers[1]).max() <= TWO_SOLVERS * np.abs(answers[0]).max()
    assert energies[0].elastic > 0.0 and np.allclose(*energies, rtol=TWO_SOLVERS)


def test_a_mass_matrix_needs_no_levels() -> None:
    """Consistency check: by its diagonal alone."""
    body = body_of(5)
    M = csr_matrix(body.M)
    b = np.random.default_rng(5).standard_normal((body.N, 2))
    exact = tissue.factorize(M).solve(b)
    assert np.abs(tissue.conjugate_gradients(M).solve(b) - exact).max() <= TWO_SOLVERS * np.abs(exact).max()


def test_what_is_not_solved_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    A, places = system_of(body_of(4))
    b = np.random.default_rng(6).standard_normal(A.shape[0])
    solver = tissue.conjugate_gradients(A, places)
    with pytest.raises(tissue.FactorError, match="not positive definite"):
        ConjugateGradients(csr_matrix(-A), solver.norm, solver.preconditioner).solve(b)
    with pytest.raises(tissue.FactorError):
        solver.solve(np.full(b.size, np.nan))
    with pytest.raises(tissue.FactorError, match="not symmetric"):
        tissue.conjugate_gradients(csr_matrix(A + 1e-6 * np.abs(A).max() * csr_matrix(np.tri(A.shape[0]))), places)
    with pytest.raises(tissue.FactorError, match="three unknowns per node"):
        tissue.conjugate_gradients(A, places[::-1] + np.arange(A.shape[0])[:, None])
    monkeypatch.setattr(iterative, "ITERATIONS", 3)
    with pytest.raises(tissue.FactorError, match=r"after 3 iterations, allowed is 1e-11; take a direct solver"):
        solver.solve(b)


def test_a_residual_that_is_missed_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The contract is checked on A x − b itself, not on what the iteration believes of it."""
    A, places = system_of(body_of(4))
    solver = tissue.conjugate_gradients(A, places)
    wrong = ConjugateGradients(A, solver.norm, solver.preconditioner)
    monkeypatch.setattr(iterative, "TOLERANCE", 1e-5)
    with pytest.raises(tissue.FactorError, match="allowed is 1e-10"):
        wrong.solve(np.random.default_rng(7).standard_normal(A.shape[0]))
