"""Each fault of a volume mesh is found and named with its numbers."""

import numpy as np
import pytest

from meshes.block import block
from meshes.checks import check, volumes
from meshes.errors import MeshError


@pytest.fixture
def sound():
    mesh = block((1.0, 1.0, 1.0), 0.5)
    return mesh.p.T.copy(), mesh.t.T.copy()


def test_a_sound_mesh_passes_in_any_unit(sound):
    points, tets = sound
    for unit in (1e-9, 1.0, 1e9):
        check(points * unit, tets)


def test_volume_is_signed():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    assert volumes(points, np.array([[0, 1, 2, 3], [0, 2, 1, 3]])).tolist() == [1 / 6, -1 / 6]


def test_some_inverted(sound):
    points, tets = sound
    tets[[3, 7]] = tets[[3, 7]][:, [1, 0, 2, 3]]
    with pytest.raises(MeshError, match=r"2 of 40 tetrahedra are inverted \(negative volume, index 3, 7\)"):
        check(points, tets)


def test_all_inverted_is_told_apart(sound):
    points, tets = sound
    with pytest.raises(MeshError, match=r"all 40 tetrahedra are inverted .* swap two nodes"):
        check(points, tets[:, [1, 0, 2, 3]])


def test_degenerate():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, 0.3, 1e-14]])
    with pytest.raises(MeshError, match=r"1 of 2 tetrahedra are degenerate, with no volume \(index 1\)"):
        check(points, np.array([[0, 1, 2, 3], [0, 2, 1, 4]]))


def test_a_thin_element_is_not_degenerate():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1e-4]])
    check(points, np.array([[0, 1, 2, 3]]))


def test_unused_nodes(sound):
    points, tets = sound
    with pytest.raises(MeshError, match=r"2 of 29 nodes belong to no tetrahedron \(index 27, 28\)"):
        check(np.vstack([points, [[9, 9, 9], [8, 8, 8]]]), tets)


def test_duplicate_nodes(sound):
    points, tets = sound
    doubled = tets.copy()
    users = np.argwhere(doubled == 13)
    doubled[tuple(users[0])] = len(points)
    with pytest.raises(MeshError, match=r"1 pairs of nodes lie at the same place .*: 13 and 27\)"):
        check(np.vstack([points, points[13]]), doubled)


def test_parts(sound):
    points, tets = sound
    both = np.vstack([points, points + 10]), np.vstack([tets[:-1], tets + len(points)])
    with pytest.raises(MeshError, match=r"2 parts that share no facet, of 40, 39 tetrahedra"):
        check(*both)


def test_bodies_that_touch_in_an_edge_are_parts(sound):
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], dtype=float)
    with pytest.raises(MeshError, match="2 parts"):
        check(points, np.array([[0, 2, 3, 1], [0, 4, 5, 1]]))


def test_listed_twice(sound):
    points, tets = sound
    with pytest.raises(MeshError, match=r"more than two tetrahedra"):
        check(points, np.vstack([tets, tets[:1]]))


def test_not_finite(sound):
    points, tets = sound
    points[[4, 5], 1] = np.nan, np.inf
    with pytest.raises(MeshError, match=r"2 of 27 nodes have coordinates that are not finite \(index 4, 5\)"):
        check(points, tets)


def test_nodes_that_do_not_exist(sound):
    points, tets = sound
    tets[2, 1] = 27
    with pytest.raises(MeshError, match=r"1 tetrahedra name nodes outside 0 … 26 \(index 2\)"):
        check(points, tets)


def test_no_tetrahedra(sound):
    with pytest.raises(MeshError, match="no tetrahedra"):
        check(sound[0], np.empty((0, 4), dtype=int))


def test_triangles_are_not_tetrahedra(sound):
    with pytest.raises(MeshError, match=r"\(n, 3\) and \(m, 4\)"):
        check(sound[0], sound[1][:, :3])
