"""A shallow arch that a load presses through: no equilibrium is near, and the tissue creeps to the next one."""

from functools import cache
from typing import Any

import numpy as np
import skfem

import tissue
from coupling.integrators import Equilibrium
from coupling.laying import start
from coupling.run import Run, begin
from coupling.system import Piercing, System
from tests.bounds import RESIDUAL, TWO_SOLVERS
from tests.thread.threads import Array, Y
from thread.catalogue import suture
from thread.ends import Fixed, Pulled
from thread.knots import uniform_knots
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import MASS_POINTS, Thread

SPAN, WIDTH, THICK, RISE = 0.04, 4e-3, 0.5e-3, 4e-3  # m
LOAD = 16.0  # Pa, beyond what it bears
HALF = 0.02  # of the thread [m]


def crown(x: Array) -> Array:
    """Height of the arch's underside [m]."""
    return np.asarray(RISE * (1.0 - (2.0 * x / SPAN) ** 2))


def arch() -> tissue.FiniteOrgan:
    """A strip of P2 cells, held at both ends, with a dead load on its top and a hole in the middle."""
    lines = np.linspace(-SPAN / 2, SPAN / 2, 13), np.linspace(-WIDTH / 2, WIDTH / 2, 2), np.linspace(0.0, THICK, 2)
    flat = skfem.MeshTet.init_tensor(*lines).with_boundaries(
        {"top": lambda x: np.isclose(x[2], THICK), "ends": lambda x: np.isclose(np.abs(x[0]), SPAN / 2)}
    )
    p = flat.p.copy()
    p[2] += crown(p[0])
    body = tissue.elasticity(
        skfem.MeshTet(p, flat.t, _boundaries=flat.boundaries), tissue.Material(1e6, 0.3, 1000.0), "P2", ("ends",)
    )
    sites = tissue.build_sites(body, [tissue.Site((0.0, 0.0, RISE + THICK), 2e-3, "parabolic", None, subgrid=False)])
    load = tissue.SurfaceLoad("top", traction=(0.0, 0.0, -LOAD))
    return tissue.FiniteOrgan(body, sites, loads=[load], inertia=False)


@cache
def pressed() -> tuple[tissue.FiniteOrgan, list[Run]]:
    """The arch with a thread through its hole that is hardly drawn, in two load steps."""
    organ, at = arch(), np.array([0.0, 0.0, RISE + THICK])
    thread = Thread(Spline(uniform_knots(2.0 * HALF, 16)), suture("4-0 polypropylene"))
    ends = Fixed(at - HALF * Y), Pulled(1e-3 * Y)
    system: Any = System(thread, ends, organ, (Piercing("hole", directed=False),))
    path = at + (gauss_rule(thread.spline, MASS_POINTS).s[..., None] - HALF) * Y
    runs = [begin(system, start(system, np.array([HALF]), path, 1.0))]
    for share in (0.25, 1.0):
        runs.append(runs[-1].load(share, 1.0))
    return organ, runs


def lowest(organ: tissue.FiniteOrgan, run: Run) -> float:
    """How far the arch has gone down at most [m]."""
    return -float(organ.elasticity.nodal(organ.displacement(run.state.organ))[:, 2].min())


def test_an_arch_snaps_through_and_says_so() -> None:
    """Independent check: under a quarter of the load it stands, under all of it, it hangs through, in an equilibrium
    that holds: its tangent is definite. The event says so, once, and every joule is accounted for."""
    organ, (_, stands, through) = pressed()
    assert 0.0 < lowest(organ, stands) < 0.1 * RISE and lowest(organ, through) > RISE
    assert [event.kind for event in stands.events] == []
    assert [event.kind for event in through.events].count("snaps") == 1
    U = through.state.organ.U
    stiffness = np.linalg.eigvalsh(organ.law.tangent(organ.law.gradient(organ.whole(U))).toarray())
    assert stiffness.min() > 0.0
    audit = through.energies
    assert abs(audit.balance_error) <= 1e-7 * audit.external_work
    assert audit.numerical_dissipation > 0.1 * audit.external_work  # what the snap would have set in motion


def test_the_arch_hangs_where_newton_finds_it_from_below() -> None:
    """Independent check: the equilibrium of the same load that Newton finds from the arch turned over."""
    organ, (_, _, through) = pressed()
    state, body = through.state.organ, organ.elasticity
    over = np.zeros((len(body.points), 3))
    over[:, 2] = -2.0 * crown(body.points[:, 0])
    U = body.flat(over)[body.free]
    answer = organ.answer(Equilibrium(), [tissue.OrganState(U, 0.0 * U, 0.0 * U, state.f_y)], 1.0)
    for _ in range(50):
        after = answer.again(state.f_y, np.zeros(0))
        if after is answer:
            break
        answer = after
    point = answer.point
    assert np.abs(point.U - state.U).max() <= TWO_SOLVERS * np.abs(state.U).max()
    assert np.abs(point.r - organ.map.Z.T @ state.f_y[: organ.map.Z.shape[0]]).max() <= 10.0 * RESIDUAL * point.scale
