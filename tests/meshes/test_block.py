"""Blocks: volume, named faces, conformity, grading, determinism, refusals."""

import numpy as np
import pytest
import skfem

from meshes.block import FACES, block, extent, graded_block_gmsh, graded_block_structured, graded_lines, structured_tets
from meshes.checks import check, volumes
from meshes.errors import MeshError
from meshes.facets import sharp_edges
from meshes.grading import Grading
from meshes.named import with_boundaries
from meshes.quality import quality
from tests.meshes.samples import NEEDS_GMSH, facet_areas, node_sizes

SIZE = (0.06, 0.04, 0.02)
SITES = np.array([[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
IDENTITY = 1e-12  # relative, exact geometry in floating point

MAKERS = [
    pytest.param(lambda: block(SIZE, 5e-3), id="uniform"),
    pytest.param(lambda: graded_block_structured(SIZE, Grading(5e-3, 1e-3, radius=2e-3), SITES), id="tensor"),
    pytest.param(lambda: graded_block_gmsh(SIZE, Grading(5e-3, 1e-3, radius=2e-3), SITES), id="gmsh", marks=NEEDS_GMSH),
]


def edges_near(mesh: skfem.MeshTet, point: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the edges whose middle is within reach of a point, and whether they lie in the top face."""
    ends = mesh.p[:, mesh.edges]
    near = np.linalg.norm(ends.mean(axis=1).T - point, axis=1) < reach
    return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=0)[near], (ends[2] == 0).all(axis=0)[near]


@pytest.mark.parametrize("make", MAKERS)
def test_volume_is_that_of_the_box_and_the_mesh_is_sound(make):
    mesh = make()
    check(mesh.p.T, mesh.t.T)
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(np.prod(SIZE), rel=IDENTITY)


@pytest.mark.parametrize("make", MAKERS)
def test_named_faces_partition_the_surface_and_lie_in_their_planes(make):
    mesh = make()
    lower, upper = extent(SIZE)
    named = np.concatenate([mesh.boundaries[name] for name in FACES])
    assert set(mesh.boundaries) == {"left", "right", "front", "back", "bottom", "top"}
    assert np.array_equal(np.sort(named), np.sort(mesh.boundary_facets()))
    for name, axis, place in (
        ("left", 0, lower), ("right", 0, upper), ("front", 1, lower),
        ("back", 1, upper), ("bottom", 2, lower), ("top", 2, upper),
    ):  # fmt: skip
        facets = mesh.boundaries[name]
        assert np.abs(mesh.p[axis, mesh.facets[:, facets]] - place[axis]).max() <= IDENTITY * max(SIZE), name
        area = np.prod(np.delete(SIZE, axis))
        assert facet_areas(mesh, facets).sum() == pytest.approx(area, rel=IDENTITY), name


@pytest.mark.parametrize("make", MAKERS)
def test_facets_match_from_cell_to_cell(make):
    # On a conforming mesh the facets with one tetrahedron are the faces of the box and no more.
    mesh = make()
    x, y, z = SIZE
    surface = facet_areas(mesh, mesh.boundary_facets()).sum()
    assert surface == pytest.approx(2 * (x * y + y * z + z * x), rel=IDENTITY)


@pytest.mark.parametrize("make", MAKERS)
def test_the_sharp_edges_are_the_twelve_of_the_box(make):
    """Independent check: 4 (x + y + z) in length, all in two faces at once; nothing turns by more than 90°."""
    mesh = make()
    edges = sharp_edges(mesh, 45.0)
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum()
    assert length == pytest.approx(4 * sum(SIZE), rel=IDENTITY)
    lower, upper = extent(SIZE)
    on_face = (np.abs(edges - lower) < 1e-12) | (np.abs(edges - upper) < 1e-12)
    assert np.all(on_face.all(axis=1).sum(axis=1) == 2)
    assert len(sharp_edges(mesh, 91.0)) == 0


@pytest.mark.parametrize("make", MAKERS)
def test_two_calls_give_the_same_arrays(make):
    first, second = make(), make()
    assert np.array_equal(first.p, second.p) and np.array_equal(first.t, second.t)
    assert all(np.array_equal(first.boundaries[name], second.boundaries[name]) for name in FACES)


def test_uniform_cell_edges_are_at_most_h():
    mesh = block(SIZE, 3.1e-3)
    for axis in range(3):
        assert np.diff(np.unique(mesh.p[axis])).max() <= 3.1e-3 * (1 + IDENTITY)


def test_uniform_cells_divide_evenly_when_h_divides_the_size():
    mesh = block((0.6, 0.4, 0.2), 0.1)
    assert [len(np.unique(mesh.p[axis])) for axis in range(3)] == [7, 5, 3]
    assert mesh.t.shape[1] == 5 * 6 * 4 * 2


def test_a_structured_block_is_its_own_mirror_image():
    mesh = graded_block_structured(SIZE, Grading(5e-3, 1e-3), SITES)
    for axis in (0, 1):
        mirrored = mesh.p.copy()
        mirrored[axis] *= -1
        assert tet_centres(mesh.p, mesh.t) == tet_centres(mirrored, mesh.t)


def tet_centres(p: np.ndarray, t: np.ndarray) -> set[tuple[int, ...]]:
    centres = np.round(p[:, t].mean(axis=1).T / (1e-9 * max(SIZE))).astype(int)
    return set(map(tuple, centres))


def test_grid_lines_pass_through_the_sites():
    mesh = graded_block_structured(SIZE, Grading(5e-3, 1e-3), SITES)
    distances = np.linalg.norm(mesh.p.T[:, None] - SITES, axis=2).min(axis=0)
    assert distances.max() <= IDENTITY * max(SIZE)


def test_grid_spacing_is_h_site_in_the_radius_and_grows_by_no_more_than_growth():
    grading = Grading(h=5e-3, h_site=0.5e-3, growth=1.25, radius=2e-3)
    lines = graded_lines(-0.03, 0.03, SITES[:, 0], grading)
    spacing = np.diff(lines)
    distance = np.abs(lines[:, None] - SITES[:, 0]).min(axis=1)
    inner = np.maximum(distance[1:], distance[:-1]) <= 2e-3 * (1 + IDENTITY)
    assert inner.sum() >= 2 * 8
    assert spacing[inner].max() <= 0.5e-3 * (1 + IDENTITY)
    assert spacing.max() <= 5e-3 and spacing.max() > 1.5e-3
    ratio = spacing[1:] / spacing[:-1]
    # Between two intervals the counts are rounded up apart: up to one part in the number of cells.
    assert np.all(np.maximum(ratio, 1 / ratio) <= 1.25 * (1 + 2 / 8))
    smooth = np.delete(np.maximum(ratio, 1 / ratio), np.flatnonzero(np.isin(lines[1:-1], SITES[:, 0])))
    assert smooth.max() <= 1.25 * (1 + 1e-9)


def test_close_sites_share_a_grid_line_and_a_site_by_the_face_takes_the_face():
    grading = Grading(h=5e-3, h_site=1e-3)
    lines = graded_lines(-0.03, 0.03, np.array([0.0, 0.3e-3, 0.0298]), grading)
    assert np.diff(lines).min() > 0.4e-3
    assert np.any(np.isclose(lines, 0.15e-3, rtol=0, atol=1e-15))
    assert lines[-1] == 0.03 and lines[-1] - lines[-2] <= 1e-3


def test_no_sites_means_a_uniform_block():
    graded, uniform = graded_block_structured(SIZE, Grading(5e-3, 1e-3), []), block(SIZE, 5e-3)
    assert np.array_equal(graded.p, uniform.p) and np.array_equal(graded.t, uniform.t)


PLANES = ((-0.02, 0.013), (), (-1.5e-3, -6e-3))


@pytest.mark.parametrize(
    "make", [graded_block_structured, pytest.param(graded_block_gmsh, marks=NEEDS_GMSH)], ids=["tensor", "gmsh"]
)
def test_facets_follow_the_planes(make):
    """Independent check: no tetrahedron lies on both sides, and facets in a plane have the section's area."""
    mesh = make(SIZE, Grading(5e-3, 1e-3, radius=2e-3), SITES, PLANES)
    check(mesh.p.T, mesh.t.T)
    for axis, places in enumerate(PLANES):
        for place in places:
            away = mesh.p[axis] - place
            assert not np.any((away[mesh.t].min(axis=0) < -1e-12) & (away[mesh.t].max(axis=0) > 1e-12))
            within = np.flatnonzero((np.abs(away[mesh.facets]) <= 1e-12).all(axis=0))
            assert facet_areas(mesh, within).sum() == pytest.approx(np.prod(np.delete(SIZE, axis)), rel=1e-9)


def test_planes_outside_or_on_the_faces_change_nothing():
    plain = graded_block_structured(SIZE, Grading(5e-3, 1e-3), SITES)
    more = graded_block_structured(SIZE, Grading(5e-3, 1e-3), SITES, ((-0.03, 1.0), (0.02,), (0.0, -0.02, 5e-3)))
    assert np.array_equal(plain.p, more.p) and np.array_equal(plain.t, more.t)


def test_the_tensor_grid_is_counted_before_it_is_made():
    grading = Grading(5e-3, 1e-3, radius=2e-3)
    assert (
        structured_tets(SIZE, grading, SITES, PLANES) == graded_block_structured(SIZE, grading, SITES, PLANES).nelements
    )


@pytest.mark.parametrize("growth", [1.1, 1.3, 2.0])
def test_the_wanted_size_grows_by_no_more_than_its_slope(growth):
    """Independent check: |h(x) − h(y)| ≤ ln(growth) |x − y| for the smallest of the sites' sizes, anywhere."""
    grading = Grading(6e-3, 0.5e-3, growth, 1e-3)
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.03, 0.03, (2, 20_000, 3))
    x[::2] = y[::2] + 1e-3 * rng.uniform(-1, 1, (10_000, 3))
    sites = np.vstack([SITES, [[0.0, 0.01, -0.01]]])
    sizes = [grading.size(np.linalg.norm(p[:, None] - sites, axis=2).min(axis=1)) for p in (x, y)]
    assert np.ptp(sizes[0]) > 0.8 * (grading.h - grading.h_site) or growth == 1.1
    bound = np.log(growth) * np.linalg.norm(x - y, axis=1)
    assert np.all(np.abs(sizes[0] - sizes[1]) <= bound * (1 + IDENTITY) + IDENTITY * grading.h)


@NEEDS_GMSH
@pytest.mark.parametrize("depth", [0.0, -0.01], ids=["surface", "inside"])
def test_gmsh_keeps_to_the_wanted_size_at_surface_and_interior_sites(depth):
    """Loosely: the mean edge at a node against the wanted size there; Delaunay edges are a quarter longer, and near
    the faces nodes are as near as the faces make them.
    """
    grading = Grading(6e-3, 0.8e-3, radius=2e-3)
    site = np.array([[0.0, 0.0, depth]])
    mesh = graded_block_gmsh(SIZE, grading, site)
    ratio = node_sizes(mesh) / grading.size(np.linalg.norm(mesh.p.T - site, axis=1))
    assert 0.9 < np.median(ratio) < 1.5 and np.quantile(ratio, 0.95) < 1.8 and ratio.max() < 2.5
    # The law between neighbours: no edge joins sizes further apart than their ratio allows, with the same slack.
    sizes = node_sizes(mesh)[mesh.edges]
    assert np.quantile(sizes.max(axis=0) / sizes.min(axis=0), 0.95) < 1.3 * 1.3


@NEEDS_GMSH
def test_gmsh_edges_are_near_h_site_at_a_site_and_near_h_far_off():
    mesh = graded_block_gmsh(SIZE, Grading(6e-3, 0.8e-3, growth=1.3, radius=2e-3), SITES[:1])
    near, top = edges_near(mesh, SITES[0], 2e-3)
    far, _ = edges_near(mesh, np.array([0.03, 0.02, -0.02]), 0.012)
    # In the surface gmsh keeps to the size; inside, its Delaunay edges are longer by a quarter to a half.
    assert top.sum() > 30 and 0.85 < near[top].mean() / 0.8e-3 < 1.15
    assert len(near) > 100 and 0.85 < near.mean() / 0.8e-3 < 1.5
    assert len(far) > 5 and 0.6 < far.mean() / 6e-3 < 1.4


@NEEDS_GMSH
def test_gmsh_makes_the_size_of_each_site():
    """Independent check: the mean edges within the zones of two sites are near their own sizes, a third of one another;
    edges inside are up to a half longer. One grading too few is refused."""
    each = Grading(6e-3, 0.5e-3, radius=1e-3), Grading(6e-3, 1.5e-3, radius=3e-3)
    sites = np.array([[-0.012, 0.0, 0.0], [0.012, 0.0, -0.005]])
    mesh = graded_block_gmsh(SIZE, each, sites)
    ends = mesh.p.T[mesh.edges.T]
    lengths, middles = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), ends.mean(axis=1)
    for site, grading in zip(sites, each, strict=True):
        near = np.linalg.norm(middles - site, axis=1) < grading.radius
        assert 0.8 <= lengths[near].mean() / grading.h_site <= 1.6
    with pytest.raises(MeshError, match="1 gradings for 2 sites"):
        graded_block_gmsh(SIZE, each[:1], sites)


@NEEDS_GMSH
def test_gmsh_block_is_far_smaller_than_the_tensor_grid_for_the_same_sizes():
    arguments = (SIZE, Grading(6e-3, 0.8e-3), SITES)
    assert graded_block_gmsh(*arguments).nvertices < graded_block_structured(*arguments).nvertices / 2


@pytest.mark.parametrize(
    ("fault", "call"),
    [
        ("size\\[1\\] = -1", lambda: block((1, -1, 1), 0.5)),
        ("size\\[2\\] = nan", lambda: block((1, 1, float("nan")), 0.5)),
        ("three lengths", lambda: block((1, 1), 0.5)),
        ("h = 0", lambda: block((1, 1, 1), 0)),
        ("h = inf", lambda: block((1, 1, 1), float("inf"))),
        ("h_site = 0.2 must not exceed h = 0.1", lambda: Grading(0.1, 0.2)),
        ("h_site = -0.1", lambda: Grading(0.1, -0.1)),
        ("growth = 1.0", lambda: Grading(0.1, 0.05, growth=1.0)),
        ("radius = -1", lambda: Grading(0.1, 0.05, radius=-1)),
        ("outside the block", lambda: graded_block_structured((1, 1, 1), Grading(0.1, 0.05), [[0, 0, 0.01]])),
        ("outside the block", lambda: graded_block_gmsh((1, 1, 1), Grading(0.1, 0.05), [[0.6, 0, 0]])),
        ("shape \\(p, 3\\)", lambda: graded_block_structured((1, 1, 1), Grading(0.1, 0.05), [0, 0, 0])),
        ("finite", lambda: graded_block_structured((1, 1, 1), Grading(0.1, 0.05), [[0, 0, float("nan")]])),
    ],
)
def test_impossible_input_is_refused_in_words(fault, call):
    with pytest.raises(MeshError, match=fault):
        call()


def test_size_and_cell_count_are_inverse_and_consistent():
    grading = Grading(h=4e-3, h_site=0.5e-3, growth=1.3, radius=1e-3)
    d = np.linspace(0, 0.05, 501)
    assert np.abs(grading.distance(grading.cells(d)) - d).max() <= IDENTITY * 0.05
    step = 1e-7
    slope = (grading.cells(d[1:] + step) - grading.cells(d[1:] - step)) / (2 * step)
    # Central difference: exact but for round-off (1e-9) and where it straddles a kink of the size.
    assert np.abs(slope * grading.size(d[1:]) - 1).max() <= 1e-4


def test_quality_of_known_tetrahedra():
    regular = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    tet = np.array([[0, 1, 2, 3]])
    best = quality(skfem.MeshTet(np.ascontiguousarray(regular.T), np.ascontiguousarray(tet.T)))
    assert best.dihedral_min == pytest.approx(np.degrees(np.arccos(1 / 3)), rel=IDENTITY)
    assert best.radius_ratio_min == pytest.approx(1.0, rel=IDENTITY)
    assert best.edge_min == best.edge_max == pytest.approx(np.sqrt(8), rel=IDENTITY)
    right = quality(skfem.MeshTet(np.ascontiguousarray(corner.T), np.ascontiguousarray(tet.T)))
    assert right.dihedral_min == pytest.approx(np.degrees(np.arccos(1 / np.sqrt(3))), rel=IDENTITY)
    # r = V/(ΣA/3) = 1/(3 + √3), R = √3/2
    assert right.radius_ratio_min == pytest.approx(6 / (3 + np.sqrt(3)) / np.sqrt(3), rel=IDENTITY)


def test_naming_boundaries_keeps_what_is_numbered_and_the_mesh_as_it_was() -> None:
    """Independent check: the facets are those that were numbered, names are added to those there are, and the mesh that
    was given has none of them."""
    mesh = block((0.05, 0.03, 0.02), 0.01)
    facets, known = mesh.facets, set(mesh.boundaries)
    named = with_boundaries(mesh, {"some": np.array([0, 3])})
    assert named.facets is facets
    assert set(named.boundaries) == known | {"some"} and set(mesh.boundaries) == known
    assert np.array_equal(named.boundaries["some"], [0, 3])
