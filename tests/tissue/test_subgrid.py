"""A hole smaller than the mesh: kernels of the unbounded body, and coarse meshes that answer like fine ones."""

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshTet

import tissue
from coupling.integrators import Equilibrium
from meshes.block import block, graded_block_structured
from meshes.grading import Grading
from tests.bounds import IDENTITY, RESIDUAL, SUBGRID, TWO_SOLVERS
from tests.tissue.layers import layer_compliance, stack_compliance
from tissue.sites import footprint, subgrid, unbounded
from tissue.sites.site import frame

Array = NDArray[np.float64]
E, NU, R = 1.0e5, 0.45, 1.0e-3
FIBRE = [0.3, 0.1, 1.0]
SIZES = np.repeat([1.0, R], [3, 6])  # brings couples to the size of forces


def organ(mesh: MeshTet, element: str, holes: list[tissue.Site], nu: float = NU) -> tissue.QuasiStaticOrgan:
    body = tissue.elasticity(mesh, tissue.Material(E, nu, 1000.0), element, ["bottom"])
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, holes))


def compliance(mesh: MeshTet, element: str, holes: list[tissue.Site], nu: float = NU) -> Array:
    """Compliance of each hole to forces and couples of one size, `(p, 9, 9)` times Er."""
    C, p = organ(mesh, element, holes, nu).operator(0.0, 0.0).C, len(holes)
    own = np.array([C[9 * k : 9 * k + 9, 9 * k : 9 * k + 9] for k in range(p)])
    return E * R * SIZES[:, None] * own * SIZES


def hole(point: list[float], direction: object = "normal", weight: str = "parabolic") -> tissue.Site:
    return tissue.Site(point, R, weight, direction, subgrid=True)  # type: ignore[arg-type]


def mismatch(got: Array, exact: Array) -> float:
    """Largest error of a compliance, each entry on the scale of its two diagonals."""
    scale = np.sqrt(np.diag(exact))
    return float(np.abs((got - exact) / scale / scale[:, None]).max())


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_kernels_of_the_unbounded_body(nu: float) -> None:
    """Independent check: Kelvin averaged over the uniform ball; the forces and the couple of DATA's disc; a turn of the
    frame about the normal changes nothing."""
    G = 1.0 / (2.0 * (1.0 + nu))
    ball = unbounded.ball_compliance("uniform", nu)
    assert ball[0, 0] == pytest.approx((10.0 - 12.0 * nu) / 3.0 * 1.2 / (16.0 * np.pi * G * (1.0 - nu)), rel=IDENTITY)
    disc = unbounded.disc_compliance("parabolic", nu)
    S = 2048.0 / (315.0 * np.pi)
    assert disc[2, 2] == pytest.approx((1.0 - nu**2) * S / np.pi, rel=IDENTITY)
    assert disc[0, 0] == pytest.approx((1.0 + nu) * (2.0 - nu) * S / (2.0 * np.pi), rel=IDENTITY)
    assert disc[9, 9] == pytest.approx(128.0 * (1.0 - nu**2) / (15.0 * np.pi**2), rel=IDENTITY)
    half = unbounded.half_ball_compliance("parabolic", nu)
    c, s = np.cos(0.4), np.sin(0.4)
    Q = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turn = np.zeros((12, 12))
    turn[:3, :3], turn[3:, 3:] = Q, np.kron(Q, Q)
    for C in (ball, disc, half):
        assert np.abs(C - C.T).max() <= RESIDUAL * np.abs(C).max()
        assert np.abs(turn @ C @ turn.T - C).max() <= RESIDUAL * np.abs(C).max()
        assert np.linalg.eigvalsh(C).min() > -RESIDUAL


def test_half_ball_kernel_against_boussinesq_and_cerruti() -> None:
    """Independent check of the answers of the slopes to forces: the point-force fields summed over the disc, their
    slopes over the half ball. The sums of points near one another leave 2 %."""
    half = unbounded.half_ball_compliance("parabolic", NU)
    disc, ball = footprint.disc("parabolic"), footprint.ball("parabolic")
    below = np.flatnonzero(ball.points[:, 2] < 0.0)
    step, slopes = 1e-5, np.zeros((3, 3, 3))
    for j in range(3):
        for sign in (1.0, -1.0):
            offset = ball.points[below][:, None] + sign * step * np.eye(3)[j] - disc.points
            field = np.einsum("kqab,q->kab", unbounded.surface_force(offset, NU), disc.weights)
            slopes[:, j] += sign / (2.0 * step) * np.einsum("k,kab->ab", 2.0 * ball.weights[below], field)
    assert np.abs(slopes.reshape(9, 3) - half[3:, :3]).max() <= 0.02 * np.abs(half[3:, :3]).max()


@pytest.mark.parametrize(("element", "ratio"), [("P1", 10.0), ("P1", 5.0), ("P1", 2.0), ("P1", 0.5), ("P2", 10.0)])
def test_a_coarse_mesh_answers_as_a_layer_does(element: str, ratio: float) -> None:
    """Independent check, cells of 10 to ½ radii: a layer of 30 radii on a rigid base, by Hankel transform, and couples
    on a half-space in closed form, within 3 %. The mesh alone has as little as a tenth of that."""
    width, H = 100.0 * R, 30.0 * R
    off = [0.0, 0.0, 0.0] if ratio < 5.0 else [0.31 * ratio * R, 0.17 * ratio * R, 0.0]
    if ratio >= 5.0:
        mesh = block((width, width, H), ratio * R)
    else:
        mesh = graded_block_structured((width, width, H), Grading(10.0 * R, ratio * R, 1.45, R), [off])
    C = compliance(mesh, element, [hole(off)])[0]
    normal, tangential = layer_compliance("parabolic", R, H, E, NU)
    couple = np.diag(unbounded.disc_compliance("parabolic", NU))[[3, 6, 9]]
    exact = np.concatenate([[tangential * E * R] * 2, [normal * E * R], couple])
    assert np.diag(C)[:6] == pytest.approx(exact, rel=0.03)
    if ratio == 10.0:
        bare = tissue.Site(off, R, "parabolic", "normal")
        assert (np.diag(compliance(mesh, element, [bare])[0])[:6] < 0.3 * exact).all()


def test_a_coarse_mesh_answers_as_a_fine_one_inside_and_along_a_cut() -> None:
    """Consistency check: every entry of the compliance, forces, couples and their coupling, of a fibre frame on the
    surface and of holes inside, within 3 % of its diagonals."""
    holes = [hole([0.0, 0.0, 0.0], FIBRE), hole([0.0, 0.0, -0.012], FIBRE), hole([0.0, 0.0, -0.012], FIBRE, "uniform")]
    size = (0.04, 0.04, 0.024)
    centres = [[0.0, 0.0, 0.0], [0.0, 0.0, -0.012]]
    fine = compliance(graded_block_structured(size, Grading(6e-3, 1.5 * R, 3.0, R), centres), "P2", holes)
    coarse = compliance(block(size, 6e-3), "P1", holes)
    for got, exact in zip(coarse, fine, strict=True):
        assert mismatch(got, exact) <= 0.03


@pytest.mark.parametrize("contrast", [1.0, 0.2, 5.0])
def test_what_is_added_fades_under_refinement(contrast: float) -> None:
    """Cells of half the size miss less than half (P2, one cell to the radius), and the whole stays where it is; with a
    layer of one radius on another material, too."""
    shares, whole = [], []
    for cells in (0.5, 1.0):
        line = np.concatenate([np.arange(0.0, 2.0, 1.0 / cells), [2.0, 5.0, 12.0]])
        down = np.union1d(line, [1.0])
        both = R * np.concatenate([-line[:0:-1], line])
        mesh = MeshTet.init_tensor(both, both, -R * down[::-1]).with_boundaries({"bottom": lambda x: x[2] < -11.9 * R})
        above = mesh.p[2, mesh.t].mean(axis=0) > -R
        body = tissue.elasticity(mesh, tissue.Material(np.where(above, contrast * E, E), 0.3, 1000.0), "P2", ["bottom"])
        sites = tissue.build_sites(body, [hole([0.0, 0.0, 0.0])])
        gap = sites.missing[0]
        assert gap is not None and gap.by == ("unbounded body" if contrast == 1.0 else "patch")
        shares.append(gap.share)
        whole.append(np.diag(tissue.QuasiStaticOrgan(body, sites).operator(0.0, 0.0).C)[:3])
    assert shares[1] < 0.5 * shares[0]
    assert whole[0] == pytest.approx(whole[1], rel=0.03)


def test_springs_leave_the_organ_what_it_was() -> None:
    """Consistency check: C with springs is C without and BBᵀ; the energy is that of both; the mesh moves as before."""
    mesh, force = block((0.03, 0.02, 0.01), 5e-3), np.linspace(-1.0, 2.0, 9)
    plain = organ(mesh, "P1", [tissue.Site([0.0, 0.0, 0.0], R, "parabolic", FIBRE)])
    soft = organ(mesh, "P1", [hole([0.0, 0.0, 0.0], FIBRE)])
    B = soft.sites.springs.toarray()
    C = plain.operator(0.0, 0.0).C + B @ B.T
    assert np.abs(soft.operator(0.0, 0.0).C - C).max() <= IDENTITY * np.abs(C).max()
    state = soft.answer(Equilibrium(), [soft.start()]).accept(force)
    assert soft.energies(soft.start(), state).elastic == pytest.approx(0.5 * force @ C @ force, rel=1e-10)
    U = plain.displacement(plain.answer(Equilibrium(), [plain.start()]).accept(force))
    assert np.abs(soft.displacement(state) - U).max() <= 1e-10 * np.abs(U).max()


def test_a_uniform_weight_has_no_couple_to_make_up_for_and_a_bare_point_nothing() -> None:
    holes = [
        hole([0.0, 0.0, 0.0], "normal", "uniform"),
        tissue.Site([0.0, 0.0, 0.0], 0.0, "parabolic", "normal", subgrid=True),
    ]
    sites = organ(block((0.03, 0.02, 0.01), 5e-3), "P1", holes).sites
    gap = sites.missing[0]
    assert gap is not None
    assert np.abs(gap.springs[:3]).max() > 0.0 and np.abs(gap.springs[3:]).max() == 0.0
    assert sites.missing[1] is None


@pytest.mark.parametrize(
    ("points", "by"),
    [
        ([[0.0, 0.0, 0.0]], ["unbounded body"]),
        ([[0.013, 0.0, 0.0]], ["patch"]),
        ([[-0.008, 0.0, 0.0], [0.008, 0.0, 0.0]], ["unbounded body", "unbounded body"]),
        ([[-0.0015, 0.0, 0.0], [0.0015, 0.0, 0.0]], ["patch", "patch"]),
        ([[0.0, 0.0, -0.002]], ["patch"]),
        ([[0.0128, 0.0013, 0.0]], ["patch"]),
    ],
)
def test_what_is_near_a_hole_is_seen(points: list[list[float]], by: list[str]) -> None:
    """An edge, another hole, or the surface above a hole inside, nearer than a cell."""
    direction = [0.0, 0.0, 1.0]
    sites = organ(block((0.03, 0.02, 0.01), 2.5e-3), "P1", [hole(point, direction) for point in points]).sites
    assert [gap is not None and gap.holds and gap.by for gap in sites.missing] == by


def layered(element: str, cells: float, contrast: float, thickness: float) -> tuple[tissue.Elasticity, tissue.Site]:
    """A layer of `contrast` times the modulus below it, 8 radii in all, 80 wide; a hole off its nodes; in radii."""
    off = [0.31 * cells * R, 0.17 * cells * R, 0.0]
    grading, planes = Grading(max(6.0, cells) * R, cells * R, 1.45, R), ((), (), (-thickness * R,))
    mesh = graded_block_structured((80.0 * R, 80.0 * R, 8.0 * R), grading, [off], planes)
    above = mesh.p[2, mesh.t].mean(axis=0) > -thickness * R
    material = tissue.Material(np.where(above, contrast * E, E), NU, 1000.0)
    return tissue.elasticity(mesh, material, element, ["bottom"]), hole(off)


@pytest.mark.parametrize(
    ("element", "cells", "contrast", "thickness"),
    [
        ("P1", 4.0, 10.0, 0.5),
        ("P1", 4.0, 0.1, 0.5),
        ("P1", 2.0, 0.1, 1.0),
        ("P1", 0.5, 0.1, 2.0),
        ("P2", 4.0, 10.0, 2.0),
        ("P2", 4.0, 0.1, 1.0),
    ],
)
def test_a_hole_in_a_layer(element: str, cells: float, contrast: float, thickness: float) -> None:
    """Independent check, forces and couples: two layers on a rigid base by Hankel transform. By the closed form for one
    material such holes are wrong by up to 87 %."""
    body, site = layered(element, cells, contrast, thickness)
    C = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, [site])).operator(0.0, 0.0).C
    exact = stack_compliance(R, [thickness * R, (8.0 - thickness) * R], [contrast * E, E], NU)
    assert np.diag(C)[:6] == pytest.approx(exact, rel=SUBGRID)


@pytest.mark.parametrize("thickness", [1.0, 4.0])
def test_linear_cells_that_stiffen_a_skin_far_around_get_no_springs(thickness: float) -> None:
    """What linear cells of half a radius owe to a stiff skin does not settle within a patch, or farther out than that
    reaches, and the record says so."""
    body, site = layered("P1", 0.5, 10.0, thickness)
    sites = tissue.build_sites(body, [site])
    gap = sites.missing[0]
    assert gap is not None and not gap.holds and gap.by == "nothing" and gap.share == 0.0
    assert sites.springs.shape == (9, 0)


def test_two_holes_at_an_edge_answer_as_on_a_fine_mesh() -> None:
    """Consistency check: every entry of the compliance of two holes, half a radius from one another and from an edge,
    against cells of second order and 0.4 radii without springs."""
    size, centres = (12.0 * R, 10.0 * R, 6.0 * R), [[4.5 * R, -1.25 * R, 0.0], [4.5 * R, 1.25 * R, 0.0]]
    fine = graded_block_structured(size, Grading(2.0 * R, 0.4 * R, 1.7, R), centres)
    bare = [tissue.Site(centre, R, "parabolic", "normal") for centre in centres]
    exact = organ(fine, "P2", bare).operator(0.0, 0.0).C
    got = organ(block(size, 2.0 * R), "P1", [hole(centre) for centre in centres]).operator(0.0, 0.0).C
    assert mismatch(got, exact) <= SUBGRID


def test_a_hole_deep_inside_answers_as_alone_whatever_stands_near_it() -> None:
    """Independent check: holes are averages and no voids, so a second one near a hole changes nothing of its own
    compliance. Alone that is the unbounded body's; of two it is a patch's, none of whose facets is the organ's."""
    mesh = block((0.04, 0.04, 0.032), 4e-3)
    both = [hole([x, 0.0, -0.016], FIBRE) for x in (-1.5 * R, 1.5 * R)]
    shared, alone = organ(mesh, "P1", both), organ(mesh, "P1", both[:1])
    found = [gap.by for gap in (*shared.sites.missing, *alone.sites.missing) if gap is not None]
    assert found == ["patch", "patch", "unbounded body"]
    got, exact = (SIZES[:, None] * each.operator(0.0, 0.0).C[:9, :9] * SIZES for each in (shared, alone))
    assert mismatch(got, exact) <= SUBGRID


def test_a_small_body_that_nothing_holds_is_looked_at_as_if_it_were_alone() -> None:
    """Consistency check: beside another body, which is held, a small one gets the springs that it gets by itself."""
    one, other = block((6 * R, 6 * R, 6 * R), 3 * R), block((10 * R, 10 * R, 10 * R), 5 * R)
    away = np.array([[20 * R], [0.0], [0.0]])
    both = MeshTet(np.hstack([other.p + away, one.p]), np.hstack([other.t, one.t + other.nvertices]))
    both = both.with_boundaries({"floor": lambda x: (x[0] > 10 * R) & (x[2] < other.p[2].min() + IDENTITY)})
    material, at = tissue.Material(E, NU, 1000.0), [hole([0.0, 0.0, float(one.p[2].max())])]
    bodies = [tissue.elasticity(one, material, "P1", []), tissue.elasticity(both, material, "P1", ["floor"])]
    alone, beside = (tissue.build_sites(body, at).missing[0] for body in bodies)
    assert alone is not None and beside is not None and alone.by == "patch"
    B, found = alone.springs, beside.springs
    assert B.size and np.abs(found @ found.T - B @ B.T).max() <= TWO_SOLVERS * np.abs(B @ B.T).max()


def test_holes_that_share_the_whole_body_answer_as_each_alone() -> None:
    """Consistency check: two holes at either edge of a small body, whose patches come to be all of it, once for both,
    have the springs of each by itself."""
    mesh, centres = block((12.0 * R, 8.0 * R, 4.0 * R), 2.0 * R), [[-4.75 * R, 0.0, 0.0], [4.75 * R, 0.5 * R, 0.0]]
    both = organ(mesh, "P1", [hole(centre) for centre in centres]).sites.missing
    for centre, found in zip(centres, both, strict=True):
        (alone,) = organ(mesh, "P1", [hole(centre)]).sites.missing
        assert alone is not None and found is not None and found.by == alone.by == "patch"
        B, C = alone.springs, found.springs
        assert B.size and np.abs(C @ C.T - B @ B.T).max() <= TWO_SOLVERS * np.abs(B @ B.T).max()


def test_a_patch_that_is_soon_the_whole_body_grows_to_what_it_grew_to_step_by_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Consistency check: taking the whole body at once where a patch would hold most of it changes a hole's compliance
    by less than what the steps to it leave to come."""
    mesh, holes = block((20.0 * R, 12.0 * R, 4.0 * R), 2.0 * R), [hole([-8.75 * R, 0.0, 0.0])]
    at_once = compliance(mesh, "P1", holes)[0]
    monkeypatch.setattr(subgrid, "MOSTLY", 1.0)
    assert mismatch(compliance(mesh, "P1", holes)[0], at_once) <= subgrid.TO_COME


def test_holes_that_are_solved_finer_one_by_one_answer_as_on_one_patch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistency check: of a chain of many holes those further apart than their radii together are solved finer by
    themselves; all entries of two of them, 1.2 diameters between their rims on cells of 3 radii, cross compliance
    included."""
    mesh, holes = block((24.0 * R, 18.0 * R, 3.0 * R), 3.0 * R), [hole([x * R, 0.0, 0.0]) for x in (-2.2, 2.2)]
    together = organ(mesh, "P1", holes).operator(0.0, 0.0).C
    monkeypatch.setattr(subgrid, "FEW", 1)
    apart = organ(mesh, "P1", holes).operator(0.0, 0.0).C
    assert 0.0 < mismatch(apart, together) <= 0.03


def test_the_frame_of_the_kernels_is_that_of_the_site() -> None:
    """A hole on a side face: the same block turned gives the same compliance, turned."""
    mesh = block((0.03, 0.03, 0.03), 6e-3)
    turned = MeshTet(mesh.p[[2, 0, 1]], mesh.t).with_boundaries({"bottom": mesh.boundaries["bottom"]})
    top = compliance(mesh, "P1", [hole([0.001, 0.002, 0.0], [0.2, 0.1, 1.0])])[0]
    side = compliance(turned, "P1", [hole([0.0, 0.001, 0.002], [1.0, 0.2, 0.1])])[0]
    P = np.eye(3)[[2, 0, 1]]
    a, b = (np.column_stack(frame(np.array(t) / np.linalg.norm(t))) for t in ([0.2, 0.1, 1.0], [1.0, 0.2, 0.1]))
    change = np.kron((P @ a).T @ b, np.eye(3))  # the frames (u, v) differ by a turn about the fibre
    whole = np.zeros((9, 9))
    whole[:3, :3], whole[3:, 3:] = P, change.T @ np.kron(np.eye(2), P)
    assert mismatch(whole @ top @ whole.T, side) <= 1e-6
