"""The assembled matrices against scikit-fem's forms."""

from typing import Any

import numpy as np
import pytest
from skfem import Basis, BilinearForm, LinearForm, MeshTet
from skfem.helpers import ddot, div, dot, sym_grad

import tissue
from tests.bounds import IDENTITY
from tissue.elasticity import cellwise_lambda


def body_of(element: str, dilatation: str) -> tissue.Elasticity:
    """Return a body of material that differs from cell to cell."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 0.02, n) ** 1.2 for n in (4, 3, 3)))
    E, nu, rho = np.random.default_rng(0).uniform([[1e4], [0.1], [1e3]], [[1e5], [0.49], [2e3]], (3, mesh.nelements))
    return tissue.elasticity(mesh, tissue.Material(E, nu, rho), element, (), dilatation)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_stiffness_and_mass_agree_with_forms(element: str) -> None:
    """Independent check: both matrices by scikit-fem's forms, with a rule that is exact for each."""
    body = body_of(element, "cell")
    given = {name: np.asarray(getattr(body.material, name))[:, None] for name in ("lame_lambda", "lame_mu", "density")}

    def energy(u: Any, v: Any, w: Any) -> Any:
        return w.lame_lambda * div(u) * div(v) + 2.0 * w.lame_mu * ddot(sym_grad(u), sym_grad(v))

    exact = Basis(body.mesh, body.basis.elem, intorder=4)
    for matrix, form in ((body.K, energy), (body.M, lambda u, v, w: w.density * dot(u, v))):
        expected = BilinearForm(form).assemble(exact, **given)
        assert abs(matrix - expected).max() <= IDENTITY * abs(expected).max()


@pytest.mark.parametrize(("element", "dilatation"), [("P1", "nodal"), ("P2", "nodal"), ("P2", "mean")])
def test_averaged_dilatations_agree_with_forms(element: str, dilatation: str) -> None:
    """Consistency check: ∫ ψ div φ and ∫ ψ/λ̄ against scikit-fem's forms; half the cells have an excess λ̄ of λ."""
    body = body_of(element, dilatation)
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
