"""Remarks on a run: from its assembly before the first step, from its largest values at the end.

Each function judges one quantity by plain numbers and returns its remarks. The bounds are in the catalogue,
`studies.output.remarks`.
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, pairwise
from math import dist
from typing import Any

import numpy as np

import tissue
from coupling.rest.equilibrium import slides_freely
from meshes.quality import size_at
from studies import scenario as model
from studies.arrays import Array
from studies.lists import list_of
from studies.output import records
from studies.output import remarks as bounds
from studies.output.remarks import Remark, judged, remark
from studies.scenario import Scenario
from studies.scenario.refusal import dotted_key
from studies.simulation.assembly import Assembly, section_of
from studies.simulation.demand import demanding, moduli_at, radii_at
from studies.simulation.given import Given, shear_moduli
from studies.simulation.tracts import Ball, across_wounds, of_piercings, radius_of
from studies.verdicts import BETWEEN, RESOLVED, SETTLED, unrest
from thread.catalogue import knot_pull
from thread.thread import Thread
from thread.vectors import curvature

MILLI = 1e-3
LOOKS = 9  # places between two holes at which the depth of the thread is computed
# What organs and sutures have, with room to spare, in its unit, and others in which it may have been given.
PLAUSIBLE = list_of(__file__, "plausible.toml")


def foreseen(assembly: Assembly, q: Array) -> list[Remark]:
    """Return the remarks before the first step, for a thread with control points `q` (n, c) [m]."""
    scenario, system = assembly.scenario, assembly.system
    thread = system.thread
    straight = thread.bending and not thread.coil
    bends = bent_sharply(*sharpest_bend(thread, q), thread.section.diameter) if straight else []
    out = [*unlike_units(values_of(assembly)), *off_path(assembly), *bends, *handed_over(assembly.given, assembly.body)]
    out += after_end(times_of(scenario), scenario.solve.duration)
    out += [remark("rest-unloaded", key, ramp=ramp) for key, ramp in ramps_of(scenario).items() if ramp]
    free = scenario.solve.kind == "static" and slides_freely(system, system.rows[:, 0])
    out += judged(free, "slides-freely", "piercing")
    strength = knot_pull(scenario.thread.suture) if scenario.thread.suture else None
    E = moduli_at(assembly.body, scenario.piercing)
    at = np.array(of_piercings(assembly.holes, assembly.at.tolist()))
    body = assembly.body
    sizes = [size_at(body.mesh, np.array(hole.place)) if body else 0.0 for hole in scenario.piercing]
    radii = radii_at(scenario.piercing, sizes, body.element if body else "P1")
    out += demanding(scenario, section_of(scenario.thread), assembly.path, at, E, radii, strength)
    if body is None:
        return out
    return [
        *out,
        *(
            said
            for hole, size in zip(scenario.piercing, sizes, strict=True)
            for said in coarse_cells(hole, size, body.element, assembly.fit is not None)
        ),
        *inaccurate_cells(assembly),
        *near_holes(scenario.piercing),
        *moved_holes(scenario.piercing),
        *steep_friction(scenario.contact),
        *unheld(scenario),
        *along_path(assembly),
    ]


def times_of(scenario: Scenario) -> dict[str, float]:
    """Return the times of scheduled events [s], by their keys."""
    begins = {dotted_key(["piercing", hole.name, "from"]): hole.from_ for hole in scenario.piercing}
    closes = {dotted_key(["tie", tie.name, "from"]): tie.from_ for tie in scenario.tie}
    return begins | closes | {f"cut.{k}.time": table.time for k, table in enumerate(scenario.cut)}


def ramps_of(scenario: Scenario) -> dict[str, float]:
    """Return the ramps of dead loads on a thread that starts at rest [s], by the key of the end; empty for a
    start on the path."""
    if scenario.solve.start != "rest":
        return {}
    ends = {"thread.start": scenario.thread.start, "thread.end": scenario.thread.end}
    return {key: end.ramp for key, end in ends.items() if isinstance(end, model.PulledEnd) and end.ramp is not None}


def after_end(times: Mapping[str, float], duration: float) -> list[Remark]:
    """Return remarks on events after the end of a run of a `duration` [s]."""
    late = {key: time for key, time in times.items() if time > duration}
    return [remark("after-end", key, time=time, duration=duration) for key, time in late.items()]


def handed_over(given: Given, body: tissue.Elasticity | None) -> list[Remark]:
    """Return remarks on parts of the run that came from Python."""
    if not given.unsaid:
        return []
    mu, moduli = 0.0 if body is None else float(np.max(body.material.lame_mu)), ""
    if (density := given.distortion(mu)) is not None:
        least, largest = shear_moduli(density)
        moduli = f"; its initial shear modulus is {least:.4g} to {largest:.4g} Pa, E and ν give {mu:.4g} Pa"
    out = [remark("handed-over", "prepare", unsaid=", ".join(given.unsaid), moduli=moduli)]
    return out + judged(given.stiffness is not None, "stress-of-e-nu", "tissue")


def met(assembly: Assembly, ending: records.Ending) -> list[Remark]:
    """Return the remarks on a run with an `ending`."""
    scenario, step, extremes = assembly.scenario, ending.step, ending.extremes
    names = [hole.name for hole in scenario.piercing]
    strengths = [hole.strength for hole in assembly.system.piercings if not hole.tract]
    strength = knot_pull(scenario.thread.suture) if scenario.thread.suture else None
    dynamic, diameter = scenario.solve.kind == "dynamic", assembly.system.thread.section.diameter
    return [
        *(
            []
            if isinstance(assembly.organ, tissue.FiniteOrgan)
            else [*beyond_at_holes(names, extremes), *beyond_in_tissue(extremes)]
        ),
        *missed_by_basis(names, extremes),
        *torn(names, extremes, strengths),
        *turned_pressure(extremes),
        *crossed_lips(extremes),
        *overloaded(extremes, strength),
        *(said for tract in step.tracts for said in stiff_in_tract(scenario, tract)),
        *assumed_channels(scenario.piercing, step.piercings),
        *coarse_spans(step.span_ratio),
        *few_spans(step.spans_between),
        *([] if dynamic and moves(step.energy) else unstable(step.would_stay)),
        *followed(extremes.branches),
        *past_limit(extremes.fallen / scenario.solve.duration),
        *(audited(step.energy, extremes, rubs(assembly) or not names, has_slid(assembly, step)) if dynamic else []),
        *(
            unsettled(step.energy, step.slide_speed * step.time, section_of(scenario.thread).diameter)
            if dynamic
            else []
        ),
        *sunk(step.strands, [hole.s for hole in step.piercings], names, diameter, assembly.system.bears),
        *left_holes(scenario.piercing, step),
        *undone(scenario, step),
        *(locked_slack(scenario.tie, extremes.locked) if dynamic else []),
        *(swinging(extremes.swing) if dynamic else []),
        *(chattering(names, extremes.chattered) if dynamic else []),
    ]


def beyond_at_holes(names: Sequence[str], extremes: records.Extremes) -> list[Remark]:
    """Return remarks on strain and turn of the tissue at the holes."""
    out = []
    for name, strain, turn in zip(names, extremes.mean_strain, extremes.turn, strict=True):
        out += judged(strain > bounds.SMALL_STRAIN, "hole-strain", name, strain=strain)
        out += judged(turn > bounds.SMALL_ROTATION, "hole-rotation", name, turn=turn)
    return out


def beyond_in_tissue(extremes: records.Extremes) -> list[Remark]:
    """Return remarks on strain and rotation of the organ's cells."""
    strain, rotation = extremes.strain, extremes.rotation
    code = "tissue-strain" if extremes.strained > bounds.SHARE else "local-strain"
    turns = rotation > bounds.SMALL_ROTATION and extremes.rotated > bounds.SHARE
    return [
        *judged(strain > bounds.SMALL_STRAIN, code, "tissue", strain=strain, share=extremes.strained),
        *judged(turns, "tissue-rotation", "tissue", rotation=rotation, share=extremes.rotated),
    ]


def missed_by_basis(names: Sequence[str], extremes: records.Extremes) -> list[Remark]:
    """Return remarks on the error of the organ's small basis at its holes; none without a basis."""
    limit = bounds.REDUCED * float(extremes.way.max(initial=0.0))
    out = []
    for name, difference, bound in zip(names, extremes.difference, extremes.bound, strict=True):
        code, distance = ("reduction", difference) if difference > limit else ("reduction-bound", bound)
        out += judged(distance > limit, code, name, distance=distance / MILLI, limit=limit / MILLI)
    return out


def torn(names: Sequence[str], extremes: records.Extremes, strengths: Sequence[float]) -> list[Remark]:
    """Return remarks on the pressure at holes above the tissue's strength [Pa], which is infinite if unknown."""
    numbers = zip(names, extremes.bearing_pressure.tolist(), strengths, strict=True)
    return [
        remark("tears", name, pressure=pressure, strength=strength)
        for name, pressure, strength in numbers
        if pressure > strength
    ]


def assumed_channels(holes: Sequence[model.Piercing], found: Sequence[records.PiercingRecord]) -> list[Remark]:
    """Return a remark on the hole whose friction depends most on the length of its assumed channel."""
    losses: list[tuple[list[float], float, str]] = []
    for hole, seen in zip(holes, found, strict=True):
        if hole.channel is not None or seen.channel is None or hole.friction is None:
            continue
        across = float(np.linalg.norm(seen.force - seen.tangential_force * seen.tangent))
        half, twice = 2.0 * seen.normal_force, max(across, 0.5 * seen.normal_force)
        taken = hole.friction.kinetic * np.array([half, seen.normal_force, twice])
        if seen.normal_force > bounds.RULES * across and taken[0] - taken[2] > bounds.UNSURE * max(
            seen.tension_before, 0.0
        ):
            losses.append((taken.tolist(), seen.channel, seen.name))
    if not losses:
        return []
    (half, now, twice), channel, name = max(losses)
    key = dotted_key(["piercing", name, "channel"])
    return [remark("channel", name, channel=channel / MILLI, now=now, half=half, twice=twice, key=key)]


def turned_pressure(extremes: records.Extremes) -> list[Remark]:
    """Return a remark on the turn of pressed surfaces."""
    turn = extremes.pressed_turn
    return judged(turn > bounds.SMALL_ROTATION, "pressure-turn", "tissue.load", turn=turn)


def crossed_lips(extremes: records.Extremes) -> list[Remark]:
    """Return a remark on the overlap of lips without contact."""
    return judged(extremes.crossed > bounds.CROSSED, "lips-cross", "tissue.mesh", crossed=extremes.crossed)


def overloaded(extremes: records.Extremes, strength: float | None) -> list[Remark]:
    """Return remarks on the thread's strength [N], None if unknown, and on its strain."""
    tension, strain, breaks = extremes.tension, extremes.thread_strain, np.inf if strength is None else strength
    return [
        *judged(tension > breaks, "thread-strength", "thread", tension=tension, strength=breaks),
        *judged(strain > bounds.THREAD_STRAIN, "thread-strain", "thread", strain=strain),
    ]


def coarse_spans(ratio: float) -> list[Remark]:
    """Return a remark if spans are too long for the bends at the holes; `ratio` is a step's `span_ratio`."""
    return judged(ratio > RESOLVED, "spans", "thread.control_points", ratio=ratio, limit=RESOLVED)


def few_spans(number: float | None) -> list[Remark]:
    """Return a remark if the spline cannot bend between two holes; `number` is a step's `spans_between`."""
    few = number is not None and number < BETWEEN
    return judged(few, "spans-between", "thread.control_points", number=number, limit=BETWEEN)


def followed(branches: float) -> list[Remark]:
    """Return a remark on the number of load steps that followed a branch by arc length."""
    return judged(branches >= 1.0, "branch", "solve", branches=branches)


def past_limit(fallen: float) -> list[Remark]:
    """Return a remark if the loads have `fallen` along a branch, as a share of the full loads."""
    return judged(fallen > bounds.FALLEN, "limit-point", "solve", fallen=fallen)


def unstable(would_stay: bool) -> list[Remark]:
    """Return a remark on an unstable equilibrium of the thread."""
    return judged(not would_stay, "would-not-stay", "solve")


def rubs(assembly: Assembly) -> bool:
    """Return whether the run has friction, so that its end depends on its history."""
    return bool(assembly.system.rough.any()) or any(pair.friction for pair in assembly.scenario.contact)


def has_slid(assembly: Assembly, step: records.StepRecord) -> bool:
    """Return whether a thread with friction was drawn through a hole by more than its diameter."""
    diameter = section_of(assembly.scenario.thread).diameter
    drawn = (abs(hole.slip) for hole in step.piercings)
    return bool(assembly.system.rough.any()) and max(drawn, default=0.0) > bounds.SLID * diameter


def audited(energy: records.EnergyRecord, extremes: records.Extremes, rough: bool, slid: bool) -> list[Remark]:
    """Return remarks on energy that the time steps created or dissipated.

    `rough`: the run has friction. `slid`: the thread slid far.
    """
    scale, created, dissipated = extremes.energy, extremes.created, energy.numerical_dissipation
    out, effect = [], ""
    if created > bounds.CREATED * scale:
        out.append(remark("energy-created", "solve", created=created, share=created / scale, energy=scale))
    if dissipated > bounds.DISSIPATED * scale and (rough or extremes.swing > bounds.SWUNG):
        effect = (
            f"{dissipated / scale:.0%} of the run's largest energy ({scale:.2g} J), and damped its oscillations; use a "
            "smaller solve.dt if they matter"
        )
    elif slid and dissipated > bounds.OUTDONE * energy.friction_dissipation:
        effect = (
            f"friction only {energy.friction_dissipation:.2g} J, so the length that the thread slid depends on the "
            "steps; compare with a smaller solve.dt, or set solve.tolerance"
        )
    return out + judged(bool(effect), "numerical-dissipation", "solve.dt", dissipated=dissipated, effect=effect)


def moves(energy: records.EnergyRecord) -> bool:
    """Return whether a dynamic run still moves at its end, by its kinetic energy."""
    return unrest(energy.kinetic, energy.of_deformation) > SETTLED


def unsettled(energy: records.EnergyRecord, slide: float, diameter: float) -> list[Remark]:
    """Return a remark if a run did not come to rest.

    The criteria are its kinetic energy and the length `slide` [m] that a thread of `diameter` [m] slides in
    another run of the same duration.
    """
    share, limit = unrest(energy.kinetic, energy.of_deformation), bounds.SLID * diameter
    ways = {"slide": slide / MILLI, "limit": limit / MILLI}
    unrested = moves(energy) or slide > limit
    return judged(unrested, "not-at-rest", "solve.duration", share=share, settled=SETTLED, **ways)


def left_holes(holes: Sequence[model.Piercing], step: records.StepRecord) -> list[Remark]:
    """Return a remark on holes without the thread at the end of a run, though they have begun and not ended."""
    times = [(hole.from_, np.inf if hole.until is None else hole.until) for hole in holes]
    left = [
        found.name
        for found, (begins, ends) in zip(step.piercings, times, strict=True)
        if found.state == "left" and begins < step.time < ends
    ]
    words = f"hole{'s' * (len(left) > 1)} {', '.join(map(repr, left))}"
    return judged(bool(left), "hole-left", left[0] if left else "", holes=words, time=step.time)


def undone(scenario: model.Scenario, step: records.StepRecord) -> list[Remark]:
    """Return remarks on ties that have begun but are open at the end of a run, unless their loop is cut."""
    at = {hole.name: hole.s for hole in step.piercings}
    cuts = [cut.s for cut in scenario.cut if cut.time <= step.time]
    out = []
    for tie, found in zip(scenario.tie, step.ties, strict=True):
        first, last = sorted(at[name] for name in tie.between)
        lost = found.state == "open" and tie.from_ < step.time and not any(first <= s <= last for s in cuts)
        out += judged(lost, "tie-undone", tie.name, time=step.time)
    return out


def locked_slack(ties: Sequence[model.Tie], forces: Array) -> list[Remark]:
    """Return remarks on ties locked below their force; `forces` (t,) [N] are NaN for a tie that was not locked."""
    out = []
    for tie, force in zip(ties, forces.tolist(), strict=True):
        out += judged(force < bounds.LOCKED * tie.force, "tie-slack", tie.name, tie=tie, force=force)
    return out


def swinging(swing: float) -> list[Remark]:
    """Return a remark if a hole's force deviates from a straight line over the last steps, as a share of the
    largest force."""
    return judged(swing > bounds.SWUNG, "forces-swing", "solve.dt", swing=swing)


def chattering(names: Sequence[str], times: Array) -> list[Remark]:
    """Return a remark on holes that changed often between stick and slip within a few steps.

    `times` (p,) [s] are NaN for a hole that did not.
    """
    chattered = np.flatnonzero(~np.isnan(times))
    if not chattered.size:
        return []
    first, others = chattered[np.argmin(times[chattered])], len(chattered) - 1
    also = f", and {others} other{'s' * (others > 1)} later" if others else ""
    return [remark("chatter", names[first], time=times[first], also=also)]


def inaccurate_cells(assembly: Assembly) -> list[Remark]:
    """Return remarks on the cells at the holes of a refined mesh."""
    table, fit = assembly.scenario.tissue, assembly.fit
    if fit is None or table is None or table.mesh.accuracy == "given":
        return []
    named = zip(assembly.holes, fit.errors.tolist(), strict=True)
    return inaccurate(table.mesh.accuracy, {hole.name: error for hole, error in named}, fit.rounds[-1].unknowns)


def inaccurate(accuracy: float, errors: Mapping[str, float], unknowns: int) -> list[Remark]:
    """Return remarks on errors of the holes' compliance above the requested `accuracy`."""
    percent = {name: 100.0 * error for name, error in errors.items() if error > accuracy}
    return [
        remark("accuracy", name, error=error, accuracy=100.0 * accuracy, unknowns=unknowns)
        for name, error in percent.items()
    ]


def coarse_cells(hole: model.Piercing, size: float, element: str, refined: bool = False) -> list[Remark]:
    """Return a remark on coarse cells [m] at a hole, unless they were `refined` to an accuracy."""
    if hole.footprint == 0.0:
        return [remark("bare-point", hole.name, key=dotted_key(["piercing", hole.name, "footprint"]))]
    limit = bounds.COARSE[element] * hole.footprint
    sizes = {"size": size / MILLI, "limit": limit / MILLI}
    return judged(not refined and size > limit, "cells", hole.name, element=element, **sizes)


def moved_holes(holes: Sequence[model.Piercing]) -> list[Remark]:
    """Return remarks on holes that were moved far to the surface."""
    return [
        remark("moved", hole.name, moved=hole.moved / MILLI, footprint=hole.footprint / MILLI)
        for hole in holes
        if hole.moved is not None and hole.moved > bounds.MOVED * hole.footprint
    ]


def near_holes(holes: Sequence[model.Piercing]) -> list[Remark]:
    """Return remarks on neighbouring holes; two holes at the same place are one hole at two times."""
    out = []
    for one, other in combinations(holes, 2):
        apart, reach = dist(one.place, other.place), bounds.NEAR * (one.footprint + other.footprint)
        ways = {"apart": apart / MILLI, "reach": reach / MILLI}
        out += judged(0.0 < apart < reach, "holes-near", one.name, other=other.name, **ways)
    return out


def steep_friction(contacts: Sequence[model.Contact]) -> list[Remark]:
    """Return remarks on contacts with a large coefficient of friction."""
    steep = [pair for pair in contacts if pair.friction > bounds.STEEP]
    return [remark("contact-rough", " - ".join(pair.between), pair=pair) for pair in steep]


def unheld(scenario: Scenario) -> list[Remark]:
    """Return a remark if nothing holds the organ of a dynamic run."""
    organ = scenario.tissue
    free = not (organ is None or organ.clamp or organ.roller or scenario.touching)
    return judged(free, "not-held", "tissue.clamp")


def off_path(assembly: Assembly) -> list[Remark]:
    """Return remarks on holes that hold the thread at the start far from its path."""
    limit = bounds.OFF_PATH * assembly.system.thread.section.diameter
    there = assembly.path.position(np.clip(assembly.at, 0.0, assembly.path.length))
    places = assembly.system.organ.y0.reshape(-1, 9)[:, :3]
    away = np.linalg.norm(there - places, axis=1)
    return [
        remark("off-path", hole.name, gap=gap / MILLI, limit=limit / MILLI)
        for hole, gap in zip(assembly.holes, away, strict=True)
        if hole.from_ == 0.0 and gap > limit and not isinstance(hole, Ball)
    ]


def sharpest_bend(thread: Thread, q: Array) -> tuple[float, float]:
    """Return the smallest bend radius of a thread with control points `q` (n, c) [m], and its abscissa [m].

    It is computed at the points of the bending energy.
    """
    rule = thread.elastic_rule
    first, second = (np.einsum("egi,eia->ega", rule.b[:, :, d], q[thread.points_of_span, :3]) for d in (1, 2))
    bent = curvature(first, second)
    sharpest = np.unravel_index(np.nanargmax(bent), bent.shape)
    return float(1.0 / max(bent[sharpest], np.finfo(float).tiny)), float(rule.s[sharpest])


def bent_sharply(radius: float, at: float, diameter: float) -> list[Remark]:
    """Return a remark on a bend `radius` [m] below the thread's `diameter` [m], at the abscissa `at` [m]."""
    sizes = {"radius": radius / MILLI, "diameter": diameter / MILLI, "strain": 0.5 * diameter / radius}
    return judged(radius < bounds.KINKED * diameter, "kinked", "thread.path", at=at, **sizes)


def along_path(assembly: Assembly) -> list[Remark]:
    """Return remarks on the thread between neighbouring holes that hold it at the start."""
    path, body, scenario = assembly.path, assembly.body, assembly.scenario
    if body is None:
        return []
    diameter = assembly.system.thread.section.diameter
    placed = [(hole, at) for hole, at in zip(assembly.holes, assembly.at, strict=True) if hole.from_ == 0.0]
    own = [(hole, at) for hole, at in placed if not isinstance(hole, Ball)]
    tracts = {tract.between: tract for tract in scenario.tract}
    out, depths = end_strands(assembly, own), {}
    for (one, first), (other, last) in pairwise(own):
        tract = tracts.get((one.name, other.name))
        if tract is None:
            at = np.clip(np.linspace(first, last, LOOKS + 2)[1:-1], 0.0, path.length)
            found = assembly.depths(path.position(at))
            depths[one.name, other.name] = float(found.max())
            crosses = bool(found.min() < -bounds.IN_TISSUE * diameter)
            out += (
                unpierced(f"between {one.name!r} and {other.name!r}", one.name, float(found.max()), diameter) * crosses
            )
        else:
            balls = [(hole, at) for hole, at in placed if isinstance(hole, Ball) and hole.tract == tract.name]
            borne = sum(ball.length for ball, _ in balls) + across_wounds(scenario, body.mesh, balls)
            out += bare_tract(tract.name, last - first - borne, last - first, radius_of(tract, scenario.piercing))
    return [*without_tract(depths, diameter), *out]


def end_strands(assembly: Assembly, own: Sequence[tuple[model.Piercing, float]]) -> list[Remark]:
    """Return remarks on the first and the last strand of the thread, with its `own` holes at abscissae of the
    path [m].

    The free tail of an anchored hole is not judged, because nothing pulls on it.
    """
    path, thread = assembly.path, assembly.scenario.thread
    strands = ((thread.start, 0.0, own[:1], "first"), (thread.end, path.length, own[-1:], "last"))
    out: list[Remark] = []
    for end, at_end, holes, which in strands:
        for hole, at in holes:
            if isinstance(end, model.FreeEnd) and hole.kind == "anchored":
                continue
            deep = assembly.depths(path.position(np.linspace(at_end, at, LOOKS + 2)[:-1]))
            where = f"on its {which} strand, from its end to {hole.name!r},"
            out += unpierced(where, hole.name, float(deep.max()), assembly.system.thread.section.diameter)
    return out


def unpierced(strand: str, hole: str, depth: float, diameter: float) -> list[Remark]:
    """Return a remark on a strand that lies `depth` [m] deep in tissue and crosses the surface without a hole."""
    return judged(depth > bounds.IN_TISSUE * diameter, "no-hole", hole, strand=strand, depth=depth / MILLI)


def sunk(
    strands: records.StrandsRecord | None, s: Sequence[float], names: Sequence[str], diameter: float, bears: bool
) -> list[Remark]:
    """Return a remark if strands outside the organ, whose holes are at `s` (p,) [m], end in the tissue."""
    if strands is None:
        return []
    before, behind = (
        [name for at, name in zip(s, names, strict=True) if (at > strands.s) == later] for later in (False, True)
    )
    return judged(
        strands.depth > bounds.IN_TISSUE * diameter,
        "in-tissue",
        "thread",
        one=repr(before[-1]) if before else "its start",
        other=repr(behind[0]) if behind else "its end",
        depth=strands.depth / MILLI,
        remedy="raise thread.control_points" if bears else "set thread.contact = true",
    )


def without_tract(depths: Mapping[tuple[str, str], float], diameter: float) -> list[Remark]:
    """Return a remark on the depth [m] of the thread in tissue between two holes without a tract, by the names
    of the holes."""
    deep = {holes: depth for holes, depth in depths.items() if depth > bounds.IN_TISSUE * diameter}
    if not deep:
        return []
    (one, other), others = next(iter(deep)), len(deep) - 1
    also = f", and between {others} other pair{'s' * (others > 1)} of holes," if others else ""
    return [remark("no-tract", one, other=other, also=also, depth=max(deep.values()) / MILLI)]


def bare_tract(name: str, bare: float, length: float, radius: float) -> list[Remark]:
    """Return a remark if a `bare` length of a tract's path is too long [m].

    This length of the whole `length` [m] has no room for balls of a `radius` [m]. Passages across a wound are
    excluded.
    """
    ways = {"bare": bare / MILLI, "length": length / MILLI, "radius": radius / MILLI}
    return judged(bare > bounds.BARE * radius, "tract-bare", name, **ways)


def stiff_in_tract(scenario: Scenario, tract: records.TractRecord) -> list[Remark]:
    """Return a remark on the stiffness of the thread along a tract."""
    radius = next(radius_of(each, scenario.piercing) for each in scenario.tract if each.name == tract.tract)
    EI = section_of(scenario.thread).EI if scenario.thread.bending else 0.0
    return stiffer_than_taut(tract.tract, EI * tract.turn / radius**2, tract.turn, tract.tension, tract.spacing)


def stiffer_than_taut(name: str, push: float, turn: float, tension: float, spacing: float) -> list[Remark]:
    """Return a remark if the bending force `push` [N] of the thread on a ball is large against its `tension` [N].

    The thread makes a `turn` [rad] from one ball of a tract to the next, at a distance `spacing` [m].
    """
    stiff = turn > bounds.SLIGHT and push > bounds.STIFF * tension
    given = {"push": push, "turn": turn, "tension": tension, "spacing": spacing / MILLI}
    return judged(stiff, "tract-stiff", name, **given)


def values_of(assembly: Assembly) -> dict[str, Array]:
    """Return the values that can be in a wrong unit, by their key [SI]."""
    section, body = section_of(assembly.scenario.thread), assembly.body
    out: dict[str, Any] = {
        "thread.length": assembly.system.thread.spline.end,
        "thread.diameter": section.diameter,
        "thread.youngs_modulus": section.youngs_modulus,
        "thread.density": section.density,
    }
    if body is not None:
        out["size"] = np.ptp(body.points, axis=0).max()
        out["tissue.youngs_modulus"] = body.material.youngs_modulus
        out["tissue.density"] = body.material.density
    return {key: np.atleast_1d(value) for key, value in out.items()}


def unlike_units(values: Mapping[str, Array]) -> list[Remark]:
    """Return remarks on values [SI] outside the range of organs and sutures, by their key."""
    return [
        remark("units", key, **in_other_units(key, odd))
        for key, found in values.items()
        for odd in odd_values(found, *PLAUSIBLE[key][:2])
    ]


def odd_values(values: Array, low: float, high: float) -> Iterable[float]:
    """Return the first value outside two bounds, in a list; empty if there is none."""
    return values[(values < low) | (values > high)][:1].tolist()


def in_other_units(key: str, value: float) -> dict[str, object]:
    """Return what to say of a value that is unlike an organ or a suture, with other units in which it would be like
    one."""
    low, high, unit, others = PLAUSIBLE[key]
    likely = [other for other, factor in others.items() if low <= factor * value <= high]
    which = f"is it in {' or '.join(likely)}?" if likely else "is it in another unit than SI?"
    named = "the organ is" if key == "size" else f"{key} ="
    return {"named": named, "value": value, "unit": unit, "low": low, "high": high, "which": which}
