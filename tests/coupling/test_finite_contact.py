"""Lips at finite strain that a thread draws together: the law of contact, two solves, the audit, a scene turned."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import skfem

import tissue
from coupling.joins.contact import observe_contact
from coupling.paper.assembled import Monolith, monolithic_solve
from coupling.reports.audit import audit_step, initial_energies
from coupling.rest.equilibrium import PAIRED
from coupling.run import begin
from coupling.step.stepping import Step
from coupling.system import State, System
from meshes.grading import Grading
from meshes.wound import Wound, lips, wounded_block_structured
from tests.bounds import IDENTITY
from tests.coupling.test_finite import TURNED, close, rotation
from tests.thread.threads import SITES, Array, last_by_newton, pulled_hairpin, taken
from tests.tissue.wounds import SIZE, opened
from tissue.materials.isotropic import Exponential

DT, STEPS, WIDTH = 2e-3, 6, 1e-3
PULL = np.array([-0.1, 0.02, 0.3])  # across the wound and up, harder on one side: a part of the lips meets
FIBRE = np.array([0.3, 0.1, 1.0])
STILL: Array = np.eye(3)
CASES: dict[str, tuple[str, bool, Any, float]] = {
    "slit quasi-static P1 fibre": ("P1", False, FIBRE, 0.0),
    "open dynamic P1": ("P1", True, "normal", WIDTH),
    "open quasi-static P2": ("P2", False, "normal", WIDTH),
}


@cache
def scene(name: str, turned: bool = False) -> tuple[System, State]:
    """The hairpin through both sides of a wound in stiffening tissue, held below; turned by 40° or not."""
    element, inertia, direction, width = CASES[name]
    R = rotation(40.0, np.array([1.0, 2.0, 0.0])) if turned else STILL
    wound, h = Wound(0.012, 5e-3), 1e-2 if element == "P2" else 3e-3
    closed = wounded_block_structured(SIZE, wound, Grading(h, h), SITES)
    mesh = opened(closed, width) if width else closed
    body = tissue.elasticity(
        skfem.MeshTet(R @ mesh.p, mesh.t, _boundaries=mesh.boundaries),
        tissue.Material(2e4, 0.45, 1070.0),
        element,
        ("bottom",),
    )
    along = direction if isinstance(direction, str) else R @ direction
    sites = tissue.build_sites(body, [tissue.Site(R @ p, 2e-3, "parabolic", along) for p in SITES])
    pairs = lips(closed, wound)
    gaps = tissue.build_gaps(body, pairs.nodes, pairs.facets[:, 0], R[:, 0])
    hyper = tissue.Hyperelasticity(body, Exponential(body.material.lame_mu, 3.0))
    organ = tissue.FiniteOrgan(body, sites, R @ (0, 0, -9.81), gaps=gaps, law=hyper, inertia=inertia)
    return pulled_hairpin(organ, PULL, STEPS * DT, R)


@cache
def steps(name: str) -> list[Step]:
    return taken(*scene(name), DT, STEPS)


@pytest.mark.parametrize("name", CASES)
def test_the_law_of_contact_at_every_step(name: str) -> None:
    """Independent check: lips do not cross, press and never pull, and press only where they touch; the tissue has
    turned and faces something else than at first."""
    system, start = scene(name)
    scale = max(WIDTH, float(np.abs(steps(name)[-1].new.organ.U).max()))
    pressed = []
    for state in [start, *(step.new for step in steps(name))]:
        seen = observe_contact(system, state)
        assert seen.gap.min() >= -IDENTITY * scale and seen.force.min() >= 0.0
        assert seen.complementarity <= IDENTITY * scale * seen.force.max(initial=0.0)
        pressed.append(seen.pressed)
    assert pressed[0] == 0 and pressed[-1] > 1
    assert steps(name)[-1].new.organ.facing is not None


@pytest.mark.parametrize("name", CASES)
def test_condensed_and_assembled_agree(name: str) -> None:
    """Consistency check: both solves of the last step from the same state, the contact forces too."""
    step, problem, first, a = last_by_newton(steps(name), DT)
    z = monolithic_solve(problem, first, step.old.organ.U).iterate
    assert isinstance(z, Monolith)
    assert close(a.p, z.p) and np.array_equal(a.iterate.pressed, z.pressed)
    assert close(a.iterate.q - step.old.q, z.q - step.old.q) and close(a.iterate.s, z.s)
    assert close(a.iterate.lam[:, :3], z.lam[:, :3]) and close(a.iterate.lam[:, 3:], z.lam[:, 3:])
    assert close(step.new.organ.U, z.U) and close(step.new.organ.p, z.p)


@pytest.mark.parametrize("name", CASES)
def test_every_joule_is_accounted_for(name: str) -> None:
    """Independent check: what the hand and the weights do is stored, or taken by the integrator and the contact."""
    system, state = scene(name)
    energies = initial_energies(system, state)
    for step in steps(name):
        energies = audit_step(system, energies, step)
    assert abs(energies.balance_error) <= 1e-7 * energies.external_work


def test_lips_turned_by_40_degrees_are_the_same() -> None:
    """Independent check (frame indifference): gaps and forces of lips whose normals turn with the tissue."""
    name = "slit quasi-static P1 fibre"
    R, here = rotation(40.0, np.array([1.0, 2.0, 0.0])), steps(name)[-1].new
    turned = taken(*scene(name, turned=True), DT, STEPS)[-1].new
    assert close(turned.q, here.q @ R.T, TURNED) and close(turned.organ.p, here.organ.p, TURNED)
    assert close(turned.organ.U.reshape(-1, 3), here.organ.U.reshape(-1, 3) @ R.T, TURNED)


def test_load_steps_face_what_they_end_with() -> None:
    """Independent check: at rest the lips of a solved load step face what they would face in its own end, so that
    their gaps there are those of the next one."""
    system, start = scene("slit quasi-static P1 fibre")
    now, organ = begin(system, start), system.organ
    for share in (0.5, 1.0):
        now = now.load(share, STEPS * DT)
    state: Any = now.state.organ
    assert (state.p > 0.0).any()
    again = organ.paired_anew(state.U)
    gaps = again.g0 + again.G @ state.U
    assert np.abs(gaps[state.p > 0.0]).max() <= PAIRED * system.thread.section.diameter
