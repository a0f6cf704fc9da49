"""Remarks on a run: from its assembly before the first step, from its largest values at the end.

Each function judges one quantity by plain numbers and returns its remarks. The bounds are in the
catalogue, `studies.output.remarks`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from math import dist
from operator import itemgetter
from typing import Any

import numpy as np

import tissue
from coupling.reports.audit import Energies
from coupling.reports.observation import PiercingObservation
from coupling.rest.equilibrium import slides_freely
from meshes.quality import size_at
from studies.arrays import MILLI, Array
from studies.lists import list_of
from studies.output import records
from studies.output.remarks import Remark, bounds, judged, remark, say
from studies.scenario import Contact, FreeEnd, Piercing, PulledEnd, Scenario, Tie, WoundMesh, dotted_key
from studies.simulation.assembly import Assembly, section_of
from studies.simulation.given import Given, shear_moduli
from studies.simulation.meshing import wound_of
from studies.simulation.tracts import Ball, gaps_of, radius_of
from studies.simulation.wound import BEYOND
from studies.verdicts import BETWEEN, RESOLVED, SETTLED, unrest
from thread.catalogue import knot_pull
from thread.path import rounded_path
from thread.thread import Thread
from thread.vectors import curvature

ROUND_OFF = 1e-10  # of a distance between holes
SHARP = 1e-3  # of the diameter: radius of the corners of a path that counts as its lines
LOOKS = 9  # places between two holes at which the depth of the thread is computed
# For each key the least and largest value of organs and sutures, its unit, and other units.
PLAUSIBLE = list_of(__file__, "plausible.toml")


def foreseen(assembly: Assembly, q: Array) -> Iterator[Remark]:
    """Yield the remarks before the first step, for a thread with control points `q` (n, c) [m]."""
    scenario, system, body = assembly.scenario, assembly.system, assembly.body
    thread = system.thread
    yield from unlike_units(values_of(assembly))
    yield from off_path(assembly)
    if thread.bending and not thread.coil:
        yield from bent_sharply(*sharpest_bend(thread, q), thread.section.diameter)
    yield from handed_over(assembly.given, body)
    yield from after_end(times_of(scenario), scenario.solve.duration)
    yield from rest_unloaded(scenario)
    free = scenario.solve.kind == "static" and slides_freely(system, system.rows[:, 0])
    yield from judged(free, "slides-freely", "piercing")
    if body is not None:
        yield from foreseen_in_organ(assembly, body)


def foreseen_in_organ(assembly: Assembly, body: tissue.Elasticity) -> Iterator[Remark]:
    """Yield the remarks on the organ before the first step."""
    scenario, fit = assembly.scenario, assembly.fit
    for hole in scenario.piercing:
        yield from coarse_cells(hole, size_at(body.mesh, np.array(hole.place)), body.element, fit is not None)
    accuracy = scenario.tissue.mesh.accuracy if scenario.tissue else "given"
    if fit is not None and accuracy != "given":
        named = zip(assembly.holes, fit.errors.tolist(), strict=True)
        errors = {hole.name: error for hole, error in named}
        yield from inaccurate(accuracy, errors, fit.rounds[-1].unknowns)
    yield from near_holes(scenario.piercing)
    yield from moved_holes(scenario.piercing)
    yield from steep_friction(scenario.contact)
    yield from unheld(scenario)
    yield from not_across(scenario)
    yield from along_path(assembly, body)


def times_of(scenario: Scenario) -> dict[str, float]:
    """Return the times of scheduled events [s], by their keys."""
    begins = {hole.key("from"): hole.from_ for hole in scenario.piercing}
    ties = {
        dotted_key(["stitch" if tie.name in scenario.stitches else "tie", tie.name, key]): time
        for tie in scenario.tie
        for key, time in (("from", tie.from_), ("until", tie.until))
    }
    changes = ((key, load.last_change(scenario.solve.duration, load.ramp)) for key, load in scenario.loads.items())
    loads = {f"{key}.{name}": time for key, (name, time) in changes}
    return begins | ties | loads | {f"cut.{k}.time": table.time for k, table in enumerate(scenario.cut)}


def rest_unloaded(scenario: Scenario) -> Iterator[Remark]:
    """Yield remarks on ramps of dead loads on a thread that starts at rest."""
    for key, end in (("thread.start", scenario.thread.start), ("thread.end", scenario.thread.end)):
        if scenario.solve.start == "rest" and isinstance(end, PulledEnd) and end.ramp:
            yield remark("rest-unloaded", key, ramp=end.ramp)


def after_end(times: Mapping[str, float], duration: float) -> list[Remark]:
    """Return remarks on events after the end of a run of a `duration` [s]."""
    late = {key: time for key, time in times.items() if time > duration}
    return [remark("after-end", key, time=time, duration=duration) for key, time in late.items()]


def handed_over(given: Given, body: tissue.Elasticity | None) -> list[Remark]:
    """Return remarks on parts of the run that came from Python."""
    if not given.unrecorded:
        return []
    mu, moduli = 0.0 if body is None else float(np.max(body.material.lame_mu)), ""
    if (density := given.distortion(mu)) is not None:
        least, largest = shear_moduli(density)
        moduli = f"; its initial shear modulus is {least:.4g} to {largest:.4g} Pa, E and ν give {mu:.4g} Pa"
    out = [remark("handed-over", "prepare", unsaid=", ".join(given.unrecorded), moduli=moduli)]
    return out + judged(given.stiffness is not None, "stress-of-e-nu", "tissue")


def met(assembly: Assembly, ending: records.Ending) -> Iterator[Remark]:
    """Yield the remarks on a run with an `ending`."""
    scenario, (step, extremes) = assembly.scenario, ending
    names = [hole.name for hole in scenario.piercing]
    strengths = [hole.strength for hole in assembly.system.piercings if not hole.tract]
    dynamic, diameter = scenario.solve.kind == "dynamic", assembly.system.thread.section.diameter
    if not isinstance(assembly.organ, tissue.FiniteOrgan):
        yield from beyond_at_holes(names, extremes)
        yield from beyond_in_tissue(extremes)
    yield from torn(names, extremes, strengths)
    suture = scenario.thread.suture
    yield from beyond_bounds(extremes, knot_pull(suture) if suture else None)
    yield from stiff_in_tracts(scenario, step.tracts)
    yield from assumed_channels(scenario.piercing, step.piercings)
    yield from coarse_spans(step.span_ratio, step.spans_between)
    share = unrest_at_end(step.energy, extremes.elastic)
    if not (dynamic and share > SETTLED):
        yield from judged(not step.would_stay, "would-not-stay", "solve")
    yield from judged(step.unstable, "tissue-unstable", "solve")
    yield from along_branch(extremes.branches, extremes.fallen / scenario.solve.duration)
    if dynamic:
        judged_steps = extremes if scenario.solve.start == "path" else replace(extremes, settling=0.0)
        yield from audited(step.energy, judged_steps, rubs(assembly) or not names, has_slid(assembly, step))
        yield from unsettled(share, step.slide_speed * step.time, diameter)
    if (strands := step.strands) is not None:
        holes = {hole.name: hole.s for hole in step.piercings}
        yield from on_strands(strands, holes, diameter, extremes.tension, assembly.system.bears)
    yield from left_holes(scenario.piercing, step)
    yield from undone(scenario, step)
    yield from kept_knots(scenario.tie, dict(zip(names, extremes.off_law.tolist(), strict=True)), extremes.tension)
    yield from locked_off(scenario.tie, extremes.locked, dynamic)
    if dynamic:
        yield from swinging(extremes.swing)
        yield from chattering(names, extremes.chattered)


def beyond_at_holes(names: Sequence[str], extremes: records.Extremes) -> Iterator[Remark]:
    """Yield remarks on strain and turn of the tissue at the holes."""
    strains, turns = (zip(names, each, strict=True) for each in (extremes.mean_strain, extremes.turn))
    strained = [(strain, name, {"strain": strain}) for name, strain in strains if strain > bounds.SMALL_STRAIN]
    turned = [(turn, name, {"turn": turn}) for name, turn in turns if turn > bounds.SMALL_ROTATION]
    yield from worst_of(strained, "hole-strain", "holes")
    yield from worst_of(turned, "hole-rotation", "holes")


def worst_of(found: Sequence[tuple[float, str, dict[str, Any]]], code: str, kind: str) -> list[Remark]:
    """Return one remark of this code on the worst that was `found`, or none.

    Each has its measure, its name and the values of the message, which also says how many such
    parts of this `kind`, in the plural, there are.
    """
    if not found:
        return []
    _, name, values = max(found, key=itemgetter(0))
    among = f" (the worst of {len(found)} such {kind})" if len(found) > 1 else ""
    return [remark(code, name, among=among, **values)]


def beyond_in_tissue(extremes: records.Extremes) -> Iterator[Remark]:
    """Yield remarks on strain and rotation of the organ's cells."""
    strain, rotation = extremes.strain, extremes.rotation
    strained, rotated = extremes.share(extremes.strained), extremes.share(extremes.rotated)
    code = "tissue-strain" if strained > bounds.SHARE else "local-strain"
    turns = rotation > bounds.SMALL_ROTATION and rotated > bounds.SHARE
    yield from judged(strain > bounds.SMALL_STRAIN, code, "tissue", strain=strain, share=strained)
    yield from judged(turns, "tissue-rotation", "tissue", rotation=rotation, share=rotated)


def torn(names: Sequence[str], extremes: records.Extremes, strengths: Sequence[float]) -> Iterator[Remark]:
    """Yield remarks on the pressure at holes above the tissue's strength [Pa].

    The strength is infinite if unknown.
    """
    each = zip(names, extremes.bearing_pressure.tolist(), strengths, strict=True)
    found = [
        (pressure / strength, name, {"pressure": pressure, "strength": strength})
        for name, pressure, strength in each
        if pressure > strength
    ]
    yield from worst_of(found, "tears", "holes")


def assumed_channels(holes: Sequence[Piercing], observed: Sequence[PiercingObservation]) -> Iterator[Remark]:
    """Yield a remark on an assumed channel whose length affects friction.

    The hole is named whose friction depends most on this length.
    """
    losses: list[tuple[list[float], float, str]] = []
    for hole, found in zip(holes, observed, strict=True):
        if hole.channel is not None or found.channel is None or hole.friction is None:
            continue
        across = float(np.linalg.norm(found.force - found.tangential_force * found.tangent))
        half, twice = 2.0 * found.normal_force, max(across, 0.5 * found.normal_force)
        friction = hole.friction.kinetic * np.array([half, found.normal_force, twice])
        unsure = friction[0] - friction[2] > bounds.UNSURE * max(found.tension_before, 0.0)
        if unsure and found.normal_force > bounds.RULES * across:
            losses.append((friction.tolist(), found.channel, found.name))
    if losses:
        (half, now, twice), channel, name = max(losses)
        key = dotted_key(["piercing", name, "channel"])
        yield remark("channel", name, channel=channel / MILLI, now=now, half=half, twice=twice, key=key)


def beyond_bounds(extremes: records.Extremes, strength: float | None) -> Iterator[Remark]:
    """Yield remarks on single largest values of a run.

    These are the turn of pressed surfaces, the overlap of lips without contact, the tension of the
    thread over its `strength` [N], None if unknown, and its strain.
    """
    turn, crossed, strain = extremes.pressed_turn, extremes.crossed, extremes.thread_strain
    tension, breaks = extremes.tension, np.inf if strength is None else strength
    yield from judged(turn > bounds.SMALL_ROTATION, "pressure-turn", "tissue.load", turn=turn)
    yield from judged(crossed > bounds.CROSSED, "lips-cross", "tissue.mesh", crossed=crossed)
    yield from judged(tension > breaks, "thread-strength", "thread", tension=tension, strength=breaks)
    yield from judged(strain > bounds.THREAD_STRAIN, "thread-strain", "thread", strain=strain)


def coarse_spans(ratio: float, number: float | None = None) -> Iterator[Remark]:
    """Yield remarks if spans are too long for the bends at the holes, or between two holes.

    `ratio` is a step's `span_ratio`, and `number` its `spans_between`.
    """
    few = number is not None and number < BETWEEN
    yield from judged(ratio > RESOLVED, "spans", "thread.control_points", ratio=ratio, limit=RESOLVED)
    yield from judged(few, "spans-between", "thread.control_points", number=number, limit=BETWEEN)


def along_branch(branches: float, fallen: float) -> Iterator[Remark]:
    """Yield remarks on load steps that followed a branch by arc length.

    `branches` is the number of these steps. `fallen` is the decrease of the loads along the branch,
    as a share of the full loads.
    """
    yield from judged(branches >= 1.0, "branch", "solve", branches=branches)
    yield from judged(fallen > bounds.FALLEN, "limit-point", "solve", fallen=fallen)


def rubs(assembly: Assembly) -> bool:
    """Return whether the run has friction, so that its end depends on its history."""
    return bool(assembly.system.rough.any()) or any(pair.friction for pair in assembly.scenario.contact)


def has_slid(assembly: Assembly, step: records.StepRecord) -> bool:
    """Return whether a thread with friction was drawn through a hole by more than its diameter."""
    limit = bounds.SLID * assembly.system.thread.section.diameter
    return bool(assembly.system.rough.any()) and any(abs(hole.slip) > limit for hole in step.piercings)


def audited(energy: Energies, extremes: records.Extremes, rough: bool, slid: bool) -> list[Remark]:
    """Return remarks on energy that the time steps created or dissipated.

    `rough`: the run has friction. `slid`: the thread slid far. The first step is judged
    separately, because the energy of the laid thread does not depend on the length of the steps.
    """
    scale, created, settling = extremes.energy, extremes.created, extremes.settling
    dissipated = energy.numerical_dissipation - settling
    out, effect = [], ""
    if created > bounds.CREATED * scale:
        out.append(remark("energy-created", "solve", created=created, share=created / scale, energy=scale))
    if dissipated > bounds.DISSIPATED * scale and (rough or extremes.swing > bounds.SWUNG):
        effect = say("damped", share=dissipated / scale, energy=scale)
    elif slid and dissipated > bounds.OUTDONE * energy.friction_dissipation:
        effect = say("outdone", friction=energy.friction_dissipation)
    elif settling > bounds.DISSIPATED * scale and rough:
        dissipated = settling
        effect = say("settled", share=settling / scale, energy=scale)
    return out + judged(bool(effect), "numerical-dissipation", "solve.dt", dissipated=dissipated, effect=effect)


def unrest_at_end(energy: Energies, elastic: float) -> float:
    """Return the kinetic over elastic energy at the end of a run with the largest `elastic` energy [J].

    A deformation of 1 % of the largest or less counts as 1 %: where nearly all was released, as by
    a cut, both energies are round-off.
    """
    return unrest(energy.kinetic, max(energy.of_deformation, SETTLED * elastic))


def unsettled(share: float, slide: float, diameter: float) -> list[Remark]:
    """Return a remark if a run did not come to rest.

    One criterion is the `share` of its kinetic energy. The other is the length `slide` [m] that a
    thread of `diameter` [m] slides in another run of the same duration.
    """
    moves, limit = share > SETTLED, bounds.SLID * diameter
    signs = [f"the kinetic energy is {share:.2g} of the elastic energy (limit {SETTLED:g})"] if moves else []
    way = f"{slide / MILLI:.2g} mm in another such run (limit {limit / MILLI:.2g} mm)"
    signs += [f"at its final speed the thread would slide by {way}"] if slide > limit else []
    return judged(bool(signs), "not-at-rest", "solve.duration", signs=", and ".join(signs))


def left_holes(holes: Sequence[Piercing], step: records.StepRecord) -> list[Remark]:
    """Return a remark on holes that the thread has left at the end of a run.

    Only holes that have begun and not ended are considered.
    """
    left = [
        found.name
        for hole, found in zip(holes, step.piercings, strict=True)
        if found.state == "left" and hole.from_ < step.time < (hole.until or np.inf)
    ]
    words = f"hole{'s' * (len(left) > 1)} {', '.join(map(repr, left))}"
    return judged(bool(left), "hole-left", left[0] if left else "", holes=words, time=step.time)


def undone(scenario: Scenario, step: records.StepRecord) -> Iterator[Remark]:
    """Yield remarks on ties that have begun but are open at the end of a run.

    A tie whose loop is cut is not considered.
    """
    cuts = [cut.s for cut in scenario.cut if cut.time <= step.time]
    for tie, found in zip(scenario.tie, step.ties, strict=True):
        is_cut = any(found.s_first <= s <= found.s_second for s in cuts)
        is_undone = found.state == "open" and tie.from_ < step.time and not is_cut
        yield from judged(is_undone, "tie-undone", tie.name, time=step.time)


def kept_knots(ties: Sequence[Tie], off_law: Mapping[str, float], tension: float) -> Iterator[Remark]:
    """Yield remarks on ties whose hands kept the knot between its holes by a force along the thread.

    `off_law` are the violations of Coulomb's law [N] by holes while hands drew, and `tension` [N] is the largest
    of the run.
    """
    for tie in ties:
        force = max(off_law[name] for name in tie.between)
        yield from judged(force > bounds.OFF_LAW * tension, "knot-kept", tie.name, holes=tie.between, force=force)


def locked_off(ties: Sequence[Tie], forces: Array, dynamic: bool) -> Iterator[Remark]:
    """Yield remarks on ties locked below or above their force.

    `forces` (t,) [N] are NaN for a tie that was not locked. In statics, where hands have no speed,
    only a `hold` keeps a tie below its force.
    """
    for tie, force in zip(ties, forces.tolist(), strict=True):
        yield from judged(dynamic and force < bounds.LOCKED * tie.force, "tie-slack", tie.name, tie=tie, force=force)
        yield from judged(force > tie.force / bounds.LOCKED, "tie-tight", tie.name, tie=tie, force=force)


def swinging(swing: float) -> list[Remark]:
    """Return a remark if the force of a hole oscillates over the last steps.

    `swing` is its deviation from a straight line, as a share of the largest force.
    """
    return judged(swing > bounds.SWUNG, "forces-swing", "solve.dt", swing=swing)


def chattering(names: Sequence[str], times: Array) -> Iterator[Remark]:
    """Yield a remark on holes that changed often between stick and slip within a few steps.

    `times` (p,) [s] are NaN for a hole that did not.
    """
    chattered = np.flatnonzero(~np.isnan(times))
    if chattered.size:
        first, others = chattered[np.argmin(times[chattered])], len(chattered) - 1
        also = f", and {others} other{'s' * (others > 1)} later" if others else ""
        yield remark("chatter", names[first], time=times[first], also=also)


def inaccurate(accuracy: float, errors: Mapping[str, float], unknowns: int) -> Iterator[Remark]:
    """Yield remarks on errors of the holes' compliance above the requested `accuracy`."""
    words = {"accuracy": 100.0 * accuracy, "unknowns": unknowns}
    found = [(error, name, words | {"error": 100.0 * error}) for name, error in errors.items() if error > accuracy]
    yield from worst_of(found, "accuracy", "holes")


def coarse_cells(hole: Piercing, size: float, element: str, refined: bool = False) -> list[Remark]:
    """Return a remark on coarse cells [m] at a hole, unless they were `refined` to an accuracy."""
    if hole.footprint == 0.0:
        return [remark("bare-point", hole.name, key=hole.key("footprint"))]
    limit = bounds.COARSE[element] * hole.footprint
    sizes = {"size": size / MILLI, "limit": limit / MILLI}
    return judged(not refined and size > limit, "cells", hole.name, element=element, **sizes)


def moved_holes(holes: Sequence[Piercing]) -> Iterator[Remark]:
    """Yield remarks on holes that were moved far to the surface."""
    for hole in holes:
        sizes = {"moved": (hole.moved or 0.0) / MILLI, "footprint": hole.footprint / MILLI}
        far = hole.moved is not None and hole.moved > bounds.MOVED * hole.footprint
        yield from judged(far, "moved", hole.name, **sizes)


def near_holes(holes: Sequence[Piercing]) -> Iterator[Remark]:
    """Yield a remark on neighbouring holes, with the pair that is nearest for its footprints.

    Two holes at the same place are one hole at two times.
    """
    near = []
    for one, other in combinations(holes, 2):
        distance, reach = dist(one.place, other.place), bounds.NEAR * (one.footprint + other.footprint)
        if 0.0 < distance < reach * (1.0 - ROUND_OFF):
            near.append((distance / reach, one.name, other.name, distance / MILLI, reach / MILLI))
    if near:
        (_, first, second, apart, reach), others = min(near), len(near) - 1
        pairs = "pairs of holes are" if others > 1 else "pair of holes is"
        also = f"; {others} more {pairs} near" if others else ""
        yield remark("holes-near", first, other=second, apart=apart, reach=reach, also=also)


def steep_friction(contacts: Sequence[Contact]) -> Iterator[Remark]:
    """Yield remarks on contacts with a large coefficient of friction."""
    for pair in contacts:
        yield from judged(pair.friction > bounds.STEEP, "contact-rough", " - ".join(pair.between), pair=pair)


def unheld(scenario: Scenario) -> list[Remark]:
    """Return a remark if nothing holds the organ of a dynamic run."""
    organ = scenario.tissue
    free = not (organ is None or organ.clamp or organ.roller or scenario.touching)
    return judged(free, "not-held", "tissue.clamp")


def not_across(scenario: Scenario) -> Iterator[Remark]:
    """Yield remarks on ties whose holes are all on one side of the plane of a wound, or beyond its end."""
    shape = scenario.tissue.mesh if scenario.tissue else None
    if not isinstance(shape, WoundMesh):
        return
    axis, names = wound_of(shape).normal_axis, [hole.name for hole in scenario.piercing]
    limits = ((axis, 0.0, "on one side"), (1 - axis, 0.5 * (1.0 + BEYOND) * shape.length, "beyond the end"))
    for tie in scenario.tie:
        first, last = sorted(map(names.index, tie.between))
        places = np.array([hole.place for hole in scenario.piercing[first : last + 1]]).T
        ways = [(max(places[k].min(), -places[k].max()) - limit, words) for k, limit, words in limits]
        away, words = max(ways)
        yield from judged(away > 0.0, "not-across", tie.name, words=words, away=away / MILLI)


def off_path(assembly: Assembly) -> list[Remark]:
    """Return remarks on holes that hold the thread at the start far from the lines of its path."""
    diameter, places = assembly.system.thread.section.diameter, assembly.system.organ.y0.reshape(-1, 9)[:, :3]
    limit, lines = bounds.OFF_PATH * diameter, rounded_path(assembly.scenario.thread.path, SHARP * diameter)
    there = assembly.path.position(np.clip(assembly.at, 0.0, assembly.path.length))
    away = [
        lines.nearest(place)[1] if hole.s is None else float(np.linalg.norm(place - at))
        for hole, place, at in zip(assembly.holes, places, there, strict=True)
    ]
    return [
        remark("off-path", hole.name, gap=gap / MILLI, limit=limit / MILLI)
        for hole, gap in zip(assembly.holes, away, strict=True)
        if hole.from_ == 0.0 and gap > limit and not isinstance(hole, Ball)
    ]


def sharpest_bend(thread: Thread, q: Array) -> tuple[float, float]:
    """Return the smallest bend radius of a thread [m], and its abscissa [m].

    It is computed at the points of the bending energy, with control points `q` (n, c) [m].
    """
    rule = thread.elastic_rule
    first, second = (np.einsum("egi,eia->ega", rule.b[:, :, d], q[thread.points_of_span, :3]) for d in (1, 2))
    bent = curvature(first, second)
    sharpest = np.unravel_index(np.nanargmax(bent), bent.shape)
    return float(1.0 / max(bent[sharpest], np.finfo(float).tiny)), float(rule.s[sharpest])


def bent_sharply(radius: float, at: float, diameter: float) -> list[Remark]:
    """Return a remark on a bend `radius` below the thread's `diameter` [m].

    The bend is at the abscissa `at` [m].
    """
    sizes = {"radius": radius / MILLI, "diameter": diameter / MILLI, "strain": 0.5 * diameter / radius}
    return judged(radius < bounds.KINKED * diameter, "kinked", "thread.path", at=at, **sizes)


def along_path(assembly: Assembly, body: tissue.Elasticity) -> list[Remark]:
    """Return remarks on the thread between neighbouring holes that hold it at the start.

    A strand that is cut is not judged, because its two tails hang free.
    """
    path, scenario, thread = assembly.path, assembly.scenario, assembly.system.thread
    diameter = thread.section.diameter
    every = zip(assembly.holes, assembly.at, assembly.s, strict=True)
    placed = [(hole, at, s) for hole, at, s in every if hole.from_ == 0.0]
    own = [each for each in placed if not isinstance(each[0], Ball)]
    tracts = {tract.between: tract for tract in scenario.tract}
    out, depths = list(end_strands(assembly, own)), {}
    for (one, first, low), (other, last, high) in pairwise(own):
        tract = tracts.get((one.name, other.name))
        if is_cut(thread, low, high):
            continue
        if tract is None:
            at = np.clip(np.linspace(first, last, LOOKS + 2)[1:-1], 0.0, path.length)
            found = assembly.depths(assembly.through.position(at))
            depths[one.name, other.name] = float(found.max())
            if found.min() < -bounds.IN_TISSUE * diameter:
                where = f"between {one.name!r} and {other.name!r}"
                out += unpierced(where, one.name, float(found.max()), diameter)
        else:
            balls = [(hole, at) for hole, at, _ in placed if isinstance(hole, Ball) and hole.tract == tract.name]
            gaps = gaps_of(scenario, body.mesh, balls)
            borne = sum(ball.length for ball, _ in balls) + sum(end - begin for begin, end, across in gaps if across)
            open_ways = [np.linspace(begin, end, LOOKS) for begin, end, across in gaps if not across]
            heights = [-float(assembly.depths(assembly.through.position(at)).min()) for at in open_ways]
            out += out_of_organ(tract.name, max(heights, default=0.0), diameter) or bare_tract(
                tract.name, last - first - borne, last - first, radius_of(tract, scenario.piercing)
            )
    return [*without_tract(depths, diameter), *out]


def is_cut(thread: Thread, low: float, high: float) -> bool:
    """Return whether a thread is cut between two abscissae [m]."""
    cuts = thread.spline.cuts
    return bool(np.any((low < cuts) & (cuts < high)))


def end_strands(assembly: Assembly, own: Sequence[tuple[Piercing, float, float]]) -> Iterator[Remark]:
    """Yield remarks on the first and the last strand of the thread.

    `own` are its holes with their abscissae on the path and on the thread [m]. A strand that is cut
    and the free tail of an anchored hole are not judged, because nothing pulls on the tail at the
    hole.
    """
    path, table, thread = assembly.path, assembly.scenario.thread, assembly.system.thread
    first, last = thread.spline.start, thread.spline.end
    strands = ((table.start, 0.0, first, own[:1], "first"), (table.end, path.length, last, own[-1:], "last"))
    for end, at_end, s_end, holes, which in strands:
        for hole, at, s in holes:
            if is_cut(thread, *sorted((s_end, s))) or (isinstance(end, FreeEnd) and hole.kind == "anchored"):
                continue
            deep = assembly.depths(assembly.through.position(np.linspace(at_end, at, LOOKS + 2)[:-1]))
            where = f"on its {which} strand, from its end to {hole.name!r},"
            yield from unpierced(where, hole.name, float(deep.max()), thread.section.diameter)


def unpierced(strand: str, hole: str, depth: float, diameter: float) -> list[Remark]:
    """Return a remark on a strand in tissue that crosses the surface without a hole.

    It lies `depth` [m] deep.
    """
    return judged(depth > bounds.IN_TISSUE * diameter, "no-hole", hole, strand=strand, depth=depth / MILLI)


def on_strands(
    strands: records.Record, holes: Mapping[str, float], diameter: float, tension: float, bears: bool
) -> Iterator[Remark]:
    """Yield remarks on strands outside the organ.

    They can end in the tissue, where the holes of the organ have abscissae `holes` [m] on a thread
    of `diameter` [m]. They can be held aside when the search for their place ended. Their contact
    can change their tension more than its friction, relative to the largest `tension` [N].
    """
    before = [name for name, s in holes.items() if not s > strands.s]
    behind = [name for name, s in holes.items() if s > strands.s]
    yield from judged(
        strands.depth > bounds.IN_TISSUE * diameter,
        "in-tissue",
        "thread",
        one=repr(before[-1]) if before else "its start",
        other=repr(behind[0]) if behind else "its end",
        depth=strands.depth / MILLI,
        remedy="raise thread.control_points" if bears else "set thread.contact = true",
    )
    share = strands.held / max(strands.force, np.finfo(float).tiny)
    yield from judged(share > bounds.HELD, "strand-held", "thread", held=strands.held, share=share)
    off, share = strands.off_friction, strands.off_friction / tension if tension else 0.0
    yield from judged(share > bounds.OFF_FRICTION, "strand-friction", "thread", force=off, share=share)


def without_tract(depths: Mapping[tuple[str, str], float], diameter: float) -> Iterator[Remark]:
    """Yield a remark on the thread in tissue between two holes without a tract.

    `depths` are its depths [m] by the names of the holes.
    """
    deep = {holes: depth for holes, depth in depths.items() if depth > bounds.IN_TISSUE * diameter}
    if deep:
        (one, other), others = next(iter(deep)), len(deep) - 1
        also = f", and between {others} other pair{'s' * (others > 1)} of holes," if others else ""
        yield remark("no-tract", one, other=other, also=also, depth=max(deep.values()) / MILLI)


def out_of_organ(name: str, outside: float, diameter: float) -> list[Remark]:
    """Return a remark if a tract lies up to `outside` [m] outside the organ, between two parts in it."""
    return judged(outside > bounds.IN_TISSUE * diameter, "tract-out", name, outside=outside / MILLI)


def bare_tract(name: str, bare: float, length: float, radius: float) -> list[Remark]:
    """Return a remark if a `bare` length of a tract's path is too long [m].

    This length of the whole `length` [m] has no room for balls of a `radius` [m]. Passages across a
    wound are excluded.
    """
    ways = {"bare": bare / MILLI, "length": length / MILLI, "radius": radius / MILLI}
    return judged(bare > bounds.BARE * radius, "tract-bare", name, **ways)


def stiff_in_tracts(scenario: Scenario, tracts: Sequence[records.TractRecord]) -> list[Remark]:
    """Return a remark on the stiffness of the thread along tracts."""
    radii = {tract.name: radius_of(tract, scenario.piercing) for tract in scenario.tract}
    EI = section_of(scenario.thread).EI if scenario.thread.bending else 0.0
    return stiffer_than_taut(tracts, [EI * tract.turn / radii[tract.tract] ** 2 for tract in tracts])


def stiffer_than_taut(tracts: Sequence[records.TractRecord], pushes: Sequence[float]) -> list[Remark]:
    """Return a remark if the thread bends stiffly in one of the tracts.

    Its bending force on a ball of each tract, `pushes` [N], is then large against its tension.
    """
    found = []
    for tract, push in zip(tracts, pushes, strict=True):
        words = {"push": push, "turn": tract.turn, "tension": tract.tension, "spacing": tract.spacing / MILLI}
        if tract.turn > bounds.SLIGHT and push > bounds.STIFF * tract.tension:
            found.append((push / max(tract.tension, np.finfo(float).tiny), tract.tract, words))
    return worst_of(found, "tract-stiff", "tracts")


def values_of(assembly: Assembly) -> dict[str, Array]:
    """Return the values that can be in a wrong unit, by their key [SI]."""
    section, body = section_of(assembly.scenario.thread), assembly.body
    out: dict[str, Any] = {"thread.length": assembly.system.thread.spline.end}
    out |= {f"thread.{key}": getattr(section, key) for key in ("diameter", "youngs_modulus", "density")}
    if body is not None:
        out["size"] = np.ptp(body.points, axis=0).max()
        out |= {f"tissue.{key}": getattr(body.material, key) for key in ("youngs_modulus", "density")}
    return {key: np.atleast_1d(value) for key, value in out.items()}


def unlike_units(values: Mapping[str, Array]) -> Iterator[Remark]:
    """Yield remarks on values [SI] outside the range of organs and sutures, by their key.

    A remark shows the first such value of a key and the units in which this value would be
    plausible.
    """
    for key, numbers in values.items():
        low, high, unit, others = PLAUSIBLE[key]
        for value in numbers[(numbers < low) | (numbers > high)][:1].tolist():
            likely = [other for other, factor in others.items() if low <= factor * value <= high]
            which = f"is it in {' or '.join(likely)}?" if likely else "is it in another unit than SI?"
            words = {"named": "the organ is" if key == "size" else f"{key} =", "unit": unit, "which": which}
            yield remark("units", key, value=value, low=low, high=high, **words)
