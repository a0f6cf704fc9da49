"""Wounds: lips that match, volumes and areas, how the cut body hangs together, refusals."""

from itertools import product

import numpy as np
import pytest
import skfem
from scipy.special import ellipe

from meshes.block import FACES
from meshes.checks import check, parts, volumes
from meshes.errors import MeshError
from meshes.grading import Grading
from meshes.quality import quality, size_at
from meshes.wound import FLOOR, LIPS, Wound, lips, wounded_block_gmsh, wounded_block_structured
from tests.bounds import IDENTITY
from tests.meshes.samples import NEEDS_GMSH, euler_characteristic, facet_areas

SIZE = (0.06, 0.04, 0.02)
COARSE = Grading(5e-3, 5e-3)
FINE = Grading(5e-3, 1e-3, radius=1.5e-3)
SITES = np.array([[-0.006, 0.004, 0.0], [0.006, 0.004, 0.0]])
MAKERS = [
    pytest.param(wounded_block_structured, id="structured"),
    pytest.param(wounded_block_gmsh, id="gmsh", marks=NEEDS_GMSH),
]
# Share of the block's length and height that is cut → Euler characteristic of the surface, separate parts.
CUTS = {(0.5, 0.4): (2, 1), (0.5, 1.0): (0, 1), (1.0, 0.4): (2, 1), (1.0, 1.0): (4, 2)}


def slit(along: str, cut: tuple[float, float]) -> Wound:
    side = SIZE[1] if along == "y" else SIZE[0]
    return Wound(cut[0] * side, cut[1] * SIZE[2], along=along)


def ellipse(depth: float = 8e-3, along: str = "y") -> Wound:
    return Wound(0.02, depth, 6e-3, along)


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize(("along", "cut"), list(product("xy", CUTS)))
def test_a_slit_takes_no_volume_and_has_two_lips_of_its_area(make, along, cut):
    """Independent check: volume of the box, length times depth, and the topology of the cut body."""
    wound = slit(along, cut)
    mesh = make(SIZE, wound, COARSE)
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(np.prod(SIZE), rel=IDENTITY)
    for name in LIPS:
        area = facet_areas(mesh, mesh.boundaries[name]).sum()
        assert area == pytest.approx(wound.length * wound.depth, rel=IDENTITY), name
    characteristic, number = CUTS[cut]
    assert euler_characteristic(mesh) == characteristic
    assert parts(mesh.p.T, mesh.t.T).max() + 1 == number
    named = np.concatenate([mesh.boundaries[name] for name in (*FACES, *LIPS)])
    assert np.array_equal(np.sort(named), np.sort(mesh.boundary_facets()))


@NEEDS_GMSH
@pytest.mark.parametrize(("length", "depth", "h"), [(8e-3, 5e-3, 4e-3), (0.012, 2e-3, 6e-3), (0.012, 2e-3, 0.01)])
def test_a_coarse_slit_is_cut_into_its_corners_too(length, depth, h):
    """A triangle that cut off a corner would have all its nodes on the front, and a quarter of the area stay whole."""
    mesh = wounded_block_gmsh((0.03, 0.03, 0.02), Wound(length, depth), Grading(h, h))
    for name in LIPS:
        assert facet_areas(mesh, mesh.boundaries[name]).sum() == pytest.approx(length * depth, rel=IDENTITY)


@NEEDS_GMSH
def test_a_cut_that_gmsh_loses_is_refused():
    """gmsh's geometry drops an opening of 0.02 mm that crosses a plane inside the block of 50 mm."""
    with pytest.raises(MeshError, match="loses a cut as narrow"):
        wounded_block_gmsh((0.05, 0.05, 0.02), Wound(0.034, 8e-3, 2e-5), COARSE, planes=((), (), (-2e-3,)))


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("along", ["x", "y"])
def test_lips_of_a_slit_match_node_by_node_at_one_place(make, along):
    mesh = make(SIZE, slit(along, (0.5, 0.4)), COARSE)
    pairs = lips(mesh, slit(along, (0.5, 0.4)))
    check_pairs(mesh, pairs.nodes, pairs.facets)
    assert np.array_equal(mesh.p[:, pairs.nodes[:, 0]], mesh.p[:, pairs.nodes[:, 1]])
    open_ones = pairs.nodes[:, 0] != pairs.nodes[:, 1]
    front = ~open_ones  # the nodes where the cut ends are shared
    tips = np.abs(mesh.p[1 if along == "y" else 0, pairs.nodes[:, 0]])
    ends = np.isclose(tips, slit(along, (0.5, 0.4)).length / 2, rtol=IDENTITY)
    foot = np.isclose(mesh.p[2, pairs.nodes[:, 0]], -0.4 * SIZE[2], rtol=IDENTITY)
    assert np.array_equal(front, ends | foot) and open_ones.sum() >= 3


def check_pairs(mesh: skfem.MeshTet, nodes: np.ndarray, facets: np.ndarray) -> None:
    """Every lip facet has one partner, with the partners of its nodes."""
    partner = dict(nodes.tolist())
    assert sorted(facets[:, 0]) == sorted(mesh.boundaries["lip_left"])
    assert sorted(facets[:, 1]) == sorted(mesh.boundaries["lip_right"])
    for left, right in facets:
        assert {partner[node] for node in mesh.facets[:, left]} == set(mesh.facets[:, right])


@NEEDS_GMSH
@pytest.mark.parametrize("along", ["x", "y"])
def test_lips_of_an_ellipse_are_mirror_images_to_the_last_bit(along):
    mesh = wounded_block_gmsh(SIZE, ellipse(along=along), FINE, SITES if along == "y" else SITES[:, [1, 0, 2]])
    pairs = lips(mesh, ellipse(along=along))
    check_pairs(mesh, pairs.nodes, pairs.facets)
    mirror = np.array([-1.0, 1, 1]) if along == "y" else np.array([1.0, -1, 1])
    assert np.array_equal(mesh.p.T[pairs.nodes[:, 0]] * mirror, mesh.p.T[pairs.nodes[:, 1]])
    across = 0 if along == "y" else 1
    assert np.all(mesh.p[across, pairs.nodes[:, 0]] <= 0)
    image = mesh.p.T * mirror
    assert {tuple(point) for point in image + 0.0} == {tuple(point) for point in mesh.p.T + 0.0}


@NEEDS_GMSH
@pytest.mark.parametrize("along", ["x", "y"])
@pytest.mark.parametrize("width", [0.0, 6e-3])
def test_a_symmetric_wound_is_its_own_image_along_it_too(along, width):
    """Independent check: with sites and a layer that are, every node has its image to the last bit. With a border on
    one side the mesh is no image, and its cells are as good."""
    sites = np.array([[0.006, 0.004, 0.0], [-0.006, 0.004, 0.0], [0.006, -0.004, 0.0]])
    order, wound = [0, 1, 2] if along == "y" else [1, 0, 2], Wound(0.02, 8e-3, width, along)
    mirror = np.where(np.arange(3) == order[1], -1.0, 1.0)
    found = {}
    for there in ((), (-0.012, 0.012), (-0.012, 0.0122)):
        planes = [(), there, (-3e-3,)]
        mesh = wounded_block_gmsh(SIZE, wound, COARSE, sites[:, order], tuple(planes[k] for k in order))
        own, image = ({tuple(point) for point in p + 0.0} for p in (mesh.p.T, mesh.p.T * mirror))
        found[there] = own == image, quality(mesh).dihedral_min
        lips(mesh, wound)
    assert [same for same, _ in found.values()] == [True, True, False]
    assert found[-0.012, 0.0122][1] > 0.7 * found[-0.012, 0.012][1]


@NEEDS_GMSH
@pytest.mark.parametrize("depth", [5e-3, 8e-3])
def test_an_open_wound_has_the_ellipse_s_volume_wall_and_floor(depth):
    """Independent check: π a b and the complete elliptic integral. Chords of length h fall short of the area by
    h²/(6 a b) of it, and of the outline by κ² h²/24, 1.2 % at h = 2 mm for the mean square curvature here.
    """
    a, b, size = 0.01, 3e-3, (0.012, 0.03, 8e-3)
    area, around = np.pi * a * b, 4 * a * ellipe(1 - (b / a) ** 2)
    for h in (2e-3, 1e-3):
        mesh = wounded_block_gmsh(size, ellipse(depth), Grading(h, h))
        taken = np.prod(size) - volumes(mesh.p.T, mesh.t.T).sum()
        # Chords are shorter than h, by up to a third, for each side of the outline is divided evenly.
        assert 0.4 < (1 - taken / (area * depth)) / (h * h / (6 * a * b)) < 1.1
        wall = sum(facet_areas(mesh, mesh.boundaries[name]).sum() for name in LIPS)
        assert 0 < 1 - wall / (around * depth) < 0.012 * (h / 2e-3) ** 2
        assert euler_characteristic(mesh) == (2 if depth < size[2] else 0)
        assert (FLOOR in mesh.boundaries) == (depth < size[2])
        if FLOOR in mesh.boundaries:
            floor = facet_areas(mesh, mesh.boundaries[FLOOR]).sum()
            assert 0.4 < (1 - floor / area) / (h * h / (6 * a * b)) < 1.1


@NEEDS_GMSH
def test_elements_are_small_at_the_sites_of_both_sides():
    mesh = wounded_block_gmsh(SIZE, ellipse(), FINE, SITES[:1])
    for site in SITES:  # the mirror image too, for one half is meshed
        assert 0.8 < size_at(mesh, site) / 1e-3 < 1.6
    assert size_at(mesh, np.array([0.03, -0.02, -0.02])) > 3e-3


@NEEDS_GMSH
def test_quality_of_the_wounded_blocks():
    """No bound of theory: a regression that a mesh for linear elasticity can live with."""
    for wound in (slit("y", (0.5, 0.4)), ellipse()):
        found = quality(wounded_block_gmsh(SIZE, wound, FINE, SITES))
        assert found.dihedral_min > 8 and found.radius_ratio_min > 0.1 and found.radius_ratio_median > 0.7


@pytest.mark.parametrize("make", MAKERS)
def test_a_layer_s_border_goes_through_the_wound(make):
    mesh = make(SIZE, slit("y", (0.5, 0.4)), COARSE, planes=((), (), (-3e-3,)))
    z = mesh.p[2, mesh.t]
    assert not np.any((z.min(axis=0) < -3e-3 - 1e-9) & (z.max(axis=0) > -3e-3 + 1e-9))
    area = facet_areas(mesh, mesh.boundaries["lip_left"]).sum()
    assert area == pytest.approx(0.5 * SIZE[1] * 0.4 * SIZE[2], rel=IDENTITY)


def test_only_the_twins_of_a_slit_may_lie_at_one_place():
    """The check that files pass still refuses the same nodes when they are not said to be twins."""
    mesh = wounded_block_structured(SIZE, slit("y", (0.5, 0.4)), COARSE)
    with pytest.raises(MeshError, match="pairs of nodes lie at the same place"):
        check(mesh.p.T, mesh.t.T)
    pairs = lips(mesh, slit("y", (0.5, 0.4))).nodes
    check(mesh.p.T, mesh.t.T, pairs[pairs[:, 0] != pairs[:, 1]])


def test_lips_that_are_no_mirror_images_have_no_pairs():
    mesh = wounded_block_structured(SIZE, slit("y", (0.5, 0.4)), COARSE)
    points = mesh.p.copy()
    points[2, np.unique(mesh.facets[:, mesh.boundaries["lip_left"]])] *= 1.001
    moved = skfem.MeshTet(points, mesh.t).with_boundaries(mesh.boundaries)
    with pytest.raises(MeshError, match="not mirror images"):
        lips(moved, slit("y", (0.5, 0.4)))


@pytest.mark.parametrize("make", MAKERS)
def test_two_calls_give_the_same_arrays(make):
    first, second = (make(SIZE, slit("x", (0.5, 0.4)), FINE, SITES) for _ in range(2))
    assert np.array_equal(first.p, second.p) and np.array_equal(first.t, second.t)


@pytest.mark.parametrize(
    ("fault", "wound"),
    [
        ("length = 0", lambda: Wound(0, 1e-3)),
        ("depth = nan", lambda: Wound(1e-2, float("nan"))),
        ("width = -1", lambda: Wound(1e-2, 1e-3, -1)),
        ("along = 'z'", lambda: Wound(1e-2, 1e-3, along="z")),
        ("depth = 0.021 of the wound exceeds", lambda: Wound(1e-2, 0.021)),
        ("length = 0.05 of the wound exceeds", lambda: Wound(0.05, 1e-3)),
        ("length = 0.04 of an open wound", lambda: Wound(0.04, 1e-3, 2e-3)),
        ("width = 0.06 of the wound", lambda: Wound(0.02, 1e-3, 0.06)),
        ("width = 1e-08 of the wound must be at least 6e-07 m, or 0", lambda: Wound(0.02, 1e-3, 1e-8)),
        ("an open wound needs gmsh", lambda: Wound(0.02, 1e-3, 2e-3)),
    ],
)
def test_impossible_wounds_are_refused_in_words(fault, wound):
    with pytest.raises(MeshError, match=fault):
        wounded_block_structured(SIZE, wound(), COARSE)
