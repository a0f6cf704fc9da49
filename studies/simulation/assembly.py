"""From a scenario to the coupled system: mesh, organ, thread, piercings and a consistent start."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
import skfem

import tissue
from coupling.rest.laying import start
from coupling.step import tables
from coupling.system import Friction, Piercing, State, System, ThreadContact, turns
from coupling.ties import Tie
from studies import scenario as model
from studies.arrays import Array
from studies.scenario import Scenario, refuse, refused
from studies.scenario.organ import ACCURACY
from studies.scenario.scenario import check_cuts, check_order, check_spans, resolved
from studies.simulation.given import NOTHING, Given
from studies.simulation.laid import LaidPath, moved_with, over_surface, through_holes
from studies.simulation.meshing import Holes, check_inside, organ_mesh, strength_at, with_places
from studies.simulation.organ import AnyOrgan, course_of, depths_of, fitted, loads_of, organ_of, recovery_of
from studies.simulation.sharing import Shared, body_key, mesh_key, organ_key, thread_key
from studies.simulation.tracts import Ball, Distances, bites_of, check_balls, of_piercings, with_balls
from thread.catalogue import Section, suture
from thread.cutting import SLIVER, cut
from thread.ends import Clamped, Driven, End, Fixed, Free, Pulled
from thread.errors import ThreadError
from thread.knots import uniform_knots
from thread.packets import END, Hold, bends_of, travelling
from thread.path import RoundedPath, rounded_path
from thread.placed import Placed
from thread.quadrature import gauss_rule
from thread.spline import DEGREE, Spline
from thread.thread import MASS_POINTS, Thread

log = logging.getLogger(__name__)

TOLERANCE = 0.01  # relative error of the holes' forces for packets of thread.packets.FIRST √(EI/T)
ALONG_ARC = np.array([0.0, 0.5, 1.0])  # places on an arc of a path at which its bend determines the spans
STRAND_LOOKS = 20  # points of a strand that are tested for lying in tissue
DRAWN = 4  # parts of the draw of a loop that relaxes: its force is then right to 0.2 %, with one part to 3 %
APART = 1e-6  # of the duration: of times that are closer, as at a jump of a load, the first counts
AT_CUT = 1e-9  # of the thread: at this distance round-off decides on which side of a cut a hole is
STRETCH = 1.6  # sutures break at strains of 20 to 60 %
BEARING_FOOTPRINTS = 2.0  # bearing length of a hole in footprints: the model spreads its force over this length
BEARING_DIAMETERS = 10.0  # bearing length in thread diameters, without a footprint or a bite


@dataclass(frozen=True)
class Assembly:
    """A prepared scenario: all defaults, the coupled system, and functions for the output.

    `holes` are the piercings with the balls of tracts in between. Their abscissae are `s` (p,) [m]
    on the thread and `at` (p,) [m] on its path. The path passes `through` the holes, and the resting
    organ moves it to `laid`.
    With an organ, `recovery` returns stress from displacement, and `depths` the depth of points in it
    (k,) [m]. `given` are the parts from Python. `fit` is the refinement of cells, None without
    refinement.
    """

    scenario: Scenario
    holes: tuple[model.Piercing, ...]
    system: System[tissue.OrganState]
    organ: AnyOrgan
    through: LaidPath
    laid: LaidPath
    at: Array
    s: Array
    body: tissue.Elasticity | None
    recovery: Callable[[], tissue.StressRecovery]
    depths: Callable[[Array], Array]
    given: Given = NOTHING
    fit: tissue.Fitted | None = None

    @property
    def path(self) -> RoundedPath:
        """The rounded path as given, before it is led through the holes."""
        return self.laid.path

    @property
    def begin_abscissae(self) -> Array:
        """Abscissa at which each piercing begins, `(p,)` [m].

        It is NaN if a piercing begins at the nearest point of the thread.
        """
        return np.where([is_known(hole) for hole in self.holes], self.s, np.nan)

    def start(self) -> State[tissue.OrganState]:
        """Return the consistent start: Φ = 0, with the thread as near to its path as possible."""
        thread = self.system.thread
        stretch = self.laid.length / thread.spline.end
        points = self.laid.points(gauss_rule(thread.spline, MASS_POINTS).s * stretch)
        return start(self.system, self.s, points, stretch)


def assemble(scenario: Scenario, store: Shared | None = None, given: Given = NOTHING) -> Assembly:
    """Return the assembly of a scenario, built before the first step.

    Mesh, organ and factor come from the `store` if possible. Parts in `given` replace parts of the
    scenario. Raises `ScenarioError`, `MeshError`, `TissueError`, `ThreadError` for refused input.
    """
    path = rounded_path(scenario.thread.path)
    length = length_of(scenario, path)
    store = shareable(store, given)
    scenario = with_places(given.applied_to(scenario), store, given.volume)
    own = abscissae(scenario, path, length)
    through = path_through(scenario.piercing, path, np.array(own) * (path.length / length))

    def holes_on(mesh: skfem.MeshTet | None) -> tuple[Holes, list[float]]:
        """Return the holes with the balls of tracts in a mesh, and their abscissae."""
        if mesh is not None:
            check_inside(scenario.piercing, mesh)
        return with_balls(scenario, through, own, length, mesh)

    make_mesh = partial(organ_mesh, scenario, given.volume, lambda mesh: [site_of(hole) for hole in holes_on(mesh)[0]])
    mesh = None if scenario.tissue is None else store.take("mesh", mesh_key(scenario), make_mesh)
    known = [(hole, at) for hole, at in zip(scenario.piercing, own, strict=True) if is_known(hole)]
    check_order(known, length)
    holes, s = holes_on(mesh)
    check_balls(scenario.thread, holes)
    sites = [site_of(hole) for hole in holes]
    body, fit = store.take("body", body_key(scenario), partial(fitted, scenario, given, mesh, sites))
    make_organ = partial(organ_of, scenario, sites, body, fit, given)
    organ: AnyOrgan = store.take("organ", organ_key(scenario), make_organ)
    at = np.array(s) * (path.length / length)
    if (skin := getattr(organ, "skin", None)) is not None:
        through = over_surface(through, at, section_of(scenario.thread).diameter, skin)
    moves = store.take("rest", organ_key(scenario), lambda: moves_at_rest(organ))
    there = np.array([is_known(hole) for hole in holes], dtype=bool)
    laid = moved_with(scenario, through, at[there], moves[there])
    as_given = scenario
    scenario, length, s = carried(scenario, holes, laid, at, s)
    own = of_piercings(holes, s)
    check_cuts(scenario.thread.cuts, length)
    check_cuts([table.s for table in scenario.cut], length, "cut.s")
    known_s = [value for hole, value in zip(holes, s, strict=True) if is_known(hole)]
    check_at_cuts(scenario, length, known_s)
    thread = store.take("thread", thread_key(scenario, length, s), lambda: thread_of(scenario, holes, length, s))
    check_pieces(scenario, thread.spline, known_s)
    check_cutting(scenario.cut, thread)
    check_draws(scenario.piercing, thread.spline, own)
    whole = resolved(as_given) if laid.moves.any() else resolved(scenario, length, own)
    depths = partial(depths_of, scenario, body, store)
    rough = {*given.friction, *(hole.name for hole in scenario.piercing if hole.friction is not None)}
    bites = bites_of(scenario, path, of_piercings(holes, at.tolist()), rough, depths)
    system: System[tissue.OrganState] = System(
        thread=thread,
        ends=(end_of(whole, whole.thread.start, path, 0.0), end_of(whole, whole.thread.end, path, path.length)),
        organ=organ,
        piercings=tuple(piercing_of(hole, scenario, body, given, bites.get(hole.name, 0.0)) for hole in holes),
        gravity=np.array(scenario.solve.gravity),
        epsilon=scenario.solve.epsilon,
        ties=tuple(tie_of(table, holes) for table in scenario.tie),
        compiled=is_compiled(scenario.solve),
        contact=None if body is None else contact_of(scenario, holes, through, at, depths),
    )
    recovery = cache(partial(recovery_of, scenario, body, store))
    return Assembly(whole, holes, system, organ, through, laid, at, np.array(s), body, recovery, depths, given, fit)


def moves_at_rest(organ: AnyOrgan) -> Array:
    """Return the displacements of the holes when the organ comes to rest, `(p, 3)` [m].

    The thread does not act on the organ.
    """
    moved = organ.site_variables(organ.start()) - organ.y0
    return np.asarray(moved.reshape(-1, 9)[:, :3])


def path_through(holes: Sequence[model.Piercing], path: RoundedPath, at: Array) -> LaidPath:
    """Return a path through the holes that hold the thread at the start, at abscissae `at` (p,) of it [m]."""
    held = np.array([hole.from_ == 0.0 for hole in holes], dtype=bool)
    places, at = np.array([hole.place for hole in holes]).reshape(-1, 3)[held], at[held]
    return through_holes(path, at, places - path.position(np.clip(at, 0.0, path.length)))


def carried(
    scenario: Scenario, holes: Sequence[model.Piercing], laid: LaidPath, at: Array, s: Sequence[float]
) -> tuple[Scenario, float, list[float]]:
    """Return the scenario of a thread laid on the resting organ, with its length and holes.

    The second value is the rest length of the thread [m], the third are the abscissae of its holes
    [m]. `s` (p,) [m] are the abscissae for the original path, and `at` (p,) [m] the places on it. A
    given length or abscissa is kept. Without a given length, cuts at the start keep their places on
    the path.
    """
    length = length_of(scenario, laid)
    if not laid.moves.any():
        return scenario, length, list(s)
    new = laid.length_to(at) * (length / laid.length)
    moved = [value if hole.s is None else hole.s for hole, value in zip(holes, new.tolist(), strict=True)]
    if scenario.thread.length is None:
        cuts = laid.length_to(np.array(scenario.thread.cuts)).tolist()
        thread = scenario.thread.model_copy(update={"cuts": tuple(cuts)})
        scenario = scenario.model_copy(update={"thread": thread})
    return scenario, length, moved


def is_compiled(solve: model.Solve) -> bool:
    """Return whether steps are taken by compiled loops.

    They are compiled if requested, or by default in dynamic runs. A dynamic run has hundreds of
    steps. A static run has few steps, which take less time than the loading of the loops. Loops
    that cannot be cached would be compiled for every run.
    """
    if solve.newton != "auto" or solve.kind == "static" or solve.scheme == "linear":
        return solve.newton == "compiled"
    kept = tables.folder_of_loops() is not None
    if not kept:
        log.info("steps are solved in numpy, because no folder can cache compiled loops; set NUMBA_CACHE_DIR")
    return kept


def shareable(store: Shared | None, given: Given) -> Shared:
    """Return the store, or a new store if parts came from Python."""
    return Shared() if store is None or given.unrecorded else store


def is_known(hole: model.Piercing) -> bool:
    """Return whether the abscissa of a piercing is known before the first step."""
    return hole.s is not None or hole.from_ == 0.0


def length_of(scenario: Scenario, path: RoundedPath | LaidPath) -> float:
    """Return the rest length of the thread [m].

    Raises `ScenarioError` if it differs too much from the path.
    """
    length = scenario.thread.length or path.length
    refuse(path.length > STRETCH * length, "thread.length", length, "thread-short", path=path.length)
    share = path.length / length
    refuse(length > STRETCH * path.length, "thread.length", length, "thread-long", path=path.length, share=share)
    return length


def abscissae(scenario: Scenario, path: RoundedPath, length: float) -> list[float]:
    """Return the abscissa of every piercing at the start [m].

    It is given, or the nearest pass of the path after the piercing before.
    """
    s: list[float] = []
    for hole in scenario.piercing:
        s.append(nearest_pass(path, hole.place, s[-1:]) * length / path.length if hole.s is None else hole.s)
    return s


def nearest_pass(path: RoundedPath, point: Sequence[float], after: Sequence[float]) -> float:
    """Return the abscissa on the path [m] of its nearest pass by a point.

    If several passes are equally near, it is the first one `after` an abscissa.
    """
    places, distances = path.passes(point)
    nearest = places[distances <= distances.min() + 1e-9 * path.length]
    later = nearest[nearest > after[0]] if after else nearest
    return float(later[0] if later.size else nearest[0])


def travelling_spline(scenario: Scenario, holes: Sequence[model.Piercing], length: float, s: Sequence[float]) -> Placed:
    """Return the spline at the start of a thread with travelling knots.

    The thread is still slack, so its knots follow the bends of the path and not those from tension.
    """
    table = scenario.thread
    check_stubs(table.cuts, (0.0, length), section_of(table).diameter, "thread.cuts")
    longest = length / (table.control_points - DEGREE)
    scale = float(np.sqrt(table.tolerance / TOLERANCE))
    path = rounded_path(table.path)
    at = path.starts[:, None] + path.lengths[:, None] * ALONG_ARC
    curvature = np.broadcast_to(path.curvatures[:, None], at.shape) * (path.length / length)
    bends = bends_of(at.ravel() * (length / path.length), curvature.ravel(), scale)
    holds = [
        Hold(k, at, hole.direction != "free", bends.span_at(at, longest))
        for k, (hole, at) in enumerate(zip(holes, s, strict=True))
        if hole.from_ == 0.0
    ]
    places = [at for at, end in zip((0.0, length), table.ends, strict=True) if end.kind == "clamped"]
    holds += [Hold(len(holes) + k, at, True, bends.span_at(at, longest)) for k, at in enumerate(places)]
    total = len(holes) + len(places) + 2 * len(scenario.tie)
    firsts = {hold.s: hold.first for hold in holds if hold.directed}
    travel = travelling(length, holds, total, longest, (firsts.get(0.0), firsts.get(length)), scale, table.cuts, bends)
    at = np.zeros(total)
    at[[hold.number for hold in holds]] = [hold.s for hold in holds]
    return Placed(travel.knots, travel.places(at), travel)


def spline_of(table: model.Thread, length: float) -> Spline:
    """Return the spline of a thread with fixed knots."""
    spline = Spline(uniform_knots(length, table.control_points, table.cuts))
    check_spans(table.cuts, spline.piece_ends.tolist(), spline.breaks.tolist())
    return spline


def thread_of(scenario: Scenario, holes: Sequence[model.Piercing], length: float, s: Sequence[float]) -> Thread:
    """Return the thread of a scenario."""
    table = scenario.thread
    travels = table.knots == "travelling"
    return Thread(
        spline=travelling_spline(scenario, holes, length, s) if travels else spline_of(table, length),
        section=section_of(table),
        bending=table.bending,
        twist=table.twist,
        coil=0.0 if table.coil_radius is None else 1.0 / table.coil_radius,
        coil_towards=None if table.coil_towards is None else np.array(table.coil_towards),
        springs=None if table.energy == "continuous" else table.springs or table.control_points - 1 - len(table.cuts),
        damping=table.damping,
        point_masses=(table.start.mass, table.end.mass),
        relaxation=tissue.Prony(*zip(*table.relaxation, strict=True)) if table.relaxation else None,
    )


def section_of(table: model.Thread) -> Section:
    """Return the section of a named suture, or from the given dimensions."""
    given = (table.diameter, table.density, table.youngs_modulus, table.poisson_ratio)
    section = suture(table.suture) if table.suture else Section(*(value for value in given if value is not None))
    return section if table.bending_factor is None else replace(section, bending_factor=table.bending_factor)


def end_of(scenario: Scenario, table: model.End, path: RoundedPath, at: float) -> End:
    """Return the holder of the thread's end at the abscissa `at` of the path."""
    match table:
        case model.FixedEnd():
            return Fixed(path.position(at), turn=turn_of(table))
        case model.ClampedEnd():
            return Clamped(path.position(at), path.tangent(at), turn=turn_of(table))
        case model.PulledEnd():
            course = course_of(scenario.solve, table)
            return Pulled(np.array(table.force), None if course is None else np.array(course))
        case model.DrivenEnd():
            return Driven(np.array(table.waypoints), turn=turn_of(table))
    return Free()


def turn_of(table: model.FixedEnd | model.ClampedEnd | model.DrivenEnd) -> Array | None:
    """Return the prescribed times and angles of an end's rotation, or None."""
    return None if table.turn is None else np.array(table.turn)


def friction_of(hole: model.Piercing, scenario: Scenario, given: Given, bite: float) -> Friction | None:
    """Return the friction of a hole, including a law from Python; None without friction.

    Without a given channel, a rough hole guides the thread over its part of its `bite` [m].
    """
    table, own = hole.friction, given.friction.get(hole.name)
    if table is None and own is None:
        return None
    diameter = section_of(scenario.thread).diameter
    default = bite if bite > diameter else BEARING_DIAMETERS * diameter
    numbers = (0.0, 0.0, 0.0) if table is None else (table.static, table.kinetic, table.grip)
    return Friction(*numbers, None if hole.direction == "free" else hole.channel or default, own)


def contact_of(
    scenario: Scenario, holes: Sequence[model.Piercing], through: LaidPath, at: Array, depths: Distances
) -> ThreadContact:
    """Return how the thread meets the organ's surface.

    A strand is inside if more than half of its path `through` the holes lies in tissue; `at` (p,)
    [m] are the holes on the path.
    """
    own = [k for k, hole in enumerate(holes) if is_known(hole) and not isinstance(hole, Ball)]
    ends = [(END, 0.0), *((k, float(at[k])) for k in own), (END, through.path.length)]
    inside = []
    for (one, low), (other, high) in pairwise(ends):
        middles = low + (high - low) * (np.arange(STRAND_LOOKS) + 0.5) / STRAND_LOOKS
        if np.mean(depths(through.position(middles)) > 0.0) > 0.5:
            inside.append((one, other))
    surface = scenario.thread.surface
    return ThreadContact(tuple(inside), surface is not None, 0.0 if surface is None else surface.friction)


def bearing_of(hole: model.Piercing, scenario: Scenario) -> float:
    """Return the length over which the thread bears on the tissue at a hole [m].

    It is the length of a ball of a tract, or of a given channel. Otherwise it is BEARING_FOOTPRINTS
    footprints in an organ: the force is spread over this length, and no other length is known. For
    a bare point, or without an organ, it is BEARING_DIAMETERS diameters of the thread.
    """
    if isinstance(hole, Ball):
        return hole.length
    in_organ = hole.footprint if scenario.tissue is not None else 0.0
    default = BEARING_FOOTPRINTS * in_organ or BEARING_DIAMETERS * section_of(scenario.thread).diameter
    return hole.channel or default


def piercing_of(
    hole: model.Piercing, scenario: Scenario, body: tissue.Elasticity | None, given: Given, bite: float
) -> Piercing:
    """Return the constraint of a hole; `bite` is the length of its own half of the bite [m]."""
    organ = scenario.tissue
    return Piercing(
        hole.name,
        slides=hole.kind == "sliding",
        directed=hole.direction != "free",
        friction=friction_of(hole, scenario, given, bite),
        begins=hole.from_,
        ends=np.inf if hole.until is None else hole.until,
        draw=hand_of(hole.draw),
        pull=hand_of(hole.pull),
        bearing=bearing_of(hole, scenario),
        strength=np.inf if organ is None or body is None else strength_at(organ, body.mesh, hole.place),
        tract=hole.tract if isinstance(hole, Ball) else "",
    )


def hand_of(rows: Sequence[Sequence[float]] | None) -> Array | None:
    """Return the rows of a hand, shape `(k, 2)`, with NaN for letting go; None without a hand."""
    return None if rows is None else np.array([row if len(row) == 2 else (row[0], np.nan) for row in rows])


def tie_of(table: model.Tie, holes: Sequence[model.Piercing]) -> Tie:
    """Return a tie between its holes, in the order along the thread."""
    names = [hole.name for hole in holes]
    first, last = sorted(names.index(name) for name in table.between)
    hold = np.inf if table.hold is None else table.hold
    times = table.from_, table.until, table.growth
    return Tie(table.name, (first, last), table.force, *times, table.speed, hold, table.held)


def site_of(hole: model.Piercing) -> tissue.Site:
    """Return the place of a hole on the organ."""
    direction = None if hole.direction == "free" else hole.direction
    line = hole.tract if isinstance(hole, Ball) else ""
    return tissue.Site(hole.place, hole.footprint, hole.weight, direction, f'piercing "{hole.name}"', line)


def bounds_of(scenario: Scenario, body: tissue.Elasticity | None, holes: Sequence[model.Piercing]) -> Array | None:
    """Return bounds of the exact compliance of holes, over the compliance of an organ.

    The result has shape `(p, 2)` [-], lower and upper. It is None if bounds are not requested.
    Raises `TissueError`.
    """
    table = scenario.tissue
    if table is None or body is None or not table.mesh.bound:
        return None
    accuracy = ACCURACY if table.mesh.accuracy == "given" else table.mesh.accuracy
    sites = [site_of(hole) for hole in holes]
    return tissue.relative_bounds(body, sites, table.clamp, table.roller, accuracy)


def marks_of(assembly: Assembly) -> tuple[float, ...]:
    """Return the times [s] at which a load step is divided.

    They are those at which a load or the hand at an end turns, because its height would be missed.
    If anything relaxes, they also divide the draw of each tie into DRAWN parts, because the loop
    relaxes as it is drawn.
    """
    scenario, system = assembly.scenario, assembly.system
    of_loads = [load.course for load in loads_of(scenario)]
    of_ends = [end.course for end in system.ends if isinstance(end, Pulled)]
    courses = [np.array(course) for course in (*of_loads, *of_ends) if course is not None]
    hands = [end.waypoints for end in system.ends if isinstance(end, Driven)]
    courses += [rows[:, [0, axis]] for rows in hands for axis in (1, 2, 3)]
    out = {time for rows in courses for time in turns(rows)}
    if getattr(assembly.organ, "relaxation", None) or system.thread.relaxation:
        out |= {time for tie in system.ties for time in np.linspace(tie.begins, tie.locks, DRAWN + 1).tolist()}
    times = np.sort([*out])
    return tuple(times[np.diff(times, prepend=-np.inf) > APART * scenario.solve.duration].tolist())


# --- checks of the pieces of a thread: control points for holes, a holder in statics, length for hands ------


def check_at_cuts(scenario: Scenario, length: float, s: Sequence[float]) -> None:
    """Refuse a hole, among those at `s` [m], at a cut of a thread of `length` [m]."""
    cuts = np.array(scenario.thread.cuts)
    for at in s:
        if np.abs(cuts - at).min(initial=np.inf) <= AT_CUT * length:
            raise refused("thread.cuts", scenario.thread.cuts, "cut-at-hole", s=at)


def check_pieces(scenario: Scenario, spline: Spline, s: Sequence[float]) -> None:
    """Refuse a piece of a cut thread with too few control points for its holes at `s` [m].

    In statics also refuse a piece that nothing holds.
    """
    if spline.pieces == 1:
        return
    held = np.bincount(spline.piece_of(s), minlength=spline.pieces)
    held_by_end = np.zeros(spline.pieces, dtype=bool)
    held_by_end[[0, -1]] = [end.kind != "free" for end in scenario.thread.ends]
    for k, (holes, points) in enumerate(zip(held.tolist(), spline.piece_points.tolist(), strict=True)):
        where = "the thread's piece from {:.6g} to {:.6g} m".format(*spline.piece_ends[k : k + 2])
        if points < (least := 4 + 3 * holes):
            words = {"where": where, "points": points, "least": least, "holes": holes}
            raise refused("thread.control_points", scenario.thread.control_points, "piece-coarse", **words)
        if scenario.solve.kind == "static" and not holes and not held_by_end[k]:
            raise refused("thread.cuts", scenario.thread.cuts, "piece-loose", where=where)


def check_stubs(cuts: Sequence[float], ends: Sequence[float], diameter: float, key: str) -> None:
    """Refuse cuts of this `key` that leave a piece shorter than the thread's `diameter` [m].

    The pieces end at `ends` [m]. With travelling knots this is the only bound.
    """
    every = list(ends)
    for s in cuts:
        refuse(min(abs(end - s) for end in every) < diameter, key, s, "stub", diameter=diameter)
        every.append(s)


def check_cutting(cuts: Sequence[model.Cut], thread: Thread) -> None:
    """Refuse cuts during the run near an end of the thread.

    Also refuse cuts that leave a piece of one span.
    """
    spline = thread.spline
    if thread.travels:
        check_stubs([table.s for table in cuts], spline.piece_ends.tolist(), thread.section.diameter, "cut.s")
        return
    for table in sorted(cuts, key=lambda table: table.time):
        try:
            spline, *_ = cut(spline, table.s, [np.zeros((spline.n, 1))])
        except ThreadError:
            raise refused("cut.s", table.s, "cut-near", spans=SLIVER) from None
    check_spans([table.s for table in cuts], spline.piece_ends.tolist(), spline.breaks.tolist(), "cut.s")


def check_draws(holes: Sequence[model.Piercing], spline: Spline, s: Sequence[float]) -> None:
    """Refuse hands that draw a piece of thread too far.

    A piece must not leave its hole at `s` [m], and an anchored hole must not pass another.
    """
    anchored = [
        (hole, at)
        for hole, at in zip(holes, s, strict=True)
        if hole.kind == "anchored" and hole.pull is None and hole.from_ == 0.0
    ]
    times = sorted({0.0} | {time for hole, _ in anchored for time, *_ in hole.draw or ()})
    before: dict[int, tuple[str, Array]] = {}
    for hole, at in anchored:
        piece, way = int(spline.piece_of(at)), at - drawn_length(hole, times)
        key = hole.key("draw")
        start, end = spline.piece_ends[piece : piece + 2]
        if hole.draw and (way.min() <= start or way.max() >= end):
            raise refused(key, hole.draw, "drawn-out", at=at, begins=start, ends=end)
        name, last = before.get(piece, ("", np.full(way.shape, -np.inf)))
        refuse(np.any(way <= last), key, hole.draw, "drawn-past", name=name)
        before[piece] = (hole.name, way)


def drawn_length(hole: model.Piercing, times: Sequence[float]) -> Array:
    """Return the length drawn through a hole from t = 0 to each of the times [m]."""
    table = np.array(hole.draw or [(0.0, 0.0)])
    return np.asarray(np.interp(times, *table.T) - np.interp(0.0, *table.T))
