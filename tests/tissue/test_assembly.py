"""Assembly some cells at a time, or by compiled loops, gives the matrices of all cells at once."""

from importlib import import_module

import numpy as np
import pytest
from skfem import Basis, BilinearForm, LinearForm, MeshTet
from skfem.helpers import div

import tissue
from tests.bounds import IDENTITY
from tissue.elasticity import cellwise_lambda

ELASTICITY = "tissue.elasticity"


def bodies(element: str, dilatation: str, monkeypatch: pytest.MonkeyPatch, **changed: int) -> list[tissue.Elasticity]:
    """Return a body of material that differs from cell to cell, as it is assembled and with constants changed."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 0.02, n) ** 1.2 for n in (4, 3, 3)))
    E, nu, rho = np.random.default_rng(0).uniform([[1e4], [0.1], [1e3]], [[1e5], [0.49], [2e3]], (3, mesh.nelements))
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


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_loops_agree_with_forms(element: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: compiled loops against scikit-fem's forms."""
    forms, loops = bodies(element, "cell", monkeypatch, COMPILED_BEYOND=0)
    assert np.array_equal(forms.clamped, loops.clamped)
    for one, other in ((forms.K, loops.K), (forms.M, loops.M)):
        assert abs(one - other).max() <= IDENTITY * abs(one).max()


@pytest.mark.parametrize(("element", "dilatation"), [("P1", "nodal"), ("P2", "nodal"), ("P2", "mean")])
def test_averaged_dilatations_agree_with_forms(element: str, dilatation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: ∫ ψ div φ and ∫ ψ/λ̄ against scikit-fem's forms; half the cells have an excess λ̄ of λ."""
    body, _ = bodies(element, dilatation, monkeypatch)
    excess = np.asarray(body.material.lame_lambda - cellwise_lambda(body.material, dilatation))
    stiff = excess > 0.0
    assert 0 < stiff.sum() < stiff.size
    exact = Basis(body.mesh, body.basis.elem, intorder=2)
    averages = exact.with_element(body.averages[1])
    D = BilinearForm(lambda u, q, w: w.on * div(u) * q).assemble(exact, averages, on=stiff[:, None].astype(float))
    soft = np.divide(1.0, excess, out=np.zeros(excess.size), where=stiff)[:, None]
    S = LinearForm(lambda q, w: w.soft * q).assemble(averages, soft=soft)
    expected = np.divide(1.0, S, out=np.zeros(S.size), where=S > 0.0)[:, None] * D.toarray()
    assert body.pressure is not None
    assert np.abs(body.pressure.toarray() - expected).max() <= IDENTITY * np.abs(expected).max()
