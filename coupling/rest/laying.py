"""A consistent start: Φ = 0, the thread as close to a given path as possible, and no strain except
that of its length.

The laid thread is an equilibrium on its bed. It is nearly inextensible and lies on an elastic bed
along the path. Some bending stiffness rounds the kinks that the bed would cause, and the abscissae
are held.
The bed has the form of the inertia term of a step, so that the same Newton solver applies.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from coupling.answer import all_holds, hold_still
from coupling.arrays import Array, Flags
from coupling.errors import StepError
from coupling.integrators import Equilibrium
from coupling.interfaces import Body
from coupling.joins.contact import solve_contact
from coupling.step.newton import Iterate, Problem
from coupling.step.sliding import law_of, prescribed
from coupling.step.solver import find
from coupling.step.stepping import sense, with_ends
from coupling.system import State, System
from thread.placed import Placed
from thread.quadrature import gauss_rule
from thread.spline import Spline
from thread.thread import Thread
from tissue.organs.meshed import SiteAnswer

log = logging.getLogger(__name__)

BED_SPANS = 1.0  # spans next to a hole with another direction over which the thread departs from the path
# Axial stiffness EA h²/EI of the laid thread. The thread is soft on the path at first. The bed is then moved to the
# thread and the thread is made stiffer: the strain from the corners of the path goes into its bends. Each stage also
# takes the thread further from its path, so they are few.
ON_PATH = 1e2
SETTLING = (1e3,) * 2 + (1e4,) * 4 + (1e6,) * 3 + (1e8,) * 3
UNSTRAINED = 1e-6  # a thread with a smaller strain counts as unstrained
# First stiffness of each attempt, and the stages after it. If the path bends back within a few spans, a thread that
# is softer at first follows the bend.
ATTEMPTS = (ON_PATH, SETTLING), (0.1 * ON_PATH, (3e1, 1e2, 3e2, *SETTLING))
STRAINED = 0.02  # a thread laid with a larger strain is laid again, softer at first
FEED_SPANS = 4.0  # spans by which a loose abscissa moves at the axial strain 1


@dataclass(frozen=True)
class Cord:
    """The section of the thread while it is laid: without twist, with unit bending stiffness,
    nearly inextensible.
    """

    EA: float
    EI: float = 1.0
    GJ: float = 1.0
    rhoA: float = 1.0
    rhoJ: float = 1.0
    diameter: float = 1.0


def project_path(thread: Thread, path: Array) -> Array:
    """Return the control points (n, 3) of a path by least squares.

    `path` (spans, g, 3) are its points at the points of the thread's mass rule.
    """
    rule = gauss_rule(thread.spline, path.shape[1])
    load = thread.vector(np.einsum("eg,egi,ega->eia", rule.w, rule.b[:, :, 0], path))
    M = thread.mass_matrix.toarray()
    return np.asarray(np.linalg.solve(M, load))


def laid_thread(thread: Thread, stretch: float, axial: float) -> Thread:
    """Return the thread over the path's arc length, with the section of a cord of EA = `axial` EI/h².

    The arc length is `stretch` times the rest length, and h is the mean span.
    """
    spline = stretched(thread.spline, stretch)
    span = (spline.end - spline.start) / (len(spline.breaks) - 1)
    cord = Cord(EA=axial / span**2, diameter=span)
    plain = replace(thread, bending=True, point_masses=(0.0, 0.0), twist=False, springs=None, coil=0.0)
    return replace(plain, spline=spline, section=cord)


def stretched(spline: Spline, by: float) -> Spline:
    """Return a spline whose abscissae are multiplied by a factor."""
    if not isinstance(spline, Placed):
        return Spline(spline.knots * by)
    travel = replace(spline.travel, a=spline.travel.a * by, limits=spline.travel.limits * by)
    return Placed(spline.knots, spline.places * by, travel)


@dataclass(frozen=True)
class Laying(Generic[Body]):
    """The data for laying a thread.

    The `answer` of an organ that is held, the `path` (spans, g, 3) [m] at the mass rule, and
    `stretch`, the length of the path over the thread's rest length.
    """

    answer: SiteAnswer[Body]
    path: Array
    stretch: float


def lay(system: System[Body], laying: Laying[Body], s: Array) -> tuple[Array, Array]:
    """Lay the thread, and return its control points (n, 3) [m] and abscissae (m,) [m].

    If the thread cannot be laid, or is folded within a span or strained, it is laid again, softer
    at first. Raises `StepError`.
    """
    laid: list[tuple[Array, Array, float]] = []
    errors: list[StepError] = []
    for axial, stages in ATTEMPTS:
        try:
            laid.append(lay_or_slide(system, laying, s, axial, stages))
        except StepError as error:
            errors.append(error)
            continue
        q, places, strain = laid[-1]
        if strain < STRAINED and not system.thread.spline.folds(q, places[system.from_start]).any():
            return q, places
    if not laid:
        raise errors[0]
    return min(laid, key=lambda result: result[2])[:2]


def lay_or_slide(
    system: System[Body], laying: Laying[Body], s: Array, axial: float, stages: Sequence[float]
) -> tuple[Array, Array, float]:
    """Lay the thread with the first stiffness `axial`, then those of the `stages`; return q, s and
    its largest strain.

    A hole may impose a direction that needs more length. If no unstrained thread fits with the
    abscissae `s`, the thread slides in its holes until one fits. A remaining strain is then imposed
    by its ends and anchors. Raises `StepError`.
    """
    held = lay_on_bed(system, laying, s, np.zeros(system.holds, dtype=bool), axial, stages)
    if held[2] < UNSTRAINED or not system.may_slide.any():
        return held
    loose = lay_on_bed(system, laying, s, system.may_slide & system.from_start, axial, stages)
    return min(held, loose, key=lambda result: result[2])


def lay_on_bed(
    system: System[Body],
    laying: Laying[Body],
    s: Array,
    loose: Flags,
    axial: float,
    stages: Sequence[float],
) -> tuple[Array, Array, float]:
    """Lay the thread with the holds `loose` sliding, and return q, s and its largest strain.

    The thread has the stiffness `axial` at first and is then made stiffer, stage by stage, as far
    as a solution is found.
    """
    m, abscissae = system.holds, s * laying.stretch
    first = laid_thread(system.thread, laying.stretch, axial)
    on_path = project_path(first, laying.path)
    soft, none = with_laid_thread(system, laying, axial), np.zeros(m, dtype=bool)
    q = with_ends(on_path, soft, 0.0)
    y = all_holds(system, laying.answer.y_free)
    z = Iterate(q, np.zeros_like(first.axial.s), abscissae, np.zeros((m, 5)), y, np.zeros(m))
    z = find(bed_problem(soft, on_path, laying.answer, z.s, none), z).iterate
    for stiffer in stages:
        problem = bed_problem(with_laid_thread(system, laying, stiffer), z.q, laying.answer, z.s, loose)
        try:
            z = find(problem, replace(z, sigma=loose.astype(float)), patience=1).iterate
        except StepError:
            break
    strain = float(np.abs(first.placed(z.s).points(z.q).strain).max())
    return z.q, z.s / laying.stretch, strain


def with_laid_thread(system: System[Body], laying: Laying[Body], axial: float) -> System[Body]:
    """Return the system with the laid thread in the place of its own."""
    return replace(system, thread=laid_thread(system.thread, laying.stretch, axial), epsilon=0.0)


def bed_problem(
    system: System[Body], on_path: Array, answer: SiteAnswer[Body], s: Array, loose: Flags
) -> Problem[Body]:
    """Return the problem of a thread on an elastic bed along `on_path` (n, 3), with all abscissae
    held except the `loose` ones.

    Springs resist the motion of loose abscissae. They move in the direction of the thread's pull
    and not to a distant balance. The bed gives way over BED_SPANS spans h: (4 EI/k)^¼ = BED_SPANS h
    with the bed's stiffness k and EI = 1. Where spans are unequal, h⁻⁴ is its mean along the thread:
    short spans are there for bends of the path, which a bed of mean spans would smooth away.
    """
    thread, m = system.thread, system.holds
    spans = np.diff(thread.spline.breaks)
    bed = 4.0 / BED_SPANS**4 * float((spans**-3).sum() / spans.sum())
    law = law_of(system, s, ~system.of_ties, thread.EA / (FEED_SPANS * float(spans.mean())), s)
    return Problem(
        system=system,
        time=0.0,
        dt=0.0,
        mass_factor=bed,
        q_ref=on_path,
        load=np.zeros_like(on_path),
        answer=answer,
        rows=system.rows & system.from_start[:, None],
        law=prescribed(law, ~loose, np.zeros(m)),
        weight=0.0,
    )


def resting_organ(system: System[Body]) -> Body:
    """Return the organ's state at the start, with its lips held apart if its own weight would make them cross."""
    organ = system.organ
    state = organ.start()
    if organ.lips(state)[0].min(initial=0.0) >= 0.0:
        return state
    # An organ with inertia starts undeformed and never reaches this line.
    answer, f_y = organ.answer(Equilibrium(np.inf), [state], 0.0), np.zeros(organ.y0.size)
    return answer.accept(f_y, solve_contact(system, f_y, answer))


def start(system: System[Body], s: Array, path: Array, stretch: float) -> State[Body]:
    """Return the state at t = 0, at rest.

    `s` (p,) [m] are the abscissae of the piercings; `path` and `stretch` are as for `Laying`.
    Piercings that begin later do not hold the thread yet.
    """
    log.info("laying the thread along its path")
    organ = resting_organ(system)
    y = all_holds(system, system.organ.site_variables(organ))
    ends = system.thread.spline.start, system.thread.spline.end
    s = np.concatenate([s, [ends[k] for k in system.clamps], np.full(2 * len(system.ties), ends[0])])
    q, s = lay(system, Laying(hold_still(system.organ, organ), path, stretch), s)
    m, thread = system.holds, system.thread.placed(s)
    q = np.pad(q, ((0, 0), (0, thread.coordinates - 3)))
    frame = thread.untwisted_frame(q)
    points = thread.points(q, frame)
    holding = np.where(system.held_flags, thread.gradient(points), 0.0)  # the organ's sites bear no force yet
    return State(
        time=0.0,
        q=q,
        v=np.zeros_like(q),
        N=thread.EA * points.strain,
        organ=organ,
        s=s,
        s_dot=np.zeros(m),
        lam=np.zeros((m, 5)),
        y=y,
        sigma=np.where(system.may_slide & ~system.rough & system.from_start, 1.0, 0.0),
        present=system.from_start,
        sense=sense(system.passage(q, s), y),
        reaction=holding[[0, -1]],
        frame=frame,
        spline=thread.spline if thread.travels else None,
    )
