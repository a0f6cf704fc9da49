"""Rims of a wound: where its sides end on the outer surface, and by how much they are turned out."""

import numpy as np
import pytest
from skfem import MeshTet

from meshes.block import block
from tests.bounds import IDENTITY
from tests.thread.threads import Array
from tissue.organs.rim import Rim, rim_of
from tissue.supports import facets_of

SIZE = np.array([0.02, 0.03, 0.01])
MIDDLE = 0.5 * SIZE[0]


def two_blocks() -> MeshTet:
    """Two blocks side by side, apart by a millimetre across x, whose sides that face one another are named."""
    one, aside = block(tuple(SIZE), 4e-3), np.array([[MIDDLE + 5e-4], [0.0], [0.0]])
    points = np.hstack([one.p - aside, one.p + aside])
    mesh = MeshTet(points, np.hstack([one.t, one.t + one.nvertices]))
    at = {"left": -5e-4, "right": 5e-4}
    return mesh.with_boundaries({name: lambda x, x0=x0: np.abs(x[0] - x0) < 1e-9 for name, x0 in at.items()})


def rims(mesh: MeshTet) -> tuple[Rim, Rim]:
    """The rims of both sides."""
    left, right = (mesh.facets[:, facets_of(mesh, "contact", name)].T for name in ("left", "right"))
    return rim_of(mesh, left, right), rim_of(mesh, right, left)


def turned(points: Array, angle: float) -> Array:
    """Points turned about y, so that those at positive x rise."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def test_a_rim_goes_round_a_side_and_is_parted_by_folds() -> None:
    """Independent check: round the side of a block it is as long as that is round, and the part near points on top of
    it is the edge there, of one side alone; without points it is the longest."""
    for rim, x in zip(rims(two_blocks()), (-5e-4, 5e-4), strict=True):
        assert rim.lengths.sum() == pytest.approx(2.0 * (SIZE[1] + SIZE[2]), rel=IDENTITY)
        assert np.allclose(rim.middles[:, 0], x, atol=IDENTITY * SIZE[0])
        top = rim.near(np.array([[x + 3e-3, 0.0, 0.0], [x - 4e-3, 2e-3, 0.0]]))
        assert np.allclose(top.normal, [0, 0, 1]) and np.allclose(top.rising, [-np.sign(x), 0, 0])
        vertices, way = top.way
        assert way[-1] == pytest.approx(SIZE[1], rel=IDENTITY) and len(vertices) == len(top.edges) + 1
        y = two_blocks().p[1, vertices]
        assert np.allclose(np.abs(y - y[0]), way, atol=IDENTITY * SIZE[1])
        below = np.array([[x, 0.0, -SIZE[2]]])
        assert np.allclose(rim.near(np.vstack([below, top.middles[:1]])).normal, [0, 0, -1])
        assert rim.near(np.zeros((0, 3))).lengths.sum() == pytest.approx(SIZE[1], rel=IDENTITY)


def test_edges_that_rise_are_everted_by_the_angle() -> None:
    """Independent check: blocks that turn by α each, so that the edges between them rise, evert these by α each, and
    turned the other way invert them; turned alike as one body, both together by nothing."""
    mesh, alpha = two_blocks(), 0.3
    points, is_left = mesh.p.T, mesh.p[0] < 0.0
    left, right = (rim.near(np.array([[0.0, 0.0, 0.0]])) for rim in rims(mesh))
    up, down = (np.where(is_left[:, None], turned(points, by), turned(points, -by)) for by in (alpha, -alpha))
    assert [left.turn(points), right.turn(points)] == pytest.approx([0.0, 0.0], abs=IDENTITY)
    assert [left.turn(up), right.turn(up)] == pytest.approx([alpha, alpha], rel=IDENTITY)
    assert [left.turn(down), right.turn(down)] == pytest.approx([-alpha, -alpha], rel=IDENTITY)
    assert left.turn(turned(points, alpha)) + right.turn(turned(points, alpha)) == pytest.approx(0.0, abs=IDENTITY)


def test_a_ring_is_opened_at_one_vertex() -> None:
    """Independent check: on a ring of edges each vertex is met once, and what is left to the first is one edge."""
    n = 12
    phi = 2.0 * np.pi * np.arange(n) / n
    points = np.column_stack([np.cos(phi), np.sin(phi), np.zeros(n)])
    edges = np.column_stack([np.arange(n), (np.arange(n) + 1) % n])
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    ring = Rim(edges, np.zeros((n, 3), dtype=np.intp), points, points, points, length)
    vertices, way = ring.way
    assert sorted(vertices) == list(range(n)) and np.allclose(np.diff(way), length[0])
