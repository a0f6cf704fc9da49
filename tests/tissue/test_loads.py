"""Loads on boundaries: resultants, closed forms of a bar and of a thick tube, and where their work goes."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from skfem import MeshTet

import tissue
from coupling.integrators import BDF2, BackwardEuler, Equilibrium
from tests.bounds import IDENTITY, RESIDUAL
from tissue.loads import Loads, SurfaceLoad

Array = NDArray[np.float64]
E, NU = 2.0e4, 0.3
MATERIAL = tissue.Material(E, NU, 1070.0)
SIZE = np.array([0.03, 0.02, 0.01])
FACES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}
PULL = (300.0, -50.0, 100.0)  # Pa


def bar(element: str, clamp: tuple[str, ...] = (), roller: tuple[str, ...] = ()) -> tissue.Elasticity:
    """A bar from the origin, with its faces named as a block's."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, size, n) for size, n in zip(SIZE, (4, 3, 3), strict=True)))
    named = {
        name: (lambda x, axis=axis, end=end: np.abs(x[axis] - end * SIZE[axis]) < 1e-9)
        for name, (axis, end) in FACES.items()
    }
    return tissue.elasticity(mesh.with_boundaries(named), MATERIAL, element, clamp, roller=roller)


def quarter_tube(inner: float, outer: float, across: int, around: int) -> MeshTet:
    """A quarter of a slice of a tube about z, by planes of symmetry x = 0 and y = 0."""
    lines = np.linspace(0.0, 1.0, across + 1), np.linspace(0.0, 1.0, around + 1), np.linspace(0.0, 1.0, 2)
    square = MeshTet.init_tensor(*lines)
    r, angle, z = inner + (outer - inner) * square.p[0], 0.5 * np.pi * square.p[1], (outer - inner) * square.p[2]
    x, y = r * np.cos(angle), r * np.sin(angle)
    x[square.p[1] == 1.0], y[square.p[1] == 0.0] = 0.0, 0.0
    mesh = MeshTet(np.array([x, y, z]), square.t)
    named = {name: square.facets_satisfying(where) for name, where in {
        "inner": lambda p: p[0] < 1e-9, "outer": lambda p: p[0] > 1.0 - 1e-9, "y0": lambda p: p[1] < 1e-9,
        "x0": lambda p: p[1] > 1.0 - 1e-9, "low": lambda p: p[2] < 1e-9, "high": lambda p: p[2] > 1.0 - 1e-9,
    }.items()}  # fmt: skip
    return mesh.with_boundaries(named)


def at_rest(body: tissue.Elasticity, *loads: SurfaceLoad) -> Array:
    """Displacement in equilibrium under the loads, a vector per node."""
    organ = tissue.QuasiStaticOrgan(body, tissue.build_sites(body, []), loads=loads)
    answer = organ.answer(Equilibrium(), [organ.start()])
    return body.nodal(organ.displacement(answer.accept(np.zeros(0))))


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_resultants_are_force_per_area_times_area(element: str) -> None:
    """Independent check: of a traction and of a pressure on a plane, of pressure all round, which leaves neither force
    nor moment, and of a pressure that follows a body as it turns."""
    body = bar(element)
    each = (SurfaceLoad("right", traction=PULL), *(SurfaceLoad(name, pressure=200.0) for name in FACES))
    loads = Loads(body, each)
    area = np.prod(SIZE) / SIZE
    assert loads.areas[0] == pytest.approx(area[0], rel=IDENTITY)
    assert loads.resultants[0] == pytest.approx(np.array(PULL) * area[0], rel=IDENTITY)
    for k, (axis, end) in enumerate(FACES.values(), start=1):
        outward = (2.0 * end - 1.0) * np.eye(3)[axis]
        assert np.abs(loads.resultants[k] + 200.0 * area[axis] * outward).max() <= IDENTITY * 200.0 * area.max()
    around = sum(loads.forces(k, body.points) for k in range(1, 7))
    assert np.abs(around.sum(axis=0)).max() <= IDENTITY * 200.0 * area.max()
    moment = np.cross(body.points, around).sum(axis=0)
    assert np.abs(moment).max() <= IDENTITY * 200.0 * area.max() * SIZE.max()
    turn = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    turned, still = loads.forces(1, body.points @ turn.T), loads.forces(1, body.points)
    assert np.abs(turned - still @ turn.T).max() <= IDENTITY * np.abs(still).max()
    angle = np.arccos(0.5 * (np.trace(turn) - 1.0))
    assert 0.0 < loads.turns(body.points @ turn.T - body.points)[1] <= angle * (1.0 + IDENTITY)
    assert loads.turns(body.points @ turn.T - body.points)[0] == 0.0


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_bar_under_tension_is_exact(element: str) -> None:
    """Independent check: u = (σ/E)(x, −νy, −νz) is in the discrete space, under a traction and under suction."""
    body = bar(element, roller=("left", "front", "bottom"))
    exact = 100.0 / E * body.points * [1.0, -NU, -NU]
    for load in (SurfaceLoad("right", traction=(100.0, 0.0, 0.0)), SurfaceLoad("right", pressure=-100.0)):
        assert np.abs(at_rest(body, load) - exact).max() <= RESIDUAL * np.abs(exact).max()
    around = [SurfaceLoad(name, pressure=100.0) for name in ("right", "back", "top")]
    squeezed = -100.0 * (1.0 - 2.0 * NU) / E * body.points
    assert np.abs(at_rest(body, *around) - squeezed).max() <= RESIDUAL * np.abs(squeezed).max()


def test_a_thick_tube_under_pressure() -> None:
    """Independent check: Lamé's tube in plane strain, u_r = (1+ν)p a²/(E(b²−a²)) ((1−2ν)r + b²/r); straight facets
    miss the circle by a part of h², and so does the answer."""
    inner, outer, p, errors = 0.01, 0.02, 500.0, []
    for n in (2, 4):
        mesh = quarter_tube(inner, outer, n, 3 * n)
        body = tissue.elasticity(mesh, MATERIAL, "P2", roller=("x0", "y0", "low", "high"))
        r = np.linalg.norm(body.points[:, :2], axis=1)
        on = np.flatnonzero(np.abs(r[: body.mesh.nvertices] - inner) < 1e-9)
        U = at_rest(body, SurfaceLoad("inner", pressure=p))
        moved = np.sum(U[on, :2] * body.points[on, :2], axis=1) / inner
        exact = (1.0 + NU) * p * inner**2 / (E * (outer**2 - inner**2)) * ((1.0 - 2.0 * NU) * inner + outer**2 / inner)
        errors.append(float(np.abs(moved / exact - 1.0).max()))
    assert errors[1] < 0.01 and errors[0] / errors[1] > 2.0**1.7


@pytest.mark.parametrize("inertia", [True, False])
def test_the_work_of_the_loads_goes_somewhere(inertia: bool) -> None:
    """Independent check: the work of force times way of the loads, with the force at the end of each step, is kinetic
    and elastic energy and what damping and integrator take, by every way to step; a ramp gives the load its share."""
    body, site = bar("P1", clamp=("left",)), tissue.Site(0.5 * SIZE * [1, 1, 2], 2e-3, "parabolic", "normal")
    each = (SurfaceLoad("right", traction=PULL, course=((0.0, 0.0), (2.5e-3, 1.0))), SurfaceLoad("top", pressure=80.0))
    given: dict[str, Any] = {"gravity": (0.0, 0.0, -9.81), "loads": each}
    sites = tissue.build_sites(body, [site])
    organ: tissue.DynamicOrgan | tissue.QuasiStaticOrgan
    organ = tissue.DynamicOrgan(body, sites, rayleigh=(2.0, 1e-3), **given) if inertia else tissue.QuasiStaticOrgan(
        body, sites, **given
    )  # fmt: skip
    columns = Loads(body, each).columns
    dt, past = 1e-3, [organ.start()]
    f_y = np.array([5e-3, 2e-3, 1e-2, *np.zeros(6)])
    for step in range(1, 5):
        scheme = BDF2(dt, dt) if len(past) > 1 else BackwardEuler(dt)
        answer = organ.answer(scheme, past, step * dt)
        new, old = answer.accept(step * f_y), past[0]
        shares = [min(step / 2.5, 1.0), 1.0]
        assert new.shares == pytest.approx(shares, rel=IDENTITY)
        audit, before = organ.energies(old, new), organ.energies(old, old)
        dU = organ.displacement(new) - organ.displacement(old)
        work = (columns @ shares + body.body_force(np.array([0.0, 0.0, -9.81]))) @ dU
        assert audit.load_work == pytest.approx(work, rel=1e-9)
        at_sites = step * f_y @ (organ.site_variables(new) - organ.site_variables(old))
        stored = audit.kinetic + audit.elastic - before.kinetic - before.elastic
        scale = abs(audit.load_work) + abs(at_sites)
        assert abs(at_sites + audit.load_work - stored - audit.viscous - audit.numerical) <= RESIDUAL * scale
        past = [new, old]


def test_refusals() -> None:
    """Independent check: what is no load is refused in words."""
    with pytest.raises(tissue.TissueError, match="a traction or a pressure"):
        SurfaceLoad("top")
    with pytest.raises(tissue.TissueError, match="a traction or a pressure"):
        SurfaceLoad("top", PULL, 1.0)
    with pytest.raises(tissue.TissueError, match="course do not rise"):
        SurfaceLoad("top", pressure=1.0, course=((0.0, 0.0), (0.0, 1.0)))
    with pytest.raises(tissue.TissueError, match=r"'lid'.*bottom"):
        at_rest(bar("P1", ("left",)), SurfaceLoad("lid", pressure=1.0))
    body = bar("P1", ("left",))
    inside = body.mesh.with_boundaries({"cut": np.flatnonzero(body.mesh.f2t[1] >= 0)[:1]})
    with pytest.raises(tissue.TissueError, match="inside the organ"):
        at_rest(tissue.elasticity(inside, MATERIAL, "P1", ["left"]), SurfaceLoad("cut", pressure=1.0))
