"""Factorisation: orderings agree, residuals are kept, and what is not positive definite is refused."""

import numpy as np
import pytest
from scipy.sparse import csc_matrix, csr_matrix, diags, identity, triu
from scipy.sparse.linalg import splu
from skfem import MeshTet

import tissue
from tests.bounds import TWO_SOLVERS
from tissue.solvers import direct
from tissue.solvers.direct import LIBRARIES, Pattern, is_installed, ordering
from tissue.solvers.factor import METHODS, Factor, factorize_indefinite
from tissue.solvers.ordering import dissection, node_graph

DIRECT = [
    pytest.param(
        method,
        marks=pytest.mark.skipif(
            not is_installed(method), reason=f"{method} needs {LIBRARIES[method]}: not installed here"
        ),
    )
    for method in METHODS
]


def block(clamp: tuple[str, ...], element: str = "P1") -> tissue.Elasticity:
    lines = [np.linspace(0.0, s, n) for s, n in ((0.06, 10), (0.04, 8), (0.02, 6))]
    mesh = MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: x[2] < 1e-9})
    return tissue.elasticity(mesh, tissue.Material(1.0e5, 0.45, 1070.0), element, clamp)


@pytest.mark.parametrize("method", DIRECT)
def test_every_direct_solver_gives_the_answer_of_a_dense_solve(method: str) -> None:
    """Consistency check: with and without the places of the unknowns, one right-hand side and several."""
    body = block(("bottom",))
    A = csr_matrix(body.K[body.free][:, body.free])
    b = np.random.default_rng(0).standard_normal((A.shape[0], 3))
    dense = np.linalg.solve(A.toarray(), b)
    for places in (None, body.basis.doflocs[:, body.free].T):
        factor = tissue.factorize(A, places, method)
        x = factor.solve(b)
        assert np.abs(x - dense).max() <= TWO_SOLVERS * np.abs(dense).max()
        assert np.abs(factor.solve(b[:, 1]) - dense[:, 1]).max() <= TWO_SOLVERS * np.abs(dense).max()
        assert np.array_equal(tissue.factorize(A, places, method).solve(b), x)


@pytest.mark.parametrize("method", DIRECT)
def test_columns_are_solved_together_as_one_by_one(method: str) -> None:
    """Consistency check: more columns than are taken at once, of few entries, of none and of all; no column at all."""
    body = block(("bottom",))
    A, rng = csr_matrix(body.K[body.free][:, body.free]), np.random.default_rng(0)
    b = np.zeros((A.shape[0], 2 * direct.COLUMNS + 1))
    for column in range(1, b.shape[1]):
        b[rng.choice(len(b), 20), column] = rng.standard_normal(20)
    b[:, -1] = rng.standard_normal(len(b))
    factor = tissue.factorize(A, None, method)
    alone = np.column_stack([factor.solve(column) for column in b.T])
    assert np.abs(factor.solve(b) - alone).max() <= TWO_SOLVERS * np.abs(alone).max()
    assert not factor.solve(0.0 * b).any()
    assert factor.solve(b[:, :0]).shape == (len(b), 0)


@pytest.mark.parametrize("method", DIRECT)
def test_what_matrices_of_one_pattern_share_is_theirs_alone(method: str) -> None:
    """Consistency check: tangents one after another, with other numbers and with other entries, each as if alone; an
    earlier factor goes on solving its own."""
    body, pattern = block(("bottom",)), Pattern()
    A, places = csr_matrix(body.K[body.free][:, body.free]), body.basis.doflocs[:, body.free].T
    b = np.random.default_rng(0).standard_normal((A.shape[0], 3))
    grown = csr_matrix(A + 1e-2 * diags(A.diagonal() * np.linspace(0.0, 1.0, A.shape[0])))
    bare = csr_matrix(diags(A.diagonal()))
    made = [tissue.factorize(each, places, method, True, pattern) for each in (A, grown, bare, A)]
    for factor in made:
        alone = np.linalg.solve(factor.A.toarray(), b)
        assert np.abs(factor.solve(b) - alone).max() <= TWO_SOLVERS * np.abs(alone).max()


def test_parts_of_a_pattern_do_not_displace_one_another() -> None:
    """Identity: definite and indefinite tangents alternate near a limit point, and each part is found once."""
    body, pattern, found = block(("bottom",)), Pattern(), []
    A = csr_matrix(body.K[body.free][:, body.free])
    for _ in range(2):
        for what, of in (("whole", A), ("upper", csr_matrix(triu(A)))):
            pattern.once(what, of, lambda: found.append(0))
    assert len(found) == 2


def test_what_is_not_definite_is_solved_by_exchanges() -> None:
    """Consistency check: against a dense solve."""
    body = block(("bottom",))
    A = csr_matrix(body.K[body.free][:, body.free])
    A = csr_matrix(A - 0.1 * A.diagonal().mean() * identity(A.shape[0]))
    values = np.linalg.eigvalsh(A.toarray())
    assert values[0] < 0.0 < values[-1]
    b = np.random.default_rng(0).standard_normal((A.shape[0], 3))
    dense = np.linalg.solve(A.toarray(), b)
    assert np.abs(factorize_indefinite(A).solve(b) - dense).max() <= TWO_SOLVERS * np.abs(dense).max()


def lower_entries(graph: csr_matrix, order: np.ndarray) -> int:
    """Entries of the Cholesky factor of a graph, the diagonal included, counted by SuperLU."""
    matrix = csc_matrix(-abs(graph[order][:, order]) + 1e3 * identity(graph.shape[0]))
    lu = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return int((lu.nnz + graph.shape[0]) // 2)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_dissection_leaves_less_fill_than_none_and_counts_it(element: str) -> None:
    """Independent check: the count of entries against SuperLU's own, which amalgamates columns: 20 %."""
    body = block((), element)
    graph, points, node = node_graph(body.K, body.basis.doflocs.T)
    plan = dissection(graph, points)
    assert np.array_equal(np.sort(plan.order), np.arange(len(points)))
    assert np.array_equal(points[node], body.basis.doflocs.T)
    counted = lower_entries(graph, plan.order)
    assert plan.entries == pytest.approx(counted, rel=0.2)
    assert counted < 0.7 * lower_entries(graph, np.lexsort(points.T))  # layer by layer


def test_the_ordering_taken_is_the_better_of_two() -> None:
    body = block(())
    order = ordering(body.K, body.basis.doflocs.T)
    assert np.array_equal(np.sort(order), np.arange(body.N))
    graph, points, node = node_graph(body.K, body.basis.doflocs.T)
    taken = np.array(list(dict.fromkeys(node[order])))
    assert lower_entries(graph, taken) <= lower_entries(graph, dissection(graph, points).order)


def test_dissection_separates() -> None:
    """In a chain the last number goes to the one node between the halves."""
    chain = csr_matrix(diags([-np.ones(40), 2.0 * np.ones(41), -np.ones(40)], [-1, 0, 1]))
    order = dissection(chain, np.column_stack([np.arange(41.0), np.zeros((41, 2))])).order
    assert 15 < order[-1] < 25


@pytest.mark.parametrize("method", DIRECT)
@pytest.mark.parametrize(
    ("A", "words"),
    [
        (np.array([[1.0, 2.0], [2.0, 1.0]]), "not positive definite"),
        (np.array([[1.0, 0.0], [0.0, -1.0]]), "not positive definite"),
        (np.array([[1.0, 1.0], [1.0, 1.0]]), "singular"),
        (np.array([[2.0, 1.0], [0.0, 2.0]]), "not symmetric"),
        (np.ones((2, 3)), "shape"),
        (np.array([[np.nan, 0.0], [0.0, 1.0]]), "not"),
    ],
)
def test_what_is_not_positive_definite_is_refused(A: np.ndarray, words: str, method: str) -> None:
    with pytest.raises(tissue.FactorError, match=words):
        tissue.factorize(csr_matrix(A), method=method)


@pytest.mark.parametrize("method", DIRECT)
def test_a_body_that_is_not_held_is_singular(method: str) -> None:
    body = block(())
    with pytest.raises(tissue.FactorError, match="singular"):
        tissue.factorize(body.K, body.basis.doflocs.T, method)


def test_unknown_method_is_refused() -> None:
    with pytest.raises(tissue.FactorError, match="'superlu', 'cholmod', 'pardiso'"):
        tissue.factorize(csr_matrix(np.eye(2)), method="magic")


def test_a_solve_that_misses_its_residual_is_an_error() -> None:
    factor = tissue.factorize(csr_matrix(np.diag([1.0, 2.0])))
    wrong = Factor(factor.A, factor.norm, lambda b: 1.0001 * factor.back_substitute(b))
    assert factor.solve(np.ones(2)) == pytest.approx([1.0, 0.5], rel=1e-15)
    with pytest.raises(tissue.FactorError, match="allowed is 1e-10"):
        wrong.solve(np.ones(2))
    with pytest.raises(tissue.FactorError):
        factor.solve(np.array([np.nan, 1.0]))
