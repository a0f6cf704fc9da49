"""Rollers: a plane boundary that is held across itself and slides along itself."""

from typing import Any

import numpy as np
import pytest
from skfem import ElementVector, FacetBasis, LinearForm, MeshTet

import tissue
from studies.scenario import Scenario
from studies.simulation import prepare
from studies.simulation.assembly import assemble
from tests.bounds import IDENTITY
from tissue.elasticity import ELEMENTS
from tissue.supports import holds_still

E, NU = 2.0e5, 0.45
SIZE = np.array([0.03, 0.02, 0.01])
SIDES = {"left": 0, "front": 1, "bottom": 2}


def box(jitter: float = 0.3) -> MeshTet:
    """A box from the origin, its inner nodes moved, with the names of three faces and of the one at high x."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, size, n) for size, n in zip(SIZE, (5, 4, 4), strict=True)))
    inner = np.all((mesh.p > 1e-9) & (mesh.p < SIZE[:, None] - 1e-9), axis=0)
    moves = np.random.default_rng(3).uniform(-1.0, 1.0, mesh.p.shape) * jitter * (SIZE / 4)[:, None]
    sides = {name: (lambda x, axis=axis: x[axis] < 1e-9) for name, axis in SIDES.items()}
    names: dict[str, Any] = sides | {"right": lambda x: x[0] > SIZE[0] - 1e-9, "oblique": lambda x: x[0] + x[1] < 0.01}
    return MeshTet(mesh.p + moves * inner, mesh.t).with_boundaries(names)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_uniaxial_stress_is_exact(element: str) -> None:
    """Independent check (patch test): a block on three rollers, drawn at its fourth face by a uniform traction σ, is
    u = σ/E (x, −νy, −νz) everywhere; a clamp in place of one of the rollers forbids that."""
    body = tissue.elasticity(box(), tissue.Material(E, NU, 1000.0), element, roller=list(SIDES))
    sigma = 500.0
    face = FacetBasis(body.mesh, ElementVector(ELEMENTS[element]()), facets=body.mesh.boundaries["right"])
    load = LinearForm(lambda v, w: sigma * v[0]).assemble(face)
    free = body.free
    U = body.extended(tissue.factorize(body.K[free][:, free], body.basis.doflocs[:, free].T).solve(load[free]))
    exact = sigma / E * body.points * [1.0, -NU, -NU]
    assert np.abs(body.nodal(U) - exact).max() <= 1e-11 * np.abs(exact).max()
    held = tissue.elasticity(box(), tissue.Material(E, NU, 1000.0), element, ["left"], roller=["front", "bottom"])
    U = held.extended(tissue.factorize(held.K[held.free][:, held.free]).solve(load[held.free]))
    assert np.abs(held.nodal(U) - exact).max() > 0.1 * np.abs(exact).max()


def test_inertia_of_nodes_held_in_part() -> None:
    """Independent check: M times a field on rollers is that of the matrix, whatever the components that are held."""
    body = tissue.elasticity(box(), tissue.Material(E, NU, 1000.0), "P2", roller=["left", "bottom"])
    organ = tissue.DynamicOrgan(body, tissue.build_sites(body, []))
    field = np.random.default_rng(1).standard_normal(body.free.size)
    expected = body.M[body.free][:, body.free] @ field
    assert np.abs(organ.mass_times(field) - expected).max() <= IDENTITY * np.abs(expected).max()


def test_what_still_moves_is_refused() -> None:
    """Independent check: rollers on one or two faces leave rigid motions, on three they do not; a boundary that is no
    plane across an axis has no direction to be held in; multigrid has no node to hold in part."""
    material = tissue.Material(E, NU, 1000.0)
    for rollers, held in ((["bottom"], False), (["left", "bottom"], False), (["left", "front", "bottom"], True)):
        body = tissue.elasticity(box(), material, roller=rollers)
        still = holds_still(body.points, np.isin(body.nodes, body.clamped))
        assert still == held
        if not held:
            with pytest.raises(tissue.TissueError, match="rigid body"):
                tissue.QuasiStaticOrgan(body, tissue.build_sites(body, []))
    with pytest.raises(tissue.TissueError, match="not a plane normal to"):
        tissue.elasticity(box(), material, roller=["oblique"])
    with pytest.raises(tissue.TissueError, match="roller: no boundary is named"):
        tissue.elasticity(box(), material, roller=["lef"])
    with pytest.raises(tissue.TissueError, match="three unknowns per node"):
        body = tissue.elasticity(box(), material, roller=["left", "front", "bottom"])
        tissue.QuasiStaticOrgan(body, tissue.build_sites(body, []), solver="multigrid")
    with pytest.raises(tissue.TissueError, match="touches a clamped"):
        tissue.build_sites(body, [tissue.Site((0.015, 0.01, 0.0), 1e-3, name="hole")])


def scenario(half: bool, **tissue_keys: Any) -> Scenario:
    """A thread that draws two holes of a block together, or one half of it up to its plane of symmetry."""
    length = 0.024 if not half else 0.012
    shift = 0.0 if not half else 0.006  # a block is centred: the plane of symmetry of the half is its left face
    table = {
        "tissue": {
            "youngs_modulus": E,
            "poisson_ratio": 0.3,
            "density": 1000.0,
            "clamp": ["right"] if half else ["left", "right"],
            "roller": ["bottom", "left"] if half else ["bottom"],
            "mesh": {"kind": "block", "size": [length, 0.01, 0.006], "h": 2.0e-3},
            **tissue_keys,
        },
        "thread": {"diameter": 3e-4, "youngs_modulus": 1e9, "density": 1e3, "control_points": 30},
        "solve": {"kind": "static", "load_steps": 1},
    }
    hole = {"kind": "anchored", "footprint": 1e-3}
    right = {**hole, "name": "right", "at": [0.005 - shift, 0, 0], "draw": [[0, 0], [1, 1e-4]]}
    table["thread"]["path"] = [[-0.009 - shift, 0, 0], [0.009 - shift, 0, 0]]
    table["piercing"] = [{**hole, "name": "left", "at": [-0.005, 0, 0], "draw": [[0, 0], [1, -1e-4]]}, right]
    if half:  # the thread ends in the plane of symmetry, where it does not move
        table["thread"] |= {"path": [[-shift, 0, 0], [0.009 - shift, 0, 0]], "start": {"kind": "fixed"}}
        table["piercing"] = [right]
    return Scenario.model_validate(table)


def test_half_an_organ_on_rollers_is_the_whole() -> None:
    """Consistency check: half a block on rollers in its plane of symmetry, half the thread fixed there, moves as the
    whole, to what the diagonals of the two meshes differ by."""
    ends = [list(prepare(scenario(half)).advance())[-1][0].piercings[-1] for half in (False, True)]
    assert ends[1].displacement[0] == pytest.approx(ends[0].displacement[0], rel=0.02)
    assert ends[1].force[0] == pytest.approx(ends[0].force[0], rel=0.02)


def test_scenario_refuses() -> None:
    """Independent check: a roller is refused by its key where there is no such boundary, or it does not hold enough."""
    with pytest.raises(ValueError, match=r'roller = \["botom"\].*the nearest is "bottom"'):
        scenario(True, roller=["botom"])
    with pytest.raises(tissue.TissueError, match="rigid body"):
        assemble(scenario(True, clamp=[], roller=["bottom"]))
    with pytest.raises(ValueError, match="must be held"):
        scenario(True, clamp=[], roller=[])


@pytest.mark.parametrize(
    ("held", "left"),
    [
        ([], "move along x, y, z and turn about an axis along x, y, z"),
        ([(0, "xyz")], "turn about an axis along x, y, z"),
        ([(0, "xyz"), (1, "xyz")], "turn about an axis along x"),
        ([(0, "z"), (1, "z"), (2, "z")], "move along x, y and turn about an axis along z"),
        ([(0, "xyz"), (3, "xyz")], "turn about an axis along [0.707, 0.707, 0.0]"),
        ([(0, "xyz"), (1, "xyz"), (2, "xyz")], ""),
    ],
)
def test_the_rigid_motions_that_are_left(held: list[tuple[int, str]], left: str) -> None:
    """Independent check: a square plate held in points and along axes; each motion moves none of what is held."""
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 2.0, 0.0]])
    mask = np.zeros((4, 3), dtype=bool)
    for node, axes in held:
        mask[node, ["xyz".index(axis) for axis in axes]] = True
    words = tissue.motions_in_words(tissue.rigid_motions(points, mask)).replace("-", "")
    assert words == left
    assert holds_still(points, mask) == (left == "")
