"""Sites: weights, rigid motions, compliances of the half space and the full space, and every refused place."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import Delaunay
from skfem import MeshTet

import tissue
from tests.bounds import IDENTITY
from tissue.sites import footprint
from tissue.sites.site import frame
from tissue.sites.surface import closest_on_triangles, outer_surface
from tissue.solvers.factor import Factor

Array = NDArray[np.float64]
SIZE = np.array([0.06, 0.04, 0.02])


def block_mesh(counts: tuple[int, int, int] = (12, 8, 5)) -> MeshTet:
    """A block with its top at z = 0, its inner nodes moved so that no two cells are alike."""
    low, high = np.array([-0.03, -0.02, -0.02]), np.array([0.03, 0.02, 0.0])
    mesh = MeshTet.init_tensor(*(np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)))
    nodes = mesh.p.T
    inner = np.all((nodes > low + 1e-9) & (nodes < high - 1e-9), axis=1)
    moves = np.random.default_rng(5).uniform(-0.2, 0.2, mesh.p.shape) * (SIZE / counts)[:, None]
    return MeshTet(mesh.p + moves * inner, mesh.t).with_boundaries(
        {"bottom": lambda x: x[2] < -0.02 + 1e-9, "patch": lambda x: (x[2] > -1e-9) & (x[0] > 0.02)}
    )


def block(element: str = "P1", clamp: tuple[str, ...] = ()) -> tissue.Elasticity:
    return tissue.elasticity(block_mesh(), tissue.Material(1.0e5, 0.45, 1070.0), element, clamp)


EVERY_KIND = [
    tissue.Site([-0.011, 0.001, 0.0], 2e-3, "parabolic", "normal"),
    tissue.Site([0.009, 0.002, 0.0], 4e-3, "uniform", [1.0, 0.5, 2.0]),
    tissue.Site([0.002, -0.003, -0.009], 3e-3, "parabolic", [0.0, -1.0, 0.2]),
    tissue.Site([0.002, -0.003, -0.009], 3e-3, "uniform"),
    tissue.Site([0.0, 0.0, 0.0], 0.0, "parabolic", "normal"),
    tissue.Site([0.013, -0.004, 0.0], 0.0, "parabolic", [0.0, 0.0, 1.0]),
    tissue.Site([0.0071, -0.0042, -0.0113], 0.0),
    tissue.Site([-0.03, 0.003, -0.01], 3e-3, "uniform"),
]


@pytest.mark.parametrize("weight", ["uniform", "parabolic"])
def test_footprint_rules_average_polynomials_exactly(weight: str) -> None:
    """⟨1⟩ = 1, and ⟨x²⟩, ⟨z⁴⟩ in closed form; the ball also on each of its halves."""
    disc, ball = footprint.disc(weight), footprint.ball(weight)
    for rule in (disc, ball):
        assert rule.weights.sum() == pytest.approx(1.0, abs=1e-14)
        assert rule.weights.min() > 0.0
        assert np.abs(rule.weights @ rule.points).max() <= 1e-15
    square, quartic, half = {"uniform": (1 / 4, 3 / 35, -3 / 8), "parabolic": (1 / 6, 1 / 21, -5 / 16)}[weight]
    assert disc.weights @ disc.points[:, 0] ** 2 == pytest.approx(square, rel=1e-13)
    assert ball.weights @ ball.points[:, 2] ** 4 == pytest.approx(quartic, rel=1e-13)
    below = ball.points[:, 2] < 0.0
    assert ball.weights[below].sum() == pytest.approx(0.5, rel=1e-13)
    assert 2.0 * ball.weights[below] @ ball.points[below, 2] == pytest.approx(half, rel=1e-13)


@pytest.mark.parametrize("count", [0, 5, 3000])
def test_a_disc_is_integrated_facet_by_facet(count: int) -> None:
    """Polynomials of degree six in closed form, whatever the size and sense of the triangles, and the area of each of
    those inside, which a sum over fixed points cannot know."""
    places = np.random.default_rng(7).uniform(-1.5, 1.5, (count, 2))
    cells = Delaunay(np.vstack([places, [[-3, -3], [3, -3], [3, 3], [-3, 3]]])).simplices
    cells[::2] = cells[::2, ::-1]
    triangles = np.vstack([places, [[-3, -3], [3, -3], [3, 3], [-3, 3]]])[cells]
    cover = footprint.cover(triangles)
    (x, y), flat, bowl = cover.points.T, cover.weights("uniform"), cover.weights("parabolic")
    for average, exact in ((flat @ x**6, 5 / 64), (flat @ (x * y) ** 2, 1 / 24), (bowl @ x**4, 1 / 16)):
        assert average == pytest.approx(exact, rel=IDENTITY)
    assert np.abs([flat @ x, bowl @ y, flat.sum() - 1.0, bowl.sum() - 1.0]).max() <= IDENTITY
    (u, v), (w, z) = (triangles[:, 1] - triangles[:, 0]).T, (triangles[:, 2] - triangles[:, 0]).T
    inside = (np.linalg.norm(triangles, axis=2) < 1.0).all(axis=1)
    share = np.bincount(cover.triangles, flat, minlength=len(triangles))
    assert inside.any() == (count > 10)
    area = np.abs(u * z - v * w) / (2.0 * np.pi)
    assert np.abs(share - area)[inside].max(initial=0.0) <= IDENTITY
    fourth = sum(np.prod(c, axis=0) for c in combinations_with_replacement(triangles[..., 0].T, 4)) * area / 15.0
    found = np.bincount(cover.triangles, flat * x**4, minlength=len(triangles))
    assert np.abs(found - fourth)[inside].max(initial=0.0) <= IDENTITY


@pytest.mark.parametrize("weight", ["uniform", "parabolic"])
def test_slopes_by_parts_are_the_averaged_gradient(weight: str) -> None:
    """⟨∇1⟩ = 0, ⟨∇x⟩ = I (tangential on the disc), and ⟨∂x³/∂x⟩ = 3⟨x²⟩ with the rule of the values."""
    disc, ball, half = (f(weight) for f in (footprint.disc_slope, footprint.ball_slope, footprint.half_ball_slope))
    values, solid = footprint.disc(weight), footprint.ball(weight)
    below = solid.points[:, 2] < 0.0
    lower = footprint.FootprintRule(solid.points[below], 2.0 * solid.weights[below])
    for slope, rule in ((disc, values), (ball, solid), (half, lower)):
        expected = np.diag([1.0, 1.0, float(slope is not disc)])
        assert np.abs(slope.vectors.sum(axis=0)).max() <= 1e-13
        assert np.abs(slope.points.T @ slope.vectors - expected).max() <= 1e-13
        cubic = (slope.points**3).T @ slope.vectors
        assert np.abs(cubic - np.diag(3.0 * rule.weights @ rule.points**2)).max() <= 1e-12


@settings(max_examples=200, deadline=None)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_frames_are_orthonormal_and_right_handed(vector: tuple[float, float, float]) -> None:
    t0 = np.array(vector) / np.linalg.norm(vector)
    u0, v0 = frame(t0)
    Q = np.array([u0, v0, t0])
    assert np.abs(Q @ Q.T - np.eye(3)).max() <= 1e-14
    assert np.abs(np.cross(u0, v0) - t0).max() <= 1e-14


def test_frames_turn_continuously_with_the_direction() -> None:
    """Along a great circle through the equator, and close to the one exception t₀ = −z."""
    for lean in (0.0, 0.3, 3.0):
        angle = np.linspace(0.0, np.pi - 1e-3, 4000)
        paths = [frame(np.array([np.sin(a) * np.cos(lean), np.sin(a) * np.sin(lean), np.cos(a)])) for a in angle]
        assert np.abs(np.diff(np.array(paths), axis=0)).max() <= 2.0 * (angle[1] - angle[0])


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_sites_follow_a_rigid_motion(element: str) -> None:
    """A translation moves x alone; an infinitesimal rotation turns both kinds of frame alike: u = u₀ + ω ×
    u₀.
    """
    body = block(element)
    sites = tissue.build_sites(body, EVERY_KIND)
    shift, omega = np.array([0.3, -0.2, 0.5]), np.array([0.4, 0.7, -0.2])
    moved = (sites.Y @ body.flat(np.broadcast_to(shift, body.points.shape))).reshape(-1, 3, 3)
    assert np.abs(moved[:, 0] - shift).max() <= 1e-12
    assert np.abs(moved[:, 1:]).max() * 0.02 <= 1e-12
    turned = (sites.Y @ body.flat(np.cross(omega, body.points))).reshape(-1, 3, 3)
    frames = sites.y0.reshape(-1, 3, 3)
    assert np.abs(turned[:, 1:] - np.cross(omega, frames[:, 1:])).max() <= 1e-12
    assert np.abs(turned[:, 0] - np.cross(omega, frames[:, 0])).max() <= 1e-12 * 0.06


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_frames_under_a_uniform_gradient(element: str) -> None:
    """Material tangents convect with ∇U, fibre normals with −∇Uᵀ: T stays the normal, or along the fibre."""
    body = block(element)
    gradient = 1e-4 * np.random.default_rng(2).standard_normal((3, 3))
    sites = tissue.build_sites(body, EVERY_KIND)
    du = (sites.Y @ body.flat(body.points @ gradient.T)).reshape(-1, 3, 3)[:, 1:]
    frames = sites.y0.reshape(-1, 3, 3)[:, 1:]
    for k, fibre in enumerate([False, True, True, True, False, True, True, False]):
        expected = -frames[k] @ gradient if fibre else frames[k] @ gradient.T
        assert np.abs(du[k] - expected).max() <= 1e-12 * 1e-4 * 10.0, k
        if fibre:
            convected = sites.directions[k] + gradient @ sites.directions[k]
            assert np.abs((frames[k] + du[k]) @ convected).max() <= 1e-7


def test_weights_of_the_point_sum_to_one() -> None:
    sites = tissue.build_sites(block("P2"), EVERY_KIND)
    rows = sites.Y.toarray().reshape(-1, 3, 3, sites.Y.shape[1])[:, 0]
    assert np.abs(rows.sum(axis=2) - 1.0).max() <= 1e-12


def test_normals_and_places() -> None:
    """On the top, a side, an edge (bare point) and slightly off the surface (projected)."""
    body = block()
    sites = tissue.build_sites(
        body,
        [
            tissue.Site([0.0, 0.0, 4e-5], 2e-3, "uniform", "normal"),
            tissue.Site([0.03, 0.0, -0.01], 2e-3, "uniform", "normal"),
            tissue.Site([0.03, 0.0, 0.0], 0.0, "uniform", "normal"),
            tissue.Site([0.0, 0.0, -0.01], 2e-3),
        ],
    )
    assert np.abs(sites.normals[:2] - [[0, 0, 1], [1, 0, 0]]).max() <= 1e-12
    assert sites.normals[2] @ [1, 0, 1] > 1.3
    assert np.all(np.isnan(sites.normals[3]))
    assert np.abs(sites.points[0]).max() <= 1e-15


def test_the_normal_turns_smoothly_over_a_ridge() -> None:
    """Closed form: a uniform disc at the distance d from the ridge of a roof of small slope m has the mean normal
    m (1 − 2A) across it, A the share of the segment beyond; steps of d much smaller than what fixed points can tell."""
    slope, a = 1e-4, 0.3
    mesh = MeshTet.init_tensor(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5), np.linspace(-1, 0, 3))
    p = mesh.p.copy()
    p[2] -= slope * np.abs(p[0])
    roof = tissue.elasticity(MeshTet(p, mesh.t), tissue.Material(1e3, 0.3, 1.0))
    d = np.linspace(0.1, 0.101, 6)
    points = np.column_stack([a * d, np.full(6, 0.03), -slope * a * d])
    sites = tissue.build_sites(roof, [tissue.Site(point, a, "uniform", "normal") for point in points])
    beyond = (np.arccos(d) - d * np.sqrt(1.0 - d**2)) / np.pi
    tilt = sites.normals[:, 0] / slope
    assert np.abs(tilt - (1.0 - 2.0 * beyond)).max() <= 1e-6


def test_normal_of_a_sphere_cap_points_outward() -> None:
    """A curved surface: the average normal is the radius to within the facets' size, weights still sum to
    one.
    """
    ball = MeshTet.init_ball(3)
    body = tissue.elasticity(ball, tissue.Material(1.0, 0.3, 1.0), "P1")
    outward = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    on_facet = closest_on_triangles(outward, outer_surface(ball).triangles)
    point = on_facet[np.argmin(np.linalg.norm(on_facet - outward, axis=1))]
    sites = tissue.build_sites(body, [tissue.Site(point, 0.3, "uniform", "normal")])
    assert sites.normals[0] @ outward > np.cos(0.1)
    shift = sites.Y @ body.flat(np.ones((len(body.points), 3)))
    assert np.abs(shift - np.repeat([1.0, 0.0], [3, 6])).max() <= 1e-12
    gradient = np.random.default_rng(2).standard_normal((3, 3))
    for weight in ("uniform", "parabolic"):
        kinds = [tissue.Site(point, 0.3, weight, direction) for direction in ("normal", [0.0, 1.0, 1.0])]
        sites = tissue.build_sites(body, kinds)
        frames, du = (a.reshape(2, 3, 3)[:, 1:] for a in (sites.y0, sites.Y @ body.flat(body.points @ gradient.T)))
        assert np.abs(du[0] - frames[0] @ gradient.T).max() <= 1e-12 * 10.0
        assert np.abs(du[1] + frames[1] @ gradient).max() <= 1e-12 * 10.0


def slit_mesh() -> MeshTet:
    """A block cut at x = 0 down to half its depth: two lips in one place, with nodes of their own."""
    mesh = block_mesh((12, 8, 4))
    p, t = mesh.p.copy(), mesh.t.copy()
    cut = np.flatnonzero((np.abs(p[0]) < 1.5e-3) & (p[2] > -0.009))
    p[0, cut] = 0.0
    twin = np.arange(p.shape[1])
    twin[cut] = p.shape[1] + np.arange(cut.size)
    right = p[0, t].mean(axis=0) > 0.0
    t[:, right] = twin[t[:, right]]
    return MeshTet(np.hstack([p, p[:, cut]]), t)


def test_a_disc_does_not_reach_over_an_open_cut() -> None:
    """The lips of a closed wound lie in one plane, but a hole in one lip has nothing to do with the other."""
    body = tissue.elasticity(slit_mesh(), tissue.Material(1.0e5, 0.45, 1000.0))
    with pytest.raises(tissue.TissueError, match="overhangs an edge"):
        tissue.build_sites(body, [tissue.Site([0.001, 0.0, 0.0], 3e-3, "uniform", "normal")])
    Y = tissue.build_sites(body, [tissue.Site([0.004, 0.0, 0.0], 3e-3, "uniform", "normal")]).Y
    left = body.points[:, 0] < -1e-9
    assert abs(Y[:, body.nodes[left].ravel()]).sum() == 0.0


@pytest.mark.parametrize(
    ("site", "words"),
    [
        (
            tissue.Site([0.0, 0.0, 0.01], name='piercing "out"'),
            r'piercing "out": .*outside the organ, 0.01 m.*\[0, 0, 0\]',
        ),
        (
            tissue.Site([0.0, 0.0, -0.01], 2e-3, "uniform", "normal"),
            "'normal'.*inside the organ.*give a vector",
        ),
        (
            tissue.Site([0.029, 0.0, 0.0], 2e-3, "uniform", "normal"),
            "overhangs an edge.*move the site inwards",
        ),
        (tissue.Site([0.0281, 0.0, 0.0], 2e-3, "uniform", [0, 0, 1]), "overhangs an edge"),
        (tissue.Site([0.0, 0.0, -0.001], 2e-3), "reaches out of the organ.*0.001 m away"),
        (tissue.Site([0.025, 0.0, 0.0], 2e-3, "uniform", "normal"), "touches a clamped boundary"),
        (tissue.Site([0.019, 0.0, 0.0], 4e-3, "uniform", "normal"), "touches a clamped boundary"),
        (tissue.Site([0.0, 0.0, -0.02], 0.0), "touches a clamped boundary"),
    ],
)
def test_impossible_places_are_refused_with_a_remedy(site: tissue.Site, words: str) -> None:
    with pytest.raises(tissue.TissueError, match=words):
        tissue.build_sites(block("P2", ("bottom", "patch")), [site])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0.0, 0.0],), "point"),
        (([0.0, 0.0, np.nan],), "point"),
        (([0.0, 0.0, 0.0], -1e-3), "radius = -0.001"),
        (([0.0, 0.0, 0.0], 1e-3, "gauss"), "weight = 'gauss'"),
        (([0.0, 0.0, 0.0], 1e-3, "uniform", "up"), "direction = 'up'"),
        (([0.0, 0.0, 0.0], 1e-3, "uniform", [0.0, 0.0, 0.0]), "other than zero"),
    ],
)
def test_impossible_sites_are_refused(arguments: tuple, words: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(tissue.TissueError, match=words):
        tissue.Site(*arguments)


def graded_line(inner: float, outer: float, spacing: float, ratio: float) -> Array:
    """0 … outer, even up to `inner`, then growing by `ratio`."""
    line, step = list(np.arange(0.0, inner + 1e-9, spacing)), spacing
    while line[-1] < outer:
        step *= ratio
        line.append(line[-1] + step)
    return np.array(line)


def compliance(body: tissue.Elasticity, factor: Factor, row: Array, far: Array) -> float:
    """Motion along `row` `(N,)` under a unit force along it, with the clamped unknowns moved as `far` `(N,)`."""
    U = factor.solve(row - (body.K @ far)[body.free])
    return float(row @ U)


def far_field(body: tissue.Elasticity, kernel: Array) -> Array:
    """A field `(m, 3)` kept on the clamped unknowns only, shape `(N,)`."""
    return np.where(np.isin(np.arange(body.N), body.clamped), body.flat(np.nan_to_num(kernel)), 0.0)


def boundary_factor(body: tissue.Elasticity) -> Factor:
    return tissue.factorize(body.K[body.free][:, body.free], body.basis.doflocs[:, body.free].T)


E, NU = 1.0e5, 0.3
G = E / (2.0 * (1.0 + NU))


def boussinesq(points: Array) -> Array:
    """Displacement of the half space z < 0 by a unit pull along z at the origin (Johnson, Contact Mechanics,
    3.18).
    """
    x, y, depth = points[:, 0], points[:, 1], -points[:, 2]
    rho = np.linalg.norm(points, axis=1)
    spread = depth / rho**3 - (1.0 - 2.0 * NU) / (rho * (rho + depth))
    return np.column_stack([-x * spread, -y * spread, depth**2 / rho**3 + 2.0 * (1.0 - NU) / rho]) / (4.0 * np.pi * G)


def cerruti(points: Array) -> Array:
    """Displacement of the half space z < 0 by a unit force along x at the origin (Johnson, 3.75)."""
    x, y, depth = points[:, 0], points[:, 1], -points[:, 2]
    rho = np.linalg.norm(points, axis=1)
    k, r = 1.0 - 2.0 * NU, rho + depth
    ux = 1.0 / rho + x**2 / rho**3 + k * (1.0 / r - x**2 / (rho * r**2))
    uy = x * y / rho**3 - k * x * y / (rho * r**2)
    return np.column_stack([ux, uy, -x * depth / rho**3 - k * x / (rho * r)]) / (4.0 * np.pi * G)


def kelvin(points: Array) -> Array:
    """Displacement of full space by a unit force along x at the origin."""
    rho = np.linalg.norm(points, axis=1)
    column = points * points[:, :1] / rho[:, None] ** 2 + np.array([3.0 - 4.0 * NU, 0.0, 0.0])
    return column / (16.0 * np.pi * G * (1.0 - NU) * rho[:, None])


@np.errstate(invalid="ignore", divide="ignore")
def test_compliance_of_a_footprint_on_a_half_space() -> None:
    """Independent check: C_zz = (1−ν²) S/πE, C_xx = (1+ν)(2−ν) S/2πE, aS = 16/3π (uniform) or 2048/315π
    (parabolic).

    The couple of the normal frame: (1−ν²)/2πE ∫ŵ²k² dk = 128 (1−ν²)/15π²Ea³ with the parabolic weight. The
    point-load kernels on the box's outer faces leave a model error of order (a/R)³, 0.1 %; the rest is the
    mesh, and a Galerkin compliance comes from below.
    """
    line = graded_line(1.0, 4.5, 1.0 / 3.0, 1.8)
    both, R = np.concatenate([-line[:0:-1], line]), line[-1]
    outer = {"far": lambda x: (np.abs(x[:2]).max(axis=0) > R - 1e-6) | (x[2] < 1e-6 - R)}
    mesh = MeshTet.init_tensor(both, both, -line[::-1]).with_boundaries(outer)
    body = tissue.elasticity(mesh, tissue.Material(E, NU, 1000.0), "P2", ["far"])
    weights = {"uniform": 16.0 / (3.0 * np.pi), "parabolic": 2048.0 / (315.0 * np.pi)}
    Y = tissue.build_sites(body, [tissue.Site([0, 0, 0], 1.0, w, "normal") for w in weights]).Y.toarray()
    factor = boundary_factor(body)
    for k, S in enumerate(weights.values()):
        pulled = compliance(body, factor, Y[9 * k + 2], far_field(body, boussinesq(body.points)))
        dragged = compliance(body, factor, Y[9 * k], far_field(body, cerruti(body.points)))
        assert -0.02 <= pulled / ((1.0 - NU**2) * S / (np.pi * E)) - 1.0 <= 0.0
        assert -0.02 <= dragged / ((1.0 + NU) * (2.0 - NU) * S / (2.0 * np.pi * E)) - 1.0 <= 0.0
    turned = compliance(body, factor, Y[9 + 5], np.zeros(body.N))
    assert -0.05 <= turned / (128.0 * (1.0 - NU**2) / (15.0 * np.pi**2 * E)) - 1.0 <= 0.0


@np.errstate(invalid="ignore", divide="ignore")
def test_compliance_of_a_ball_inside_a_full_space() -> None:
    """Independent check: ⟨⟨Kelvin⟩⟩ over a uniform ball, (10−12ν)/3 ⟨1/r⟩/16πG(1−ν) with ⟨1/r⟩ = 6/5a."""
    line = graded_line(1.0, 3.0, 0.5, 1.7)
    both, R = np.concatenate([-line[:0:-1], line]), line[-1]
    mesh = MeshTet.init_tensor(both, both, both).with_boundaries({"far": lambda x: np.abs(x).max(axis=0) > R - 1e-6})
    body = tissue.elasticity(mesh, tissue.Material(E, NU, 1000.0), "P2", ["far"])
    row = tissue.build_sites(body, [tissue.Site([0, 0, 0], 1.0, "uniform")]).Y[0].toarray().ravel()
    measured = compliance(body, boundary_factor(body), row, far_field(body, kelvin(body.points)))
    exact = (10.0 - 12.0 * NU) / 3.0 * 1.2 / (16.0 * np.pi * G * (1.0 - NU))
    assert -0.02 <= measured / exact - 1.0 <= 0.0


def test_a_couple_does_not_see_the_points_of_its_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    """With five cells to a radius, doubling the rule must not change a compliance by more than the rule's own error.

    Averaging the gradients of the shape functions at the same points was wrong by a factor of two here.
    """
    line = np.concatenate([np.linspace(0.0, 1.0, 6), [1.4, 2.0, 3.0]])
    both = np.concatenate([-line[:0:-1], line])
    mesh = MeshTet.init_tensor(both, both, -line[::-1]).with_boundaries({"bottom": lambda x: x[2] < -2.9})
    body = tissue.elasticity(mesh, tissue.Material(E, NU, 1000.0), "P1", ["bottom"])
    kinds = [tissue.Site([0, 0, 0], 1.0, w, d) for w in ("uniform", "parabolic") for d in ("normal", [0, 0, 1])]
    once = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, kinds)).operator(0.0, 0.0).C
    for name in ("RADIAL", "AROUND", "RIM", "POLAR"):
        monkeypatch.setattr(footprint, name, 2 * getattr(footprint, name))
    twice = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, kinds)).operator(0.0, 0.0).C
    assert np.diag(once) == pytest.approx(np.diag(twice), rel=0.01)


def test_a_footprint_has_a_limit_under_refinement_and_a_bare_point_has_none() -> None:
    """From h to 2h/3 the point's compliance grows like 1/h, its couple's like 1/h³; a footprint's hardly
    change.
    """
    values = []
    for spacing in (1.0 / 2.0, 1.0 / 3.0):
        line = graded_line(1.0, 3.0, spacing, 1.0 + 1.4 * spacing)
        both = np.concatenate([-line[:0:-1], line])
        mesh = MeshTet.init_tensor(both, both, -line[::-1]).with_boundaries({"bottom": lambda x: x[2] < -3.0})
        body = tissue.elasticity(mesh, tissue.Material(E, NU, 1000.0), "P2", ["bottom"])
        kinds = [(0.0, "normal"), (1.0, "normal"), (1.0, [0, 0, 1])]
        sites = tissue.build_sites(body, [tissue.Site([0, 0, 0], a, "parabolic", d) for a, d in kinds])
        values.append(np.diag(tissue.QuasiStaticOrgan(body, sites).operator(0.0, 0.0).C).reshape(3, 9))
    growth = values[1] / values[0]
    assert growth[0, :3].min() > 1.4
    assert growth[0, [5, 8]].min() > 2.7
    assert growth[1:, :3].max() < 1.03
    assert growth[1:, [5, 8]].max() < 1.1


def test_a_site_bears_on_the_cells_behind_its_footprint() -> None:
    """Independent check: of a block of cubes a disc over the corner of four bears on cells of their surface; a ball
    inside on the cells that its centre touches, and no further than a face beyond the eight cubes around it."""
    lines = np.linspace(0.0, 4.0, 5)
    body = tissue.elasticity(MeshTet.init_tensor(lines, lines, lines), tissue.Material(1.0, 0.3, 1.0), "P1")
    places = [(2.0, 2.0, 4.0), (2.0, 2.0, 2.0)]
    sites = tissue.build_sites(body, [tissue.Site(at, 0.5) for at in places])
    above, inside = tissue.cells_at(body, sites)
    centres = body.points[body.cells].mean(axis=1)
    assert above.size and (np.abs(centres[above] - places[0]) < 1.0).all()
    assert ((body.points[body.cells[above]][:, :, 2] == places[0][2]).sum(axis=1) == 3).all()
    assert (np.abs(centres[inside] - places[1]) < 1.5).all()
    touching = np.flatnonzero((body.points[body.cells] == np.array(places[1])).all(axis=2).any(axis=1))
    assert set(touching) <= set(inside)
