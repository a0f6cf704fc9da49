"""Blocks with a cut, their organs and what presses their lips together, shared by the tests of contact."""

from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

import tissue
from coupling.integrators import Equilibrium
from coupling.joins.contact import Contact, find_sets
from meshes.grading import Grading
from meshes.wound import Wound, lips, wounded_block_structured
from tests.thread.threads import SITES

Array = NDArray[np.float64]
SIZE = (0.03, 0.02, 0.01)
SOFT = tissue.Material(1e5, 0.3, 1070.0)
SIDES = ("left", "right")


def cut_block(wound: Wound, h: float = 5e-3, size: tuple[float, float, float] = SIZE) -> skfem.MeshTet:
    """A structured block with a closed slit."""
    return wounded_block_structured(size, wound, Grading(h, h))


def whole_block(wound: Wound, h: float = 5e-3, size: tuple[float, float, float] = SIZE) -> skfem.MeshTet:
    """The very same tetrahedra, grown together."""
    cut = cut_block(wound, h, size)
    pairs = lips(cut, wound).nodes
    kept = np.arange(cut.nvertices)
    kept[pairs[:, 1]] = pairs[:, 0]
    used, t = np.unique(kept[cut.t], return_inverse=True)
    mesh = skfem.MeshTet(cut.p[:, used], t.reshape(cut.t.shape))
    half = size[0] / 2
    return mesh.with_boundaries({"left": lambda x: x[0] < 1e-9 - half, "right": lambda x: x[0] > half - 1e-9})


def opened(mesh: skfem.MeshTet, width: float) -> skfem.MeshTet:
    """The halves of a cut block drawn apart, so that its lips gape by `width` [m] where it is cut, less towards the
    ends of the cut, which stay where they are."""
    left, right = (np.unique(mesh.facets[:, mesh.boundaries[name]]) for name in ("lip_left", "lip_right"))
    p, shared = mesh.p.copy(), np.intersect1d(left, right)
    for nodes, sign in ((left, -0.5), (right, 0.5)):
        p[0, np.setdiff1d(nodes, shared)] += sign * width
    return skfem.MeshTet(p, mesh.t).with_boundaries(mesh.boundaries)


def gaps_on(body: tissue.Elasticity, wound: Wound, mesh: skfem.MeshTet | None = None) -> tissue.Gaps:
    """The gaps of a body on a cut block; `mesh`: that before it was opened."""
    pairs = lips(body.mesh if mesh is None else mesh, wound)
    return tissue.build_gaps(body, pairs.nodes, pairs.facets[:, 0], np.eye(3)[wound.normal_axis])


def organ_of(body: tissue.Elasticity, gaps: tissue.Gaps | None = None, **options: Any) -> tissue.QuasiStaticOrgan:
    """A quasi-static organ without piercings."""
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, []), gaps=gaps, **options)


def stretched(organ: tissue.QuasiStaticOrgan, strain: Array) -> Array:
    """Load the organ by moving its clamped nodes with the field U = strain · x; the field there, shape `(N_all,)`."""
    body = organ.elasticity
    field = body.flat(body.points @ strain.T)
    held = np.zeros(body.N)
    held[body.clamped] = field[body.clamped]
    object.__setattr__(organ, "load", -(body.K @ held)[body.free])
    return held


def contact_of(organ: Any) -> Contact:
    """The contact of an organ under its constant load alone."""
    answer = organ.answer(Equilibrium(), [organ.start()])
    return Contact(answer.g_free, answer.C_cy, answer)


def forced(g_free: Array, answer: Any, start: Any = None) -> Array:
    """Contact forces where the gaps would be `g_free` without them; the pressed pairs are sought from `start`."""
    contact, none = Contact(g_free, answer.C_cy, answer), np.zeros(0)
    first = np.zeros(len(g_free), dtype=bool) if start is None else start
    return find_sets(contact, none, first, contact.stuck)[2]


def at_rest(organ: Any, start: Any = None) -> tissue.OrganState:
    """The organ under its constant load, its lips held apart."""
    answer = organ.answer(Equilibrium(), [organ.start()])
    return answer.accept(np.zeros(0), forced(answer.g_free, answer, start))


def wounded_organ(
    inertia: bool,
    element: str = "P1",
    width: float = 0.0,
    h: float = 5e-3,
    E: float = 2e4,
    contact: bool = True,
    **options: Any,
) -> Any:
    """A block held below with a wound 12 mm long and 5 mm deep, the two sites of the hairpin next to it."""
    wound = Wound(0.012, 5e-3)
    closed = wounded_block_structured(SIZE, wound, Grading(h, h), SITES)
    mesh = opened(closed, width) if width else closed
    body = tissue.elasticity(mesh, tissue.Material(E, 0.45, 1070.0), element, ("bottom",))
    sites = tissue.build_sites(body, [tissue.Site(point, 2e-3, "parabolic", "normal") for point in SITES])
    gaps = gaps_on(body, wound, closed) if contact else None
    return (tissue.DynamicOrgan if inertia else tissue.QuasiStaticOrgan)(body, sites, gaps=gaps, **options)
