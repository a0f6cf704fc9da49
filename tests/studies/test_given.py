"""Laws that are handed over from Python: the same law as a scenario has gives the same run, another does what it says,
and what does not fit is refused in words."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skfem
import tensortrax.math as tm
from scipy.sparse import csr_matrix
from skfem.helpers import ddot, sym_grad, trace

import suturefem
from coupling.errors import CouplingError
from studies.output.records import StepRecord
from studies.scenario import ScenarioError, parse
from studies.scenario.toml import changed
from studies.simulation.remarks import rubs
from tests.bounds import TWO_SOLVERS
from tests.coupling.test_friction_own import Coulomb, Howell
from tests.studies.test_sweep import ORGAN, RING

UP = {
    "thread.path": [[-0.02, 0.0, 0.003], [0.0, 0.0, 0.0], [0.02, 0.0, 0.003]],
    "thread.start.force": [-0.05, 0.0, 0.0075],
    "thread.start.ramp": 1e-3,
    "thread.end.waypoints": [[0.0, 0.02, 0.0, 0.003], [0.1, 0.031, 0.0, 0.003]],
    "thread.damping": 200.0,
    "solve.duration": 4e-3,
}
BENT = changed(RING, UP)  # drawn up out of the hole on both sides, so that it presses on it
BARE = changed(ORGAN, UP)
FITTED = changed(ORGAN, {"tissue.mesh.accuracy": 0.1})
FINITE = changed(BARE, {"tissue.material": "neo-hookean"})
MU = 1e5 / 2.6


def last(data: dict[str, Any], **handed: Any) -> StepRecord:
    """The last step of a scenario given as tables."""
    return [*suturefem.prepare(parse(data), **handed).advance()][-1][0]


@dataclass(frozen=True)
class Form:
    """The stiffness of E and ν by forms of one's own."""

    E: float = 1e5
    nu: float = 0.3

    def __call__(self, basis: skfem.Basis) -> csr_matrix:
        lam, mu = self.E * self.nu / (1 + self.nu) / (1 - 2 * self.nu), self.E / 2 / (1 + self.nu)

        @skfem.BilinearForm
        def energy(u: Any, v: Any, w: Any) -> Any:
            e, d = sym_grad(u), sym_grad(v)
            return lam * trace(e) * trace(d) + 2 * mu * ddot(e, d)

        return csr_matrix(energy.assemble(basis))


def neo_hookean(F: Any) -> Any:
    """W of the scenario's neo-Hookean solid."""
    return 0.5 * MU * (tm.trace(F.T @ F) * tm.linalg.det(F) ** (-2 / 3) - 3)


def assert_same(one: StepRecord, other: StepRecord) -> None:
    """The forces and places of two steps are the same to what two solvers leave."""
    for a, b in zip(one.piercings, other.piercings, strict=True):
        scale = np.linalg.norm(a.force), np.linalg.norm(a.displacement)
        np.testing.assert_allclose(b.force, a.force, rtol=0.0, atol=TWO_SOLVERS * scale[0])
        np.testing.assert_allclose(b.displacement, a.displacement, rtol=0.0, atol=TWO_SOLVERS * scale[1])


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_stiffness_of_one_s_own(element: str) -> None:
    """Consistency check: that of the scenario's own E and ν gives the scenario's run, also on a mesh from Python; that
    of twice E gives the run of twice E."""
    data = changed(BARE, {"tissue.element": element})
    made = last(data)
    assert_same(made, last(data, stiffness=Form()))
    mesh = suturefem.prepare(parse(data)).assembly.body.mesh  # type: ignore[union-attr]
    assert_same(made, last(data, mesh=mesh, stiffness=Form()))
    firm = last(data, mesh=mesh, stiffness=Form(E=2e5))
    assert_same(last(changed(data, {"tissue.youngs_modulus": 2e5})), firm)
    assert np.linalg.norm(firm.piercings[0].displacement) < 0.7 * np.linalg.norm(made.piercings[0].displacement)


def test_a_law_of_friction_of_one_s_own() -> None:
    """Consistency check: Coulomb's law by hand gives the run of its coefficients, beside a grip of the scenario's; a
    power law that a small force makes steeper holds more."""
    rough = changed(BENT, {"piercing.0.friction": {"static": 0.12, "kinetic": 0.1, "grip": 2e-3}})
    grip = changed(BENT, {"piercing.0.friction": {"static": 0.0, "kinetic": 0.0, "grip": 2e-3}})
    made = last(rough)
    assert made.piercings[0].state == "slip"
    assert_same(made, last(grip, friction={"ring": Coulomb(0.12, 0.1)}))
    law, stays = Howell(a=0.5), changed(BENT, {"thread.knots": "fixed"})
    held = last(stays, friction={"ring": law}).piercings[0]
    bound = law.static(held.normal_force) if held.state == "stick" else law.kinetic(held.normal_force)
    if held.state == "slip":
        assert abs(held.tangential_force) == pytest.approx(bound, rel=1e-6)
    assert abs(held.tangential_force) <= bound * (1 + 1e-6)
    assert abs(last(stays).piercings[0].slip) > abs(held.slip)


def test_an_energy_of_one_s_own() -> None:
    """Consistency check: the scenario's neo-Hookean solid as a function of F gives the scenario's run, and the remark
    tells its shear modulus; a stiffer one gives way less."""
    made = last(FINITE)
    simulation = suturefem.prepare(parse(FINITE), energy=neo_hookean)
    assert_same(made, [*simulation.advance()][-1][0])
    [said] = [remark for remark in simulation.foreseen if remark.code == "handed-over"]
    assert f"{MU:.4g} to {MU:.4g} Pa" in said.message
    principal = last(
        FINITE, energy=lambda F: 0.5 * MU * (tm.sum(tm.linalg.eigvalsh(F.T @ F)) * tm.linalg.det(F) ** (-2 / 3) - 3)
    )
    assert_same(made, principal)
    firm = last(FINITE, energy=lambda F: 3.0 * neo_hookean(F))
    assert np.linalg.norm(firm.piercings[0].displacement) < 0.7 * np.linalg.norm(made.piercings[0].displacement)


def test_a_prepared_run_into_a_folder(tmp_path: Path) -> None:
    """Consistency check: the folder has the numbers of the run and says what came from Python; each step is told once,
    after it was recorded; the run cannot go on."""
    told: list[int] = []
    simulation = suturefem.prepare(parse(BARE), stiffness=Form(), on_step=lambda step: told.append(step.step))
    run = suturefem.run(simulation, tmp_path)
    assert told == [0, 1, 2]
    assert [remark["code"] for remark in run.remarks if "Python" in remark["message"]] == ["handed-over"]
    assert "stress-of-e-nu" in {remark["code"] for remark in run.remarks}
    for again, words in (
        ({"resume": True}, "contains the stiffness of the run"),
        ({"mesh": object()}, "prepared simulation has a mesh"),
    ):
        with pytest.raises(ScenarioError, match=words):
            suturefem.run(simulation, tmp_path, **again)
    assert suturefem.run(simulation, tmp_path, overwrite=True).quantities == run.quantities


def test_friction_of_one_s_own_is_known_to_the_remarks() -> None:
    """Independent check: by the same law the scenario and Python give a run whose end depends on the way there."""
    said = changed(RING, {"piercing.0.friction": {"static": 0.2, "kinetic": 0.2}})
    for rough, data, handed in ((False, RING, {}), (True, said, {}), (True, RING, {"friction": {"ring": Howell()}})):
        assert rubs(suturefem.prepare(parse(data), **handed).assembly) == rough


@pytest.mark.parametrize(
    ("data", "handed", "words"),
    [
        (RING, {"stiffness": Form()}, "has no organ; add"),
        (BARE, {"stiffness": csr_matrix((3, 3))}, "give a function of a skfem.Basis"),
        (BARE, {"stiffness": lambda basis: csr_matrix((3, 3))}, "three unknowns at each of the 75 nodes"),
        (BARE, {"stiffness": lambda basis: Form()(basis).toarray()}, "a ndarray of shape"),
        (BARE, {"stiffness": lambda basis: 0.0 * Form()(basis)}, "no resistance"),
        (BARE, {"stiffness": lambda basis: np.nan * Form()(basis)}, "numbers that are not finite"),
        (BARE, {"stiffness": lambda basis: csr_matrix(np.triu(Form()(basis).toarray()))}, "not symmetric"),
        (FITTED, {"stiffness": Form()}, "tissue.mesh.accuracy = 0.1 is refused.*set \"given\""),
        (FINITE, {"stiffness": Form()}, "tissue.material = .neo-hookean. is refused"),
        (BARE, {"energy": neo_hookean}, "tissue.material = .linear. is refused.*neo-hookean"),
        (changed(FINITE, {"tissue.material": "exponential", "tissue.stiffening": 5.0}), {"energy": neo_hookean},
         "tissue.stiffening is refused"),
        (FINITE, {"energy": lambda F: tm.trace(F.T @ F)}, "has a stress of"),
        (FINITE, {"energy": lambda F: 1e5 * ((F[0, 0] - 1) ** 2 + (F[1, 1] - 1) ** 2)}, "a pure rotation changes W"),
        (RING, {"friction": {"rink": Howell()}}, "no such piercing; the nearest is 'ring'"),
        (changed(RING, {"piercing.0.kind": "anchored"}), {"friction": {"ring": Howell()}}, "nothing slides there"),
        (changed(RING, {"thread.bending": False}), {"friction": {"ring": Howell()}}, "thread.bending = false"),
        (changed(RING, {"solve.scheme": "linear"}), {"friction": {"ring": Howell()}}, "solve.scheme = .linear."),
        (changed(RING, {"solve.friction": "two-pass", "solve.integrator": "euler"}), {"friction": {"ring": Howell()}},
         "solve.friction = .two-pass."),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(data: dict[str, Any], handed: dict[str, Any], words: str) -> None:
    """Independent check: each in words, with what is to be done, before a step is made."""
    with pytest.raises(ScenarioError, match=words):
        suturefem.prepare(parse(data), **handed)
    with pytest.raises(CouplingError, match="Howell"):
        suturefem.prepare(parse(RING), friction={"ring": Howell(held=0.5)})
