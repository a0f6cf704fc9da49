"""Assembly some cells at a time, or by compiled loops, gives the matrices of all cells at once."""

from importlib import import_module

import numpy as np
import pytest
from skfem import MeshTet

import tissue
from tests.bounds import IDENTITY

ELASTICITY = "tissue.elasticity"


def bodies(element: str, dilatation: str, monkeypatch: pytest.MonkeyPatch, **changed: int) -> list[tissue.Elasticity]:
    """Return a body of material that differs from cell to cell, as it is assembled and with constants changed."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 0.02, n) ** 1.2 for n in (4, 3, 3)))
    E, nu, rho = np.random.default_rng(0).uniform([[1e4], [0.1], [1e3]], [[1e5], [0.4], [2e3]], (3, mesh.nelements))
    material = tissue.Material(E, nu, rho)
    out = [tissue.elasticity(mesh, material, element, (), dilatation)]
    for name, value in changed.items():
        monkeypatch.setattr(import_module(ELASTICITY), name, value)
    return [*out, tissue.elasticity(mesh, material, element, (), dilatation)]


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_parts_make_the_whole(element: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check, with material that differs from cell to cell."""
    local = {"P1": 12, "P2": 30}[element]
    whole, apart = bodies(element, "auto", monkeypatch, ENTRIES=5 * local**2)
    for one, other in ((whole.K, apart.K), (whole.M, apart.M)):
        assert abs(one - other).max() <= IDENTITY * abs(one).max()


@pytest.mark.parametrize("dilatation", ["cell", "nodal"])
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_loops_agree_with_forms(element: str, dilatation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: compiled loops against scikit-fem's forms; with nodal dilatation half the cells have an excess
    of λ and half have none."""
    forms, loops = bodies(element, dilatation, monkeypatch, COMPILED_BEYOND=0)
    assert np.array_equal(forms.clamped, loops.clamped)
    pairs = [(forms.K, loops.K), (forms.M, loops.M)]
    if dilatation == "nodal":
        assert forms.pressure is not None and loops.pressure is not None
        pairs.append((forms.pressure, loops.pressure))
    for one, other in pairs:
        assert abs(one - other).max() <= IDENTITY * abs(one).max()
