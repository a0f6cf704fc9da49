"""Cubes that rub on one another and on a slope, and what solves them without a thread, shared by the tests of contact's
friction."""

from dataclasses import replace
from typing import Any

import numpy as np
import skfem

import tissue
from coupling.integrators import BackwardEuler, Equilibrium
from coupling.joins.contact import Contact, find_sets
from meshes.block import block
from tests.tissue.test_surfaces import FAR, MEETING, SIDE, joined
from tests.tissue.wounds import SOFT, Array, organ_of

GRAVITY = 9.81


def cubes(h: tuple[float, float]) -> skfem.MeshTet:
    """A cube on a cube, with cells of sizes `h` above and below."""
    meshes = {"upper": block((SIDE,) * 3, h[0]), "lower": block((SIDE,) * 3, h[1])}
    return joined(meshes, {"upper": np.array([0.0, 0.0, SIDE]), "lower": np.zeros(3)})


def rough(gaps: tissue.Gaps, mu: float) -> tissue.Gaps:
    """The gaps with friction."""
    return tissue.Gaps(gaps.body, tuple(replace(part, friction=mu) for part in gaps.parts))


def rough_cubes(h: tuple[float, float], mu: float, element: str = "P1") -> tissue.QuasiStaticOrgan:
    """A cube on a cube, both held where they are farthest from one another."""
    body = tissue.elasticity(cubes(h), SOFT, element, FAR)
    return organ_of(body, rough(tissue.surface_gaps(body, [MEETING]), mu))


def on_slope(mu: float, slope: float, **options: Any) -> tuple[Any, float]:
    """A cube that lies on a plate which is inclined by `slope` [-], and what a rigid one is accelerated by as it slips
    [m/s²]."""
    meshes = {"upper": block((SIDE,) * 3, SIDE / 2), "lower": block((3 * SIDE, 3 * SIDE, SIDE / 2), 3 * SIDE)}
    mesh = joined(meshes, {"upper": np.array([0.0, 0.0, SIDE]), "lower": np.zeros(3)})
    body = tissue.elasticity(mesh, SOFT, "P1", ["lower_bottom", "lower_top"])
    along, down = np.sin(np.arctan(slope)), np.cos(np.arctan(slope))
    gaps = rough(tissue.surface_gaps(body, [MEETING]), mu)
    kind = options.pop("kind", tissue.DynamicOrgan)
    if kind is tissue.FiniteOrgan:
        options["law"] = tissue.Hyperelasticity(body)
    gravity = GRAVITY * np.array([along, 0.0, -down])
    return kind(body, tissue.build_sites(body, []), gravity, gaps=gaps, **options), GRAVITY * (along - mu * down)


def forces_of(answer: Any) -> Array:
    """Contact forces of an answer without a thread, those along the slips with them."""
    contact: Contact = Contact(answer.g_free, answer.C_cy, answer, answer.friction)
    first = np.zeros(len(answer.friction), dtype=bool), contact.stuck
    return find_sets(contact, np.zeros(0), *first)[2]


def at_rest_on(organ: Any, past: tuple[Any, ...] = ()) -> tissue.OrganState:
    """The organ under its constant load, from the reference or a state."""
    answer = organ.answer(Equilibrium(), list(past))
    return answer.accept(np.zeros(0), forces_of(answer))


def motion(organ: Any, dt: float, steps: int) -> list[tissue.OrganState]:
    """States of an organ with inertia, from rest."""
    out = [organ.start()]
    for k in range(steps):
        answer = organ.answer(BackwardEuler(dt), [out[-1]], (k + 1) * dt)
        p = forces_of(answer)
        while (again := answer.again(np.zeros(0), p)) is not answer:
            answer, p = again, forces_of(again)
        out.append(answer.accept(np.zeros(0), p))
    return out


def bear_uniform_strain(organ: Any, strain: Array) -> Array:
    """Move the held ends of two cubes with the field U = strain · x and let their sides bear its tractions, so that it
    is the answer where nothing slips; the field, shape `(N_all,)`."""
    body, material = organ.elasticity, organ.elasticity.material
    field, small = body.flat(body.points @ strain.T), 0.5 * (strain + strain.T)
    stress = material.lame_lambda * np.trace(small) * np.eye(3) + 2.0 * material.lame_mu * small
    load = body.K @ field
    for name, out in zip(MEETING, (-1.0, 1.0), strict=True):
        triangles = body.mesh.facets[:, body.mesh.boundaries[name]].T
        a, b, c = np.moveaxis(body.mesh.p.T[triangles], 1, 0)
        share = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None, None] / 3.0
        np.subtract.at(load, body.nodes[triangles], share * (out * stress[2]))
    held = np.zeros(body.N)
    held[body.clamped] = field[body.clamped]
    object.__setattr__(organ, "load", (load - body.K @ held)[body.free])
    return field
