"""Closed surfaces filled with tetrahedra: volumes, sizes, units, formats, and every bad surface in words."""

from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista as pv
import skfem

from meshes.checks import check, volumes
from meshes.errors import MeshError
from meshes.grading import Grading
from meshes.quality import quality, size_at
from meshes.skin import check_closed, check_simple, fill, read_surface, welded
from tests.meshes.samples import NEEDS_GMSH, euler_characteristic, facet_areas

MM = 1e-3
CUBE = (40.0, 30.0, 20.0)  # mm


def cuboid(size=CUBE, at=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Eight corners and twelve triangles."""
    mesh = skfem.MeshTet.init_tensor(*(np.array([low, low + side]) for low, side in zip(at, size, strict=True)))
    return mesh.p.T.copy(), mesh.facets[:, mesh.boundary_facets()].T.copy()


def sphere(radius: float, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """An octahedron whose faces are divided `rings` times and thrown on the sphere."""
    mesh = skfem.MeshTri(
        np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float).T[:2],
        np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]]).T,
    )
    points = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    triangles = mesh.t.T
    for _ in range(rings):
        middles = points[triangles] + points[np.roll(triangles, -1, axis=1)]
        new = len(points) + np.arange(3 * len(triangles)).reshape(-1, 3)
        points = np.vstack([points, middles.reshape(-1, 3)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        a, b, c = triangles.T
        d, e, f = new.T
        triangles = np.vstack([np.column_stack(t) for t in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    return welded(radius * points, triangles)


def written(path: Path, points: np.ndarray, triangles: np.ndarray) -> Path:
    if path.suffix in (".vtk", ".vtp"):
        pv.PolyData.from_regular_faces(points, triangles).save(path)
        return path
    meshio.Mesh(points, {"triangle": triangles}).write(path)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(MeshError) as caught:
        read_surface(path, MM)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    return str(caught.value)


@NEEDS_GMSH
@pytest.mark.parametrize("name", ["cube.stl", "cube.obj", "cube.ply", "cube.vtk", "cube.vtp"])
def test_a_box_is_filled_exactly_from_every_format(tmp_path, name):
    """Independent check: volume and area of the box, whose flat faces and edges are kept."""
    path = written(tmp_path / name, *cuboid())
    skin = read_surface(path, MM)
    mesh = fill(skin, Grading(8e-3, 8e-3))
    check(mesh.p.T, mesh.t.T)
    x, y, z = np.array(CUBE) * MM
    # Binary STL keeps coordinates in single precision.
    assert volumes(mesh.p.T, mesh.t.T).sum() == pytest.approx(x * y * z, rel=1e-6)
    assert facet_areas(mesh, mesh.boundaries["surface"]).sum() == pytest.approx(2 * (x * y + y * z + z * x), rel=1e-6)
    assert euler_characteristic(mesh) == 2
    assert skin.volume == pytest.approx(x * y * z, rel=1e-6)


@NEEDS_GMSH
def test_a_sphere_is_filled_and_fine_at_a_site_only(tmp_path):
    """Independent check: a sphere's volume less the caps that flat facets of size h cut off, of order (h/R)²."""
    radius, h = 20.0, 4e-3
    path = written(tmp_path / "ball.stl", *sphere(radius, 5))
    site = np.array([0.0, 0.0, radius * MM])
    mesh = fill(read_surface(path, MM), Grading(h, 1e-3, radius=1.5e-3), [site])
    lost = 1 - volumes(mesh.p.T, mesh.t.T).sum() / (4 / 3 * np.pi * (radius * MM) ** 3)
    assert 0 < lost < (h / (radius * MM)) ** 2
    assert 0.8 < size_at(mesh, site) / 1e-3 < 1.5
    assert size_at(mesh, -site) > 0.75 * h
    found = quality(mesh)
    assert found.dihedral_min > 5 and found.radius_ratio_min > 0.05  # no theory: fit for linear elasticity
    distance = np.linalg.norm(mesh.p[:, np.unique(mesh.facets[:, mesh.boundaries["surface"]])], axis=0)
    # The file's facets, of 32 to a quarter circle and less, lie (1 − cos 1.5°) inside the sphere.
    assert np.all((distance < radius * MM * (1 + 1e-6)) & (distance > radius * MM * (1 - 1e-3)))


def test_an_open_surface_is_refused(tmp_path):
    points, triangles = cuboid()
    message = refusal(written(tmp_path / "open.stl", points, triangles[1:]))
    assert "its surface is open, 3 edges belong to one triangle only" in message and "close the holes" in message


def test_an_inner_wall_is_refused():
    points, triangles = cuboid()
    wall = [[0, 1, 7]]
    with pytest.raises(MeshError, match=r"not a manifold, \d edges belong to more than two triangles"):
        check_closed(points, np.vstack([triangles, triangles[:1], wall]))


def test_two_pieces_are_refused(tmp_path):
    first, second = cuboid(), cuboid(at=(100.0, 0.0, 0.0))
    both = np.vstack([first[0], second[0]]), np.vstack([first[1], second[1] + 8])
    assert "has 2 separate pieces" in refusal(written(tmp_path / "two.stl", *both))


def test_a_surface_that_crosses_itself_is_refused(tmp_path):
    """A dent pushed through the far side: closed, a manifold, and crossing."""
    points, triangles = sphere(20.0, 4)
    check_simple(points, triangles)
    dent = np.linalg.norm(points - [0.0, 0.0, 20.0], axis=1) < 5.0
    points[dent, 2] -= 45.0
    message = refusal(written(tmp_path / "dent.ply", points, triangles))
    assert "intersects itself in" in message and "repair it" in message


def test_a_dent_that_does_not_reach_the_far_side_is_sound():
    points, triangles = sphere(20.0, 4)
    dent = np.linalg.norm(points - [0.0, 0.0, 20.0], axis=1) < 5.0
    points[dent, 2] -= 30.0
    check_closed(points, triangles)
    check_simple(points, triangles)


def test_a_facet_folded_onto_its_neighbour_is_refused():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.3, 0.0], [0.3, 0.3, 1.0]])
    folded = np.array([[0, 1, 2], [0, 1, 3]])
    with pytest.raises(MeshError, match="intersects itself in 1 pairs"):
        check_simple(points, folded)
    check_simple(points, np.array([[0, 1, 2], [0, 1, 4]]))


def test_every_pair_of_crossing_triangles_is_found():
    """Consistency check: the local search against all pairs, on random triangles of very different sizes."""
    rng = np.random.default_rng(3)
    scale = 10 ** rng.uniform(-1, 0.3, 60)
    corners = rng.uniform(-1, 1, (60, 1, 3)) + scale[:, None, None] * rng.uniform(-1, 1, (60, 3, 3))
    triangles = np.arange(180).reshape(60, 3)
    expected = sum(crosses(corners[i], corners[j]) for i in range(60) for j in range(i))
    assert expected > 20
    with pytest.raises(MeshError, match=f"in {expected} pairs"):
        check_simple(corners.reshape(-1, 3), triangles)


def crosses(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether an edge of one triangle meets the inside of the other, by solving for the point."""
    for one, other in ((first, second), (second, first)):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            u, v, t = np.linalg.solve(
                np.column_stack([other[1] - other[0], other[2] - other[0], one[a] - one[b]]), one[a] - other[0]
            )
            if u > 0 and v > 0 and u + v < 1 and 0 < t < 1:
                return True
    return False


def test_what_is_no_surface_of_triangles_is_refused(tmp_path):
    points, _ = cuboid()
    meshio.Mesh(points, {"quad": np.array([[0, 1, 3, 2]])}).write(tmp_path / "quads.ply")
    assert "it has quad elements: give a surface of triangles" in refusal(tmp_path / "quads.ply")
    pv.PolyData.from_regular_faces(points, [[0, 1, 3, 2]]).save(tmp_path / "quads.vtk")
    assert "it has polygons with more than three corners: give a surface of triangles" in refusal(
        tmp_path / "quads.vtk"
    )
    pv.PolyData.from_regular_faces(points, [[0, 1, 3]]).cast_to_unstructured_grid().save(tmp_path / "grid.vtk")
    assert "it is a UnstructuredGrid: give a surface as PolyData" in refusal(tmp_path / "grid.vtk")
    (tmp_path / "torn.vtp").write_text("<VTKFile")
    assert refusal(tmp_path / "torn.vtp")
    (tmp_path / "bad.stl").write_text("solid nothing\n")
    assert refusal(tmp_path / "bad.stl")


def test_corners_written_anew_are_joined():
    points, triangles = cuboid()
    joined, again = welded(points[triangles].reshape(-1, 3), np.arange(36).reshape(12, 3))
    assert len(joined) == 8
    assert np.array_equal(joined[again], points[triangles])


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "name nodes outside the 3"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -7\n", "name nodes outside the 3"),
        ("a.obj", "v 0 0 0\nv 1e308 0 0\nv 0 -1e308 1e308\nf 1 2 3\n", "its nodes lie up to 1e+308 m"),
        ("a.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no triangle with three distinct corners"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\n", "its header does not end"),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 2147483648\nend_header\n", "its header declares 2147483648"),
        ("a.obj", "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "its points have shape (3, 2)"),
        (
            "a.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 5\n",
            "name nodes outside the 3",
        ),
    ],
)
def test_a_surface_that_contradicts_itself_is_refused(tmp_path, name, text, says):
    """Independent check: corners that are not there, lengths that are no numbers, and triangles of no size."""
    (tmp_path / name).write_text(text)
    assert says in refusal(tmp_path / name)
