"""Estimates of the displacement and turn of a scenario's holes, before the first step.

The thread is taken as taut from hole to hole and free of friction, and each hole as a footprint on a half-space. Of 300
random scenarios (`studies.campaign`) 97 in 100 of those whose run left the linear range, or passed the suture's
strength, are found so, and 93 in 100 of those found did; of 70 that were drawn later 98 and 88. A thread in pieces is
not judged: its strands end at cuts.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import dist

import numpy as np

import tissue
from studies import scenario as model
from studies.arrays import Array
from studies.output.remarks import SMALL_ROTATION, SMALL_STRAIN, THREAD_STRAIN, Remark, remark
from studies.scenario import Piercing, Scenario
from thread.catalogue import Section
from thread.path import RoundedPath

ESTIMATE = 0.6  # of F/(E a): displacement of a footprint under a tangential force F
BENT = 1.6  # of EI θ/ℓ: couple of a thread that is bent by θ within the way ℓ to the next hole
MILLI = 1e-3


def demanding(
    scenario: Scenario, section: Section, path: RoundedPath, s: Array, E: Array, strength: float | None
) -> list[Remark]:
    """Return remarks on the predicted displacement and turn of holes at the abscissae `s` (p,) of the `path` [m] in
    tissue of E (p,) [Pa], infinite without an organ; and on loads above the thread's `strength` [N], None if
    unknown."""
    holes, length = scenario.piercing, scenario.thread.length or path.length
    springs = np.array([spring(hole, modulus) for hole, modulus in zip(holes, E, strict=True)])
    tensions = strand_tensions(scenario, length, section.EA, springs)
    loads = [float(tensions.max()), *(tie.force for tie in scenario.tie)]
    out = overpulled(max(loads), strength, section.EA)
    if scenario.tissue is None or scenario.tissue.material != "linear":
        return out
    EI = section.EI if scenario.thread.bending else 0.0
    whole = slice(len(holes)), tensions, directions(scenario), spacings(scenario)
    forces, turns = np.zeros(len(holes)), np.zeros(len(holes))
    for part, T, ways, spacing in [*([] if scenario.thread.cuts else [whole]), *loops(scenario)]:
        bent = turns_of(holes[part], E[part], EI, T, ways, spacing, path.tangent(s[part]))
        forces[part] = np.maximum(forces[part], hole_forces(T, ways))
        turns[part] = np.maximum(turns[part], bent)
    return [*out, *overdrawn(holes, springs, forces), *overturned(holes, turns)]


def loops(scenario: Scenario) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield for each tie its m holes, and the tensions [N], directions [-] and spacings [m] of the strands of its loop,
    shapes `(m + 1,)`, `(m + 1, 3)` and `(m + 1,)`: the hands draw it straight from hole to hole."""
    holes, names = scenario.piercing, [hole.name for hole in scenario.piercing]
    for tie in scenario.tie:
        first, last = sorted(map(names.index, tie.between))
        places = np.array([holes[k].place for k in (last, *range(first, last + 1), first)])
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        ways = np.diff(places, axis=0) / np.maximum(lengths, np.finfo(float).tiny)[:, None]
        yield slice(first, last + 1), np.full(len(ways), tie.force), ways, np.full(len(ways), shortest(scenario))


def moduli_at(body: tissue.Elasticity | None, holes: Sequence[Piercing]) -> Array:
    """Return E of the cell nearest to each hole, infinite without an organ, shape `(p,)` [Pa]."""
    if body is None:
        return np.full(len(holes), np.inf)
    middles = body.mesh.p[:, body.mesh.t].mean(axis=1).T
    nearest = [int(np.linalg.norm(middles - hole.place, axis=1).argmin()) for hole in holes]
    return np.broadcast_to(np.asarray(body.material.youngs_modulus, dtype=float), len(middles))[nearest]


def spring(hole: Piercing, E: float) -> float:
    """Return the stiffness of a hole against a force, E a/0.6, infinite for a bare point [N/m]."""
    return E * hole.footprint / ESTIMATE if hole.footprint else float("inf")


def corners(scenario: Scenario) -> Array:
    """Return the two ends of the thread where they are led to, with the holes in between, shape `(p + 2, 3)` [m]."""
    ends = [scenario.thread.path[0], scenario.thread.path[-1]]
    for k, end in enumerate((scenario.thread.start, scenario.thread.end)):
        ends[k] = end.position(scenario.solve.duration) if isinstance(end, model.DrivenEnd) else ends[k]
    return np.array([ends[0], *(hole.place for hole in scenario.piercing), ends[1]])


def directions(scenario: Scenario) -> Array:
    """Return where the strands lead to along the thread, shape `(p + 1, 3)` [-]; to a load by its direction."""
    ways = np.diff(corners(scenario), axis=0)
    for k, sign, end in ((0, -1.0, scenario.thread.start), (-1, 1.0, scenario.thread.end)):
        if isinstance(end, model.PulledEnd):
            ways[k] = sign * np.array(end.force)
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), np.finfo(float).tiny))


def strand_tensions(scenario: Scenario, length: float, EA: float, springs: Array) -> Array:
    """Return the tension of each strand, shape `(p + 1,)` [N]: of the loads on the ends as far as the first anchored
    hole, and of a thread that is held at both ends and too short for them, by the `springs` (p,) [N/m] of its holes."""
    holes, out = scenario.piercing, np.zeros(len(scenario.piercing) + 1)
    anchors = [k for k, hole in enumerate(holes) if hole.kind == "anchored"]
    first, last = (anchors[0], anchors[-1]) if anchors else (len(holes), -1)
    ends = (scenario.thread.start, scenario.thread.end)
    for end, reached in zip(ends, (slice(0, first + 1), slice(last + 1, None)), strict=True):
        if isinstance(end, model.PulledEnd):
            out[reached] = np.maximum(out[reached], np.linalg.norm(end.force))
    for k, hole in enumerate(holes):
        pulls = [row[1] for row in hole.pull or () if len(row) > 1]
        out[k] = max(out[k], *pulls, 0.0)
        out[k + 1] = max(out[k + 1], *(-pull for pull in pulls), 0.0)
    if anchors or scenario.thread.cuts or out.any() or any(isinstance(end, model.FreeEnd) for end in ends):
        return out
    short = float(np.linalg.norm(np.diff(corners(scenario), axis=0), axis=1).sum()) - length
    unit = hole_forces(np.ones(len(out)), directions(scenario))
    return np.full(len(out), max(short, 0.0) / (length / EA + float(unit**2 @ (1.0 / springs))))


def hole_forces(tensions: Array, ways: Array) -> Array:
    """Return the force of the thread on each hole, shape `(p,)` [N]."""
    along = tensions[:, None] * ways
    return np.asarray(np.linalg.norm(np.diff(along, axis=0), axis=1))


def overpulled(tension: float, strength: float | None, EA: float) -> list[Remark]:
    """Judge a pull [N] by the strength of the suture [N], and by how far it stretches a thread of EA [N]."""
    if strength is not None and tension > strength:
        what = f"its knot-pull strength is {strength:.3g} N (minimum average)"
    elif tension > THREAD_STRAIN * EA:
        what = f"its linear law is valid up to {THREAD_STRAIN * EA:.3g} N (strain {THREAD_STRAIN:.0%})"
    else:
        return []
    text = f"the thread is loaded by {tension:.3g} N, but {what}; use a stronger suture, or a smaller load"
    return [remark("pull-strength", "thread", text)]


def overdrawn(holes: Sequence[Piercing], springs: Array, forces: Array) -> list[Remark]:
    """Judge how far `forces` (p,) [N] would draw holes of `springs` (p,) [N/m]; the worst of them is named."""
    ways = forces / springs
    demands = [float(way / hole.footprint) if way else 0.0 for way, hole in zip(ways, holes, strict=True)]
    beyond = [k for k, demand in enumerate(demands) if demand > SMALL_STRAIN]
    if not beyond:
        return []
    worst = max(beyond, key=demands.__getitem__)
    also = f", and {len(beyond) - 1} other holes too far" if len(beyond) > 1 else ""
    text = (
        f"the load of {forces[worst]:.2g} N would move the hole {holes[worst].name!r} by about "
        f"{ways[worst] / MILLI:.2g} mm{also}: {demands[worst]:.2g} of its footprint, above the limit of linear "
        f"elasticity (about {SMALL_STRAIN:g}); use a smaller load, stiffer tissue or a wider footprint"
    )
    return [remark("demand", holes[worst].name, text)]


def spacings(scenario: Scenario) -> Array:
    """Return within which length each strand bends where it is slack, shape `(p + 1,)` [m]: the shortest between two
    holes, or that to a hand, and infinite from one hole alone to no hand."""
    out = np.full(len(scenario.piercing) + 1, shortest(scenario))
    for k, end in ((0, scenario.thread.start), (-1, scenario.thread.end)):
        if not isinstance(end, model.FreeEnd | model.PulledEnd):
            out[k] = min(out[k], np.linalg.norm(np.diff(corners(scenario), axis=0)[k]))
    return out


def shortest(scenario: Scenario) -> float:
    """Return the shortest way from a hole to the next that is elsewhere, infinite if there is none [m]."""
    gaps = (dist(a.place, b.place) for a, b in pairwise(scenario.piercing))
    return min((gap for gap in gaps if gap), default=np.inf)


def turns_of(
    holes: Sequence[Piercing], E: Array, EI: float, tensions: Array, ways: Array, spacing: Array, through: Array
) -> Array:
    """Return how far the couple of a thread of a stiffness EI [N m²] turns the holes that give it a direction, from
    their directions `through` them (p, 3) to the `ways` (p + 1, 3) of its strands of `tensions` (p + 1,) [N], which
    bend within a `spacing` (p + 1,) [m]; zero of the other holes, shape `(p,)` [rad]."""
    out = np.zeros(len(holes))
    for k in [k for k, hole in enumerate(holes) if hole.direction != "free" and hole.footprint]:
        bends = np.arccos(np.clip(ways[k : k + 2] @ through[k], -1.0, 1.0))
        taut = 2.0 * np.sin(0.5 * bends) * np.sqrt(EI * tensions[k : k + 2])
        slack = BENT * EI * bends / spacing[k : k + 2]
        out[k] = max(taut.max(), slack.max()) / (E[k] * holes[k].footprint ** 3)
    return out


def overturned(holes: Sequence[Piercing], turns: Array) -> list[Remark]:
    """Judge how far the couple of the thread `turns` holes (p,) [rad]; the worst of them is named."""
    if not turns.max(initial=0.0) > SMALL_ROTATION:
        return []
    worst = int(np.argmax(turns))
    text = (
        f"the thread is too stiff for this tissue: its couple would turn the hole {holes[worst].name!r} by "
        f"about {turns[worst]:.2g} rad, above the limit of linear elasticity (about {SMALL_ROTATION:g}); use a "
        "thinner or softer suture, stiffer tissue or a wider footprint"
    )
    return [remark("stiff-thread", holes[worst].name, text)]
