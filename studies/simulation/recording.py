"""Records of steps, and snapshots of states."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

import tissue
from coupling.joins.contact import ContactObservation, observe_contact
from coupling.joins.strands import AWAY, LABEL, abscissae, held_aside, places_of
from coupling.reports.observation import PiercingObservation, span_ratio, spans_between
from coupling.run.march import solution_at
from coupling.step.stability import is_squeezed, would_stay
from coupling.system import State, System
from studies.arrays import Array
from studies.output import records
from studies.output.fields import ThreadRecord
from studies.simulation.memory import OrganRun, memory_of
from studies.simulation.wound import Wound, wounds_of
from thread.vectors import curvature

SAMPLES = 6  # points drawn on each span of the thread


def step_record(now: OrganRun, seconds: float = 0.0, open_lips: tissue.Gaps | None = None) -> records.StepRecord:
    """Return the record of a step; `open_lips` are lips of a wound without contact."""
    system, state = now.system, now.state
    sight = now.sight
    return records.StepRecord(
        time=state.time,
        step=now.number,
        piercings=own_holes(sight.piercings),
        energy=now.energies,
        newton_iterations=now.iterations,
        constraint_max=sight.gap,
        start_reaction=state.reaction[0, :3],
        end_reaction=state.reaction[1, :3],
        torques=tuple(state.reaction[:, 3].tolist()) if system.thread.twist else None,
        max_strain=float(np.sqrt(1.0 + 2.0 * sight.strain) - 1.0),
        slide_speed=float(np.abs(state.s_dot[: len(system.piercings)]).max(initial=0.0)),
        spans=partial(span_ratio, system, state),
        apart=partial(spans_between, system, state),
        stays=partial(would_stay_after, now),
        unstable=any(step.unstable for step in now.taken[-1:]),
        outside=partial(strands_record, now),
        seconds=seconds,
        fallen=now.fallen,
        events=tuple(now.events),
        contact=contact_records(now, open_lips),
        loads=load_records(system, state),
        tracts=tract_records(sight.piercings),
        krylov=krylov_record(system, state),
        ties=now.ties,
        profile=partial(gap_profile, now, open_lips),
        kept=partial(memory_of, now),
    )


def would_stay_after(now: OrganRun) -> bool:
    """Return whether the thread stays at the equilibrium of the last step.

    The result is also true without an equilibrium. In dynamics only a compressed thread is checked.
    """
    ended = [(step.solution, step.new) for step in now.taken[-1:]]
    if now.at_once and not ended:
        ended = [(solution_at(now.system, now.state), now.state)]
    checked = (pair for pair in ended if pair[0].problem.stiffen or is_squeezed(pair[0]))
    return all(would_stay(solution, new) for solution, new in checked)


def strands_record(now: OrganRun) -> records.Record | None:
    """Return the strands outside the organ, None if there are none."""
    system, state = now.system, now.state
    organ: Any = system.organ
    s = np.zeros(0) if system.contact is None else abscissae(system, state, SAMPLES)
    if not s.size:
        return None
    body = getattr(organ, "full", organ).elasticity
    places = places_of(system.at(state).thread.spline, state.q, s)
    displacement = body.nodal(organ.displacement(state.organ))
    deep = -tissue.skin_of(body).faced(displacement, places, np.zeros((len(s), 0)))[:, AWAY]
    points, P = organ.touching_points(state.organ) if system.bears else (places[:0], s[:0])
    across, along = P[: len(points)], P[len(points) :].reshape(-1, 2)
    friction, bears = np.linalg.norm(along, axis=1) if along.size else np.zeros(across.size), np.flatnonzero(across)
    deepest = int(np.argmax(deep))
    return records.StrandsRecord(
        pressed=bears.size,
        force=float(across.sum()),
        friction=float(friction.sum()),
        held=held_aside(system, state),
        off_friction=off_friction(now, points[bears, LABEL], friction[bears]) if bears.size else 0.0,
        depth=float(deep[deepest]),
        s=float(s[deepest]),
    )


def off_friction(now: OrganRun, at: Array, friction: Array) -> float:
    """Return the largest change of tension over bearing points of a strand beyond their friction [N].

    The points have abscissae `at` (j,) [m] and `friction` (j,) [N]. At rest T + EI κ²/2 + ρA g·P
    changes only by forces along the thread. Parts of a strand without bearing points are compared by
    their median, if they are at least a span long.
    """
    if now.state.v.any():
        return 0.0
    thread, drawn = now.system.thread, thread_record(now)
    along = drawn.tension + 0.5 * thread.EI * drawn.curvature**2
    along += thread.section.rhoA * (drawn.points @ now.system.gravity)
    order = np.argsort(at)
    at, friction = at[order], np.append(0.0, np.cumsum(friction[order]))
    strand, part = np.searchsorted(np.sort(now.state.s[now.state.present]), drawn.s), np.searchsorted(at, drawn.s)
    keys, own, counts = np.unique(np.column_stack([strand, part]), axis=0, return_inverse=True, return_counts=True)
    long = np.flatnonzero(counts >= SAMPLES).tolist()
    found = [(*keys[k].tolist(), float(np.median(along[own == k]))) for k in long]
    both = [(one, other) for one, other in combinations(found, 2) if one[0] == other[0]]
    return max([abs(H - H0) - float(friction[k] - friction[k0]) for (_, k0, H0), (_, k, H) in both] + [0.0])


def own_holes(holes: Sequence[PiercingObservation]) -> tuple[PiercingObservation, ...]:
    """Return the piercings without the balls of tracts."""
    return tuple(hole for hole in holes if not hole.tract)


def tract_records(holes: Sequence[PiercingObservation]) -> tuple[records.TractRecord, ...]:
    """Return the tracts, each with its balls."""
    names = dict.fromkeys(hole.tract for hole in holes if hole.tract)
    return tuple(records.TractRecord(name, tuple(hole for hole in holes if hole.tract == name)) for name in names)


def observed_wounds(now: OrganRun, open_lips: tissue.Gaps | None) -> Iterator[tuple[Wound, ContactObservation, Array]]:
    """Yield the surface pairs of wounds, their contact, and the places of all nodes.

    The places have shape `(n, 3)` [m].
    """
    organ: Any = now.system.organ
    touching = observe_contact(now.system, now.state)
    both = ((open_lips, None), (organ.gaps if touching else None, touching))
    observed = [(gaps, lips) for gaps, lips in both if gaps is not None]
    wounds = wounds_of(now.system, [gaps for gaps, _ in observed], now.piercings) if observed else []
    for (gaps, pressed), found in zip(observed, wounds, strict=True):
        points = gaps.body.points + gaps.body.nodal(organ.displacement(now.state.organ))
        lips = pressed or observe_apart(gaps, points)
        for wound, own in zip(found, gaps.slices, strict=True):
            yield wound, lips.of(own), points


def observe_apart(gaps: tissue.Gaps, points: Array) -> ContactObservation:
    """Return the observation of surfaces without contact.

    All nodes of the organ are at `points` `(n, 3)` [m].
    """
    displacement, k = points - gaps.body.points, len(gaps.left)
    none, slips = np.zeros(k), np.zeros(k, dtype=bool)
    return ContactObservation(gaps.apart(displacement), none, gaps.slides(displacement), np.zeros((k, 3)), slips)


def contact_records(now: OrganRun, open_lips: tissue.Gaps | None = None) -> tuple[records.Record, ...]:
    """Return the surfaces of wounds, pair by pair."""
    return tuple(contact_record(*observed) for observed in observed_wounds(now, open_lips))


def gap_profile(now: OrganRun, open_lips: tissue.Gaps | None = None) -> tuple[records.Record, ...]:
    """Return the gaps of wounds along their rims."""
    return tuple(gap for wound, lips, points in observed_wounds(now, open_lips) for gap in wound.profile(lips, points))


def contact_record(wound: Wound, lips: ContactObservation, points: Array) -> records.Record:
    """Return one pair of surfaces.

    The gap of a node that faces nothing is the extent of the surfaces.
    """
    part = wound.gaps.parts[wound.part]
    pressure, faces = part.hats.T @ part.vertex_pressure(lips.force), lips.gap < wound.gaps.extent
    is_open = faces & (lips.gap > records.APART)
    return records.ContactRecord(
        pair=part.name,
        pairs=len(lips.gap),
        pressed=lips.pressed,
        smallest_gap=float(lips.gap.min()),
        largest_pressure=float(pressure.max()),
        area=float(part.pair_areas[faces & ~is_open & (pressure > 0.0)].sum()),
        slide=float(lips.slide.max()),
        force=float(lips.force.sum()),
        complementarity=lips.complementarity,
        largest_gap=float(lips.gap[faces].max(initial=0.0)),
        open_area=float(part.pair_areas[is_open].sum()),
        gap_volume=float(part.pair_areas[faces] @ np.maximum(lips.gap[faces], 0.0)),
        slipping=int(np.count_nonzero(lips.slips)),
        friction=float(np.linalg.norm(lips.friction.sum(axis=0))),
        approximation=float(part.pair_areas[np.abs(lips.gap) <= records.APART].sum() / part.pair_areas.sum()),
        closure_force=wound.closure_force,
        eversion=wound.eversion(points),
        stitches=wound.stitches,
    )


def load_records(system: System, state: State) -> tuple[records.Record, ...]:
    """Return the loads on the organ's boundaries in a state."""
    organ: Any = system.organ
    if state.organ.shares is None:
        return ()
    loads = organ.surface
    shares, forces = state.organ.shares.tolist(), organ.load_resultants(state.organ)
    numbers = zip(loads.each, shares, loads.areas.tolist(), forces, strict=True)
    return tuple(
        records.LoadRecord(boundary=load.boundary, share=share, area=area, force=share * force)
        for load, share, area, force in numbers
    )


def krylov_record(system: System, state: State) -> records.Record | None:
    """Return the Krylov space of the organ in a state, None for an organ without a Krylov space."""
    organ = system.organ
    if not isinstance(organ, tissue.KrylovOrgan):
        return None
    return records.KrylovRecord(vectors=organ.vectors(state.organ), residual=organ.residual(state.organ))


def lip_fields(system: System, state: State, nodes: int) -> tuple[Array, Array] | tuple[None, None]:
    """Return the pressure [Pa] and gap [m] of the lips at all nodes, `(nodes,)` each.

    Both are None without contact.
    """
    lips = observe_contact(system, state)
    if lips is None:
        return None, None
    organ: Any = system.organ
    pressure, gap = np.zeros(nodes), np.full(nodes, np.nan)
    both = organ.gaps.nodes[:, ::-1]  # a right node can face several left nodes: the last is shown
    pressure[both], gap[both] = organ.gaps.pressure(lips.force)[:, None], lips.gap[:, None]
    return pressure, gap


def thread_record(now: OrganRun) -> ThreadRecord:
    """Return the thread sampled evenly on each span.

    Tension is interpolated between the Gauss points, where it is most accurate.
    """
    state, thread, spline = now.state, now.system.thread, now.system.thread.spline
    breaks, ends = spline.breaks, np.searchsorted(spline.breaks, spline.piece_ends)
    inner = np.arange(SAMPLES) / SAMPLES
    inside = (breaks[:-1, None] + np.diff(breaks)[:, None] * inner).ravel()
    s = np.insert(inside, SAMPLES * ends[1:], spline.piece_ends[1:])
    pieces = tuple((SAMPLES * np.diff(ends) + 1).tolist())
    home = np.repeat(spline.piece_ends[:-1], pieces)
    P, T, K, _ = spline.curve(state.q[:, :3], s, home).swapaxes(0, 1)
    elastic = now.configuration.points.strain
    tension = thread.EA * elastic * np.sqrt(1.0 + 2.0 * thread.whole_strain(elastic))
    return ThreadRecord(
        points=P,
        s=s,
        tension=spline.interpolate(s, home, thread.axial.s, thread.axial.home, tension),
        curvature=curvature(T, K),
        radius=0.5 * thread.section.diameter,
        pieces=pieces if spline.cuts.size else (),
        torque=None if state.frame is None else thread.torque_at(s, home, state.q, state.frame),
        bearing=bearing_along(now.piercings, s),
    )


def bearing_along(holes: Sequence[PiercingObservation], s: Array) -> Array | None:
    """Return the force of tracts on the thread per length at abscissae, `(m, 3)` [N/m].

    It is constant along the length of a ball, and zero elsewhere. It is None without tracts.
    """
    balls = [(ball, ball.bearing) for ball in holes if ball.tract and ball.bearing]
    if not balls:
        return None
    out = np.zeros((len(s), 3))
    for ball, length in balls:
        out[np.abs(s - ball.s) <= 0.5 * length] = ball.force / length
    return out
