"""Surfaces by name that press on one another: matching and not, curved, and several of them in one organ."""

import numpy as np
import pytest
import skfem

import tissue
from meshes.block import block
from tests.bounds import IDENTITY, RESIDUAL, TWO_SOLVERS
from tests.tissue.test_lips import SQUEEZE, THROUGH, uniaxial
from tests.tissue.wounds import SOFT, Array, at_rest, cut_block, gaps_on, organ_of, stretched
from tissue.organs.facing import face, open_sides

SIDE = 0.01  # of a cube [m]
FAR = ["lower_bottom", "upper_top"]
MEETING = ("upper_bottom", "lower_top")


def joined(meshes: dict[str, skfem.MeshTet], moved: dict[str, Array]) -> skfem.MeshTet:
    """Several bodies in one mesh, each moved; their boundaries have its name before theirs."""
    points, cells, first = [], [], 0
    for name, mesh in meshes.items():
        points.append(mesh.p + np.reshape(moved[name], (3, 1)))
        cells.append(mesh.t + first)
        first += mesh.nvertices
    whole = skfem.MeshTet(np.hstack(points), np.hstack(cells))
    numbers = {tuple(nodes): k for k, nodes in enumerate(whole.facets.T)}
    named, first = {}, 0
    for name, mesh in meshes.items():
        for key, facets in (mesh.boundaries or {}).items():
            corners = np.sort(mesh.facets[:, facets] + first, axis=0).T
            named[f"{name}_{key}"] = np.array([numbers[tuple(nodes)] for nodes in corners])
        first += mesh.nvertices
    return whole.with_boundaries(named)


def stacked(h: tuple[float, float], element: str = "P1", gap: float = 0.0) -> tissue.QuasiStaticOrgan:
    """A cube on a cube, with cells of sizes `h` above and below, the one's top and the other's bottom held."""
    cubes = {"upper": block((SIDE,) * 3, h[0]), "lower": block((SIDE,) * 3, h[1])}
    mesh = joined(cubes, {"upper": np.array([0.0, 0.0, SIDE + gap]), "lower": np.zeros(3)})
    body = tissue.elasticity(mesh, SOFT, element, FAR)
    return organ_of(body, tissue.surface_gaps(body, [MEETING]))


def squeezed(organ: tissue.QuasiStaticOrgan, nu: float = SOFT.poisson_ratio) -> tuple[Array, tissue.OrganState, float]:
    """The far ends follow a uniform strain; the field of the held nodes, the state, and the held top's reaction [N]."""
    held = stretched(organ, np.diag([nu * SQUEEZE, nu * SQUEEZE, -SQUEEZE]))
    state, body = at_rest(organ), organ.elasticity
    force = body.K @ (organ.displacement(state) + held)
    top = np.unique(body.basis.get_dofs(facets=body.mesh.boundaries["upper_top"]).all("u^3"))
    return held, state, float(force[top].sum())


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_matching_surfaces_pass_the_patch_test(element: str) -> None:
    """Independent check: two cubes whose nodes meet are one bar to round-off, and their contact forces together are
    the reaction where they are held."""
    organ = stacked((2.5e-3, 2.5e-3) if element == "P1" else (5e-3, 5e-3), element)
    held, state, reaction = squeezed(organ)
    body = organ.elasticity
    exact = body.points @ uniaxial(0.0) + body.points * [0.3 * SQUEEZE, 0.3 * SQUEEZE, -SQUEEZE]
    U = body.nodal(organ.displacement(state) + held)
    assert np.abs(U - exact).max() <= RESIDUAL * np.abs(exact).max()
    expected = SOFT.youngs_modulus * SQUEEZE
    assert organ.gaps.pressure(state.p) == pytest.approx(expected, rel=TWO_SOLVERS)
    assert state.p.sum() == pytest.approx(expected * SIDE**2, rel=RESIDUAL)
    assert -reaction == pytest.approx(state.p.sum(), rel=RESIDUAL)


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_nodes_of_the_finer_surface_press_on_facets_of_the_other(element: str) -> None:
    """Independent check: of grids one of which is in the other the patch test is passed to round-off, whichever is
    named first."""
    for h in ((SIDE / 4, SIDE / 2), (SIDE / 2, SIDE / 4)):
        organ = stacked(h, element)
        _, state, reaction = squeezed(organ)
        expected = SOFT.youngs_modulus * SQUEEZE
        assert organ.gaps.pressure(state.p) == pytest.approx(expected, rel=TWO_SOLVERS)
        assert -reaction == pytest.approx(expected * SIDE**2, rel=RESIDUAL)


def test_surfaces_that_do_not_match_converge_on_the_patch_test() -> None:
    """Independent check: nodes against facets of other grids do not pass it, for the nodes' shares of the pressure are
    not those of the facets. The force is that of one bar within 0.3 %, and nearer with smaller cells; the resultant is
    right on any mesh, and no node is beyond its facet."""
    errors = []
    for cells in ((6, 4), (12, 8)):
        organ = stacked((SIDE / cells[0], SIDE / cells[1]))
        _, state, reaction = squeezed(organ)
        assert -reaction == pytest.approx(state.p.sum(), rel=TWO_SOLVERS)
        assert (organ.gap(state) >= -IDENTITY * SIDE).all()
        errors.append(abs(-reaction / (SOFT.youngs_modulus * SQUEEZE * SIDE**2) - 1.0))
    assert errors[0] <= 3e-3 and errors[1] <= 0.55 * errors[0]


def sunk(organ: tissue.QuasiStaticOrgan, U: Array) -> float:
    """How far nodes of the lower cube, which nothing holds off, are beyond the facets of the upper one that they face,
    at most [m]."""
    body, (upper, lower) = organ.elasticity, MEETING
    x, triangles = body.points + U, body.mesh.facets[:, body.mesh.boundaries[upper]].T.astype(np.intp)
    a, b, c = np.moveaxis(body.points[triangles], 1, 0)
    away = np.cross(b - a, c - a)[:, 2] > 0.0
    triangles = np.where(away[:, None], triangles, triangles[:, [0, 2, 1]])
    nodes = np.unique(body.mesh.facets[:, body.mesh.boundaries[lower]])
    faced = face(x[nodes], x, triangles, open_sides(triangles), None)
    corners = x[triangles[faced[:, 0].astype(np.intp)]]
    between = np.einsum("kc,kcx->kx", faced[:, 1:4], corners) - x[nodes]
    return float(-np.vecdot(between, faced[:, 4:]).min())


def test_how_far_surfaces_are_in_one_another() -> None:
    """Independent check: where nodes meet nothing is beyond the other surface. Of other grids those of the facets that
    are pressed on are by 0.3 % of a cell, and by half as much with cells half as large."""
    ways = {}
    for cells in ((6, 6), (6, 4), (12, 8)):
        organ = stacked((SIDE / cells[0], SIDE / cells[1]))
        held, state, _ = squeezed(organ)
        ways[cells] = sunk(organ, organ.elasticity.nodal(organ.displacement(state) + held))
    assert abs(ways[6, 6]) <= 1e-9 * SIDE / 6
    assert 0.0 < ways[6, 4] <= 3e-3 * SIDE / 6 and ways[12, 8] <= 0.55 * ways[6, 4]


def test_a_ball_on_a_plate() -> None:
    """Independent check: Hertz. A quarter of a body with a round end is pressed on a rigid plate. Radius of contact,
    from the area under pressure, and largest pressure follow from the force: a³ = 3FR/4E*, p = 3F/2πa², to 3 %."""
    R, a, E, nu = 0.05, 2e-3, SOFT.youngs_modulus, SOFT.poisson_ratio
    near, far = np.linspace(0.0, 1.5, 11), 1.5 + 0.15 * (1.6 ** np.arange(1, 8) - 1.0) / 0.6 * 1.6
    line = a * np.concatenate([near, far])
    ball = skfem.MeshTet.init_tensor(line, line, line)
    x, y, z = ball.p
    ball = skfem.MeshTet(np.array([x, y, z + (1.0 - z / line[-1]) * (x**2 + y**2) / (2.0 * R)]), ball.t)
    names = {"left": lambda x: x[0] < 1e-9, "front": lambda x: x[1] < 1e-9, "top": lambda x: x[2] > line[-1] - 1e-9}
    facets = ball.boundary_facets()
    corners = ball.p[:, ball.facets[:, facets]]
    end = facets[np.abs(corners[2] - (corners[0] ** 2 + corners[1] ** 2) / (2.0 * R)).max(axis=0) < 1e-9]
    end = end[np.hypot(*ball.p[:2, ball.facets[:, end]]).max(axis=0) < 2.0 * a]
    ball = ball.with_boundaries(names | {"end": end})
    plate = block((4.0 * line[-1],) * 3, 8.0 * line[-1])
    mesh = joined({"ball": ball, "plate": plate}, {"ball": np.zeros(3), "plate": np.zeros(3)})
    held = [f"plate_{side}" for side in ("top", "bottom", "left", "right", "front", "back")]
    body = tissue.elasticity(mesh, SOFT, "P1", ["ball_top", *held], roller=["ball_left", "ball_front"])
    organ = organ_of(body, tissue.surface_gaps(body, [("ball_end", "plate_top")]))
    U = np.zeros(body.N)
    way = 1.15 * a**2 / R
    U[body.nodes[body.points[:, 2] > line[-1] - 1e-9, 2]] = -way
    object.__setattr__(organ, "load", -(body.K @ U)[body.free])
    state, part = at_rest(organ), organ.gaps.parts[0]
    pressure, F = part.vertex_pressure(state.p), 4.0 * state.p.sum()
    radius = np.cbrt(0.75 * F * R * (1.0 - nu**2) / E)
    assert np.sqrt(4.0 * part.areas[pressure > 0.0].sum() / np.pi) == pytest.approx(radius, rel=0.03)
    assert pressure.max() == pytest.approx(1.5 * F / (np.pi * radius**2), rel=0.03)


def test_a_wounds_lips_by_name_are_those_of_the_wound() -> None:
    """Consistency check: named, the lips of a cut press as the wound's own pairs do."""
    body = tissue.elasticity(cut_block(THROUGH), SOFT, "P1", ["left", "right"])
    own, named = (
        organ_of(body, gaps)
        for gaps in (gaps_on(body, THROUGH), tissue.surface_gaps(body, [("lip_left", "lip_right")]))
    )
    forces = []
    for organ in (own, named):
        stretched(organ, uniaxial(-SQUEEZE))
        forces.append(at_rest(organ).p)
    assert np.abs(forces[0] - forces[1]).max() <= TWO_SOLVERS * forces[0].max()


def test_surfaces_apart_meet_when_they_are_brought_together() -> None:
    """Independent check: a gap of a tenth of the squeeze takes its share of it."""
    way = SQUEEZE * 2.0 * SIDE
    organ = stacked((5e-3, 5e-3), gap=0.1 * way)
    assert organ.g0 == pytest.approx(0.1 * way, rel=RESIDUAL)
    body = organ.elasticity
    held = np.zeros(body.N)
    held[body.clamped] = body.flat(np.outer(body.points[:, 2] > -0.5 * SIDE, [0.0, 0.0, -way]))[body.clamped]
    object.__setattr__(organ, "load", -(body.K @ held)[body.free])
    state = at_rest(organ)
    whole = stacked((5e-3, 5e-3))
    object.__setattr__(whole, "load", organ.load)
    assert state.p.sum() == pytest.approx(0.9 * at_rest(whole).p.sum(), rel=0.02)
    assert (state.p > 0.0).all()


def test_contact_of_named_surfaces_refuses() -> None:
    """Refusals name the surfaces and the remedy: an unknown name, an overlap, all held."""
    body = stacked((5e-3, 5e-3)).elasticity
    with pytest.raises(tissue.TissueError, match="contact: no boundary is named 'top'"):
        tissue.surface_gaps(body, [("top", "lower_top")])
    inner = body.mesh.with_boundaries({"inner": np.flatnonzero(body.mesh.f2t[1] >= 0)[:1]})
    with pytest.raises(tissue.TissueError, match="'inner' has facets inside the organ"):
        tissue.surface_gaps(tissue.elasticity(inner, SOFT, "P1", FAR), [("inner", "lower_top")])
    with pytest.raises(
        tissue.TissueError, match=r"contact\.between = \['upper_bottom', .*\]: the surfaces overlap by 0\.002 m"
    ):
        stacked((5e-3, 5e-3), gap=-2e-3)
    held = tissue.elasticity(body.mesh, SOFT, "P1", [*FAR, *MEETING])
    with pytest.raises(tissue.TissueError, match="no pair of nodes that can move"):
        tissue.surface_gaps(held, [MEETING])


def test_how_deep_points_lie_in_a_box() -> None:
    """Independent check: the distance to the nearest side, and outside, negative, to the box, on graded cells too."""
    size = np.array([0.03, 0.02, 0.01])
    lines = [half * np.linspace(-1.0, 1.0, 9) ** 3 for half in 0.5 * size]
    points = np.random.default_rng(4).uniform(-1.0, 1.0, (300, 3)) * size
    beyond = np.abs(points) - 0.5 * size
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    exact = np.where(outside > 0.0, -outside, -beyond.max(axis=1))
    assert np.abs(tissue.depths(skfem.MeshTet.init_tensor(*lines))(points) - exact).max() <= IDENTITY * size.max()


def test_a_line_through_a_box_lands_on_its_nearer_side() -> None:
    """Independent check: of the two places where an oblique line leaves a box the nearer, on graded cells."""
    half, rng = 0.5 * np.array([0.03, 0.02, 0.01]), np.random.default_rng(5)
    lines = [size * np.linspace(-1.0, 1.0, 9) ** 3 for size in half]
    land = tissue.landing(skfem.MeshTet.init_tensor(*lines))
    for point, along in zip(rng.uniform(-1.0, 1.0, (30, 3)) * half, rng.standard_normal((30, 3)), strict=True):
        ways = np.concatenate([(half - point) / along, (-half - point) / along])
        ahead, back = ways[ways > 0.0].min(), ways[ways < 0.0].max()
        exact = point + min(ahead, back, key=abs) * along
        found = land(point, along)
        assert found is not None and np.abs(found - exact).max() <= IDENTITY * half.max()
