"""Estimates of the displacement and turn of a scenario's holes, before the first step.

Each strand is either taut between holes, without friction, or slack in an arc. Each hole is a
footprint on a half-space, larger if its cells are coarse. The estimate was made on 138 random
scenarios (`studies.campaign.generator`, seeds 21 and 22). Of the runs that left the linear range or
exceeded the suture's strength it finds 99 %. Of the runs that it finds, 89 % did so. For a thread
in pieces only the loops of ties are judged, because its strands end at cuts.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import hypot

import numpy as np

import tissue
from studies.arrays import MILLI, Array
from studies.output.remarks import Remark, bounds, judged, remark
from studies.scenario import DrivenEnd, FreeEnd, Piercing, PulledEnd, Scenario
from thread.catalogue import Section

# ∫ (8 J₂(x)/x²)²/π dx: a half-space under a parabolic weight yields by (1 + ν)(1 − ν/2) F/(E a) times this, and under a
# uniform weight by a fifth less
MOVES = 0.659
TURNS = 0.75  # of (1 − ν²) M/(E a³): turn of a rigid disc on a half-space (Johnson, Contact Mechanics, 1985)
HAT = {"P1": 1.0, "P2": 0.5}  # of a cell: reach of one node's share of a force
BENT = 2.0  # times EI θ/ℓ: couple of a slack strand of length ℓ, an arc turned by θ at both ends
STRAIGHT = 1e-9  # sine of an angle, above the round-off of directions, 1e-16


def demanding(
    scenario: Scenario,
    section: Section,
    tangents: Array,
    s: Array,
    length: float,
    E: Array,
    radii: Array,
    strength: float | None,
) -> list[Remark]:
    """Return remarks on predicted motions of holes and on loads above the thread's strength.

    The motions are displacements and turns. The thread has a rest `length` [m], and the holes are
    at its abscissae `s` (p,) [m] with the `tangents` (p, 3) of its path. They bear within `radii`
    (p,) [m] on tissue of modulus E (p,) [Pa], infinite without an organ. `strength` is the thread's
    strength [N], None if unknown.
    """
    holes = scenario.piercing
    nu = scenario.tissue.poisson_ratio if scenario.tissue else 0.5
    springs = E * radii / (MOVES * (1.0 + nu) * (1.0 - 0.5 * nu))
    tensions = strand_tensions(scenario, s, length, section.EA, springs)
    drawn = list(loops(scenario, s))
    loads = [float(tensions.max()), *(float(T.max()) for _, T, _, _ in drawn)]
    out = overpulled(max(loads), strength, section.EA)
    if scenario.tissue is None or scenario.tissue.material != "linear":
        return out
    EI = section.EI if scenario.thread.bending else 0.0
    whole = slice(0, len(holes)), tensions, directions(scenario), slack_lengths(scenario, s, length)
    forces, turns = np.zeros(len(holes)), np.zeros(len(holes))
    for part, T, ways, lengths in [*([] if scenario.thread.cuts else [whole]), *drawn]:
        through = tangents[part]
        at = ways_at_holes(ways, through, borne(scenario)[part.start : part.stop - 1])
        bent = couples(EI, T, at, lengths, through) * TURNS * (1.0 - nu**2) / (E[part] * radii[part] ** 3)
        forces[part] = np.maximum(forces[part], hole_forces(T, at))
        turns[part] = np.maximum(turns[part], bent)
    turns *= [hole.direction != "free" for hole in holes]
    return [*out, *overdrawn(holes, forces / springs, radii, forces), *overturned(holes, turns)]


def borne(scenario: Scenario) -> Array:
    """Return whether the strand from a hole to the next bears on a tract, shape `(p - 1,)`."""
    tracts = {tract.between for tract in scenario.tract}
    return np.array([(one.name, other.name) in tracts for one, other in pairwise(scenario.piercing)], dtype=bool)


def ways_at_holes(ways: Array, through: Array, borne: Array) -> Array:
    """Return the directions of the thread before and after holes, shape `(2, p, 3)` [-].

    These are the directions `ways` (p + 1, 3) of its strands. Along a tract they are the directions
    `through` the holes (p, 3), because the tract turns the thread there.
    """
    out = np.stack([ways[:-1], ways[1:]])
    out[1, :-1][borne], out[0, 1:][borne] = through[:-1][borne], through[1:][borne]
    return out


def loops(scenario: Scenario, s: Array) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield for each tie its m holes, and tensions, directions and lengths of its strands.

    Shapes are `(m + 1,)` [N], `(m + 1, 3)` [-] and `(m + 1,)` [m]. Two hands draw the loop straight
    from hole to hole, with the knot midway, at a speed proportional to their force. A loop stays
    slack if its length between the holes at `s` (p,) [m] exceeds the length that they draw.
    """
    holes, names = scenario.piercing, [hole.name for hole in scenario.piercing]
    for tie in (tie for tie in scenario.tie if tie.from_ < scenario.solve.duration):
        first, last = sorted(map(names.index, tie.between))
        places = np.array([holes[k].place for k in (last, *range(first, last + 1), first)])
        ways = np.diff(places, axis=0)
        straight = np.maximum(np.linalg.norm(ways, axis=1), np.finfo(float).tiny)
        laid = np.diff(s[first : last + 1])
        slack = np.where(borne(scenario)[first:last], 0.0, laid - straight[1:-1]).sum()
        drawn = 2.0 * tie.speed * (min(tie.until, scenario.solve.duration) - tie.from_ - 0.5 * tie.growth)
        force = tie.force if scenario.solve.kind == "static" or drawn > slack else 0.0
        lengths = np.concatenate([0.5 * straight[:1], laid, 0.5 * straight[-1:]])
        tensions = np.full(len(straight), force)
        yield slice(first, last + 1), tensions, ways / straight[:, None], lengths


def moduli_at(body: tissue.Elasticity | None, holes: Sequence[Piercing]) -> Array:
    """Return the modulus of the cell nearest to each hole, shape `(p,)` [Pa].

    It is infinite without an organ.
    """
    if body is None:
        return np.full(len(holes), np.inf)
    middles = body.mesh.p[:, body.mesh.t].mean(axis=1).T
    nearest = [int(np.linalg.norm(middles - hole.place, axis=1).argmin()) for hole in holes]
    return np.broadcast_to(np.asarray(body.material.youngs_modulus, dtype=float), len(middles))[nearest]


def radii_at(holes: Sequence[Piercing], sizes: Sequence[float], element: str) -> Array:
    """Return the radius within which each hole bears on tissue, shape `(p,)` [m].

    It is √(a² + h²), because squared widths add in repeated averages. Here a is the footprint, and
    h the reach of a node's force in cells of `sizes` (p,) [m]. The radius is infinite for a bare
    point, which is not judged.
    """
    each = zip(holes, sizes, strict=True)
    return np.array([hypot(hole.footprint, HAT[element] * size) if hole.footprint else np.inf for hole, size in each])


def corners(scenario: Scenario) -> Array:
    """Return both final ends of the thread, with the holes in between, shape `(p + 2, 3)` [m]."""
    ends = [scenario.thread.path[0], scenario.thread.path[-1]]
    for k, end in enumerate(scenario.thread.ends):
        ends[k] = end.position(scenario.solve.duration) if isinstance(end, DrivenEnd) else ends[k]
    return np.array([ends[0], *(hole.place for hole in scenario.piercing), ends[1]])


def directions(scenario: Scenario) -> Array:
    """Return the directions of the strands along the thread, shape `(p + 1, 3)` [-].

    A strand with a pulled end has the direction of the load.
    """
    ways = np.diff(corners(scenario), axis=0)
    for k, sign, end in zip((0, -1), (-1.0, 1.0), scenario.thread.ends, strict=True):
        if isinstance(end, PulledEnd):
            ways[k] = sign * np.array(end.force)
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), np.finfo(float).tiny))


def strand_tensions(scenario: Scenario, s: Array, length: float, EA: float, springs: Array) -> Array:
    """Return the tension of each strand, shape `(p + 1,)` [N].

    Loads on the ends act up to the first anchored hole. A thread of `length` [m] held at both ends
    can be too short: it then stretches, and the `springs` (p,) [N/m] of its holes yield. It runs
    straight from hole to hole, or in a tract along its path between the holes at `s` (p,) [m].
    """
    holes, out = scenario.piercing, np.zeros(len(scenario.piercing) + 1)
    anchors = [k for k, hole in enumerate(holes) if hole.kind == "anchored"]
    first, last = (anchors[0], anchors[-1]) if anchors else (len(holes), -1)
    ends = scenario.thread.ends
    for end, reached in zip(ends, (slice(0, first + 1), slice(last + 1, None)), strict=True):
        if isinstance(end, PulledEnd):
            out[reached] = np.maximum(out[reached], np.linalg.norm(end.force))
    for k, hole in enumerate(holes):
        pulls = [row[1] for row in hole.pull or () if len(row) > 1]
        out[k] = max(out[k], *pulls, 0.0)
        out[k + 1] = max(out[k + 1], *(-pull for pull in pulls), 0.0)
    if anchors or scenario.thread.cuts or out.any() or any(isinstance(end, FreeEnd) for end in ends):
        return out
    lengths = np.linalg.norm(np.diff(corners(scenario), axis=0), axis=1)
    lengths[1:-1] = np.where(borne(scenario), np.diff(s), lengths[1:-1])
    short = float(lengths.sum()) - length
    ways = directions(scenario)
    unit = hole_forces(np.ones(len(out)), np.stack([ways[:-1], ways[1:]]))
    return np.full(len(out), max(short, 0.0) / (length / EA + float(unit**2 @ (1.0 / springs))))


def hole_forces(tensions: Array, at: Array) -> Array:
    """Return the force of the thread on each hole, shape `(p,)` [N].

    `at` (2, p, 3) are the directions of the thread before and after the holes.
    """
    return np.asarray(np.linalg.norm(tensions[1:, None] * at[1] - tensions[:-1, None] * at[0], axis=1))


def overpulled(tension: float, strength: float | None, EA: float) -> list[Remark]:
    """Return a remark on a tension [N] that the suture or its linear law does not bear.

    The bounds are the `strength` of the suture [N], None if unknown, and the linear range of a
    thread of EA [N].
    """
    if strength is not None and tension > strength:
        what = f"its knot-pull strength is {strength:.3g} N (minimum average)"
    elif tension > bounds.THREAD_STRAIN * EA:
        what = f"its linear law is valid up to {bounds.THREAD_STRAIN * EA:.3g} N (strain {bounds.THREAD_STRAIN:.0%})"
    else:
        return []
    return [remark("pull-strength", "thread", tension=tension, what=what)]


def overdrawn(holes: Sequence[Piercing], ways: Array, radii: Array, forces: Array) -> Iterator[Remark]:
    """Yield a remark on the displacements `ways` (p,) [m] of holes under `forces` (p,) [N].

    The holes bear within `radii` (p,) [m]; the worst hole is named.
    """
    demands = (ways / radii).tolist()
    strained = [k for k, demand in enumerate(demands) if demand > bounds.EARLY_STRAIN]
    if strained:
        worst = max(strained, key=demands.__getitem__)
        others = len(strained) - 1
        also = f", and {others} other hole{'s' * (others > 1)} too much" if others else ""
        words = {"force": forces[worst], "way": ways[worst] / MILLI, "strain": demands[worst], "also": also}
        yield remark("demand", holes[worst].name, **words)


def slack_lengths(scenario: Scenario, s: Array, length: float) -> Array:
    """Return the bending length of each slack strand, shape `(p + 1,)` [m].

    The thread of `length` [m] passes holes at `s` (p,) [m]. The result is infinite for a strand
    with an unheld end, and for a strand of no length.
    """
    out = np.diff(np.concatenate([[0.0], s, [length]]))
    for k, end in zip((0, -1), scenario.thread.ends, strict=True):
        out[k] = np.inf if isinstance(end, FreeEnd | PulledEnd) else out[k]
    return np.where(out > 0.0, out, np.inf)


def couples(EI: float, tensions: Array, at: Array, lengths: Array, through: Array) -> Array:
    """Return the couple of a thread of stiffness EI [N m²] on its holes, shape `(p,)` [N m].

    The couple turns the directions `through` the holes (p, 3) to the directions before and after
    them, `at` (2, p, 3). The strands have `tensions` (p + 1,) [N]; slack strands bend within
    `lengths` (p + 1,) [m].
    """
    out = np.zeros((len(through), 3))
    for ways, strands in zip(at, (slice(None, -1), slice(1, None)), strict=True):
        axes = np.cross(through, ways)
        sines = np.linalg.norm(axes, axis=1)
        bends = np.arctan2(sines, (through * ways).sum(axis=1))
        back = (sines < STRAIGHT) & (bends > 0.5 * np.pi)  # a reversed thread can turn about any axis across the hole
        axes[back], sines[back] = across(through[back]), 1.0
        taut, slack = 2.0 * np.sin(0.5 * bends) * np.sqrt(EI * tensions[strands]), BENT * EI * bends / lengths[strands]
        out += (np.maximum(taut, slack) / np.maximum(sines, np.finfo(float).tiny))[:, None] * axes
    return np.asarray(np.linalg.norm(out, axis=1))


def across(ways: Array) -> Array:
    """Return unit vectors perpendicular to unit vectors (p, 3), shape `(p, 3)` [-]."""
    axes = np.cross(ways, np.eye(3)[np.abs(ways).argmin(axis=1)])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def overturned(holes: Sequence[Piercing], turns: Array) -> list[Remark]:
    """Return a remark on holes that the couple of the thread `turns` (p,) [rad].

    The worst hole is named.
    """
    if not len(holes):
        return []
    worst = int(np.argmax(turns))
    return judged(turns[worst] > bounds.EARLY_ROTATION, "stiff-thread", holes[worst].name, turn=turns[worst])
