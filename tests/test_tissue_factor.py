"""Factorisation: orderings agree, residuals are kept, and what is not positive definite is refused."""

import numpy as np
import pytest
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu
from skfem import MeshTet

import tissue
from tissue.factor import dissection, ordering


def block(clamp: tuple[str, ...]) -> tissue.Elasticity:
    lines = [np.linspace(0.0, s, n) for s, n in ((0.06, 10), (0.04, 8), (0.02, 6))]
    mesh = MeshTet.init_tensor(*lines).with_boundaries({"bottom": lambda x: x[2] < 1e-9})
    return tissue.elasticity(mesh, tissue.Material(1.0e5, 0.45, 1070.0), "P1", clamp)


def test_both_orderings_give_the_same_answer_as_a_dense_solve() -> None:
    body = block(("bottom",))
    A = body.K[body.free][:, body.free]
    b = np.random.default_rng(0).standard_normal((A.shape[0], 3))
    dense = np.linalg.solve(A.toarray(), b)
    for places in (None, body.basis.doflocs[:, body.free].T):
        x = tissue.factorize(A, places).solve(b)
        assert np.abs(x - dense).max() <= 1e-8 * np.abs(dense).max()
        assert np.array_equal(tissue.factorize(A, places).solve(b), x)


def test_ordering_is_a_permutation_that_leaves_less_fill_than_none() -> None:
    body = block(())
    order = ordering(body.K, body.basis.doflocs.T)
    assert np.array_equal(np.sort(order), np.arange(body.N))
    A = csr_matrix(body.K + 1e6 * body.M)
    natural = splu(csc_matrix(A), permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    assert tissue.factorize(A, body.basis.doflocs.T).entries < 0.7 * natural.nnz / 2
    assert tissue.factorize(A, body.basis.doflocs.T).entries <= 1.05 * tissue.factorize(A).entries


def test_dissection_separates() -> None:
    """In a chain the last number goes to the one node between the halves."""
    chain = csr_matrix(diags([-np.ones(40), 2.0 * np.ones(41), -np.ones(40)], [-1, 0, 1]))
    order = dissection(chain, np.column_stack([np.arange(41.0), np.zeros((41, 2))]))
    assert 15 < order[-1] < 25


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
def test_what_is_not_positive_definite_is_refused(A: np.ndarray, words: str) -> None:
    with pytest.raises(tissue.FactorError, match=words):
        tissue.factorize(csr_matrix(A))


def test_a_body_that_is_not_held_is_singular() -> None:
    body = block(())
    with pytest.raises(tissue.FactorError, match="singular"):
        tissue.factorize(body.K, body.basis.doflocs.T)


def test_unknown_method_is_refused() -> None:
    with pytest.raises(tissue.FactorError, match="'superlu' and 'cholmod'"):
        tissue.factorize(csr_matrix(np.eye(2)), method="magic")


def test_a_solve_that_misses_its_residual_is_an_error() -> None:
    factor = tissue.factorize(csr_matrix(np.diag([1.0, 2.0])))
    wrong = tissue.Factor(factor.A, factor.norm, factor.entries, lambda b: 1.0001 * factor.back_substitute(b))
    assert factor.solve(np.ones(2)) == pytest.approx([1.0, 0.5], rel=1e-15)
    with pytest.raises(tissue.FactorError, match="allowed is 1e-10"):
        wrong.solve(np.ones(2))
    with pytest.raises(tissue.FactorError):
        factor.solve(np.array([np.nan, 1.0]))
