"""Assembly some cells at a time gives the matrices of all cells at once."""

from importlib import import_module

import numpy as np
import pytest
from skfem import MeshTet

import tissue
from tests.bounds import IDENTITY


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_parts_make_the_whole(element: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check, with material that differs from cell to cell."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 0.02, n) for n in (4, 3, 3)))
    E, nu, rho = np.random.default_rng(0).uniform([[1e4], [0.1], [1e3]], [[1e5], [0.4], [2e3]], (3, mesh.nelements))
    whole = tissue.elasticity(mesh, tissue.Material(E, nu, rho), element)
    monkeypatch.setattr(import_module("tissue.elasticity"), "ENTRIES", 5 * whole.basis.Nbfun**2)
    apart = tissue.elasticity(mesh, tissue.Material(E, nu, rho), element)
    for one, other in ((whole.K, apart.K), (whole.M, apart.M)):
        assert abs(one - other).max() <= IDENTITY * abs(one).max()
