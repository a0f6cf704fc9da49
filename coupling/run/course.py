"""The arrays for whole steps in compiled loops (`coupling.kernels.steps`), made from those of the first step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from coupling.answer import all_holds, pad_compliance
from coupling.arrays import Array, Flags
from coupling.integrators import BDF2, Scheme
from coupling.interfaces import Answer, Modal, ModalMotion, Steady
from coupling.joins.contact import NO_FORCES
from coupling.kernels.border import NINE
from coupling.kernels.constraints import Passage
from coupling.kernels.friction import Law
from coupling.kernels.iteration import Given, Unknowns
from coupling.kernels.steps import march
from coupling.kernels.steps.audit import BODY, TURNS, Motion
from coupling.kernels.steps.march import ENERGIES, Ends, Kept, Plan, Scene, Scratch
from coupling.kernels.steps.organ import Going, Organ, Pace
from coupling.kernels.steps.tautness import Strands
from coupling.kernels.steps.tension import Along
from coupling.kernels.steps.watch import Shares
from coupling.reports.audit import NONE, PLANE
from coupling.reports.observation import Seen
from coupling.run.tautness import loose_ends, strands_of
from coupling.run.watch import CREATED, CREATED_BDF2, SHARE, TRACE
from coupling.step.newton import Problem
from coupling.step.packets import fit_of
from coupling.step.stability import borne_pressure
from coupling.step.stepping import dynamic_problem, organ_answer
from coupling.step.tables import (
    bounds_of,
    empty_found,
    empty_passing,
    empty_ridden,
    given_of,
    is_kept,
    own_curve,
    solver_for,
    tables_of,
    telling,
)
from coupling.step.tension import along_of
from coupling.system import State, System, forgetful
from thread.kernels.travel import Field
from thread.placed import Placed
from thread.riding import plain
from thread.thread import Thread
from tissue.recent import Recent

KEPT = "march.march_of."  # first part of the file names of the loops on disk
Arrays = TypeVar("Arrays", Law, Given, Strands, Field, Along)


@dataclass(frozen=True, eq=False)
class Body:
    """An organ for the loops, from a state on.

    `answer` is the one for the first step, and `organ` its data for the loops. `now` and `earlier`
    are its motion. `state` makes the organ's own state from such a motion.
    """

    answer: Answer[Any]
    organ: Organ
    now: ModalMotion
    earlier: ModalMotion
    state: Callable[[ModalMotion], Any]


def body_of(system: System[Any], scheme: Scheme, state: State[Any], times: Sequence[float]) -> Body | None:
    """Return the organ of a system for steps of a scheme from a state.

    None if the loops do not cover the organ, or if its loads change until the last of the `times`
    [s].
    """
    organ, before = system.organ, state.before or state
    if isinstance(organ, Steady):
        loads = organ.steady_loads(state.organ, times)
        if loads is None:
            return None
        answer = organ_answer(system, scheme, state)
        at_rest = NONE, NONE, NONE, loads[2], 0.0
        sag, none = over_holds(loads[1], system.holds), (NONE, NONE, PLANE, PLANE, NONE, PLANE)
        still = Organ(True, loads[0], sag, *none, 0.0, 0.0, 0.0, 0.0)
        return Body(answer, still, at_rest, at_rest, lambda motion: answer.accept(motion[3], NO_FORCES))
    if isinstance(organ, Modal):
        modes = organ.modes(scheme, state.organ, times)
        if modes is None:
            return None
        mu, load, W, Y, y0, missed = (plain(x) for x in modes[:6])
        moving = Organ(False, 0.0, PLANE, mu, load, W, Y, y0, missed, *modes[6:])
        motions = organ.motion(state.organ, state.organ), organ.motion(before.organ, state.organ)
        return Body(
            organ_answer(system, scheme, state), moving, *motions, lambda motion: organ.moved(state.organ, motion)
        )
    return None


PLANS: Recent[tuple[Thread, Plan]] = Recent()


def plan_of(
    system: System[Any], scheme: Scheme, state: State[Any], answer: Answer[Any], motion: Motion, taut: Flags
) -> tuple[Thread, Plan]:
    """Return the thread and the plan of steps from a state with the organ's `answer` to the first step.

    The plan is a cached one if one of the last plans fits; from step to step it does. `motion` is
    the state as arrays, and `taut` (k + 1,) are its taut strands. The organ is not part of the
    cache, because it may be large. Its answer is written into the arrays of the plan.
    """
    loose = loose_ends(system, state).tobytes()
    of_ends = system.held_flags.tobytes(), loose, len(taut), system.clamps, system.clamp_frames.tobytes()
    values = scheme.dt, scheme.d, scheme.weights, system.epsilon, *of_ends, state.present.tobytes(), len(motion.U)
    thread = system.thread
    of_thread = thread.damping, thread.point_masses, thread.bending
    alike = (thread.spline.travel, thread.section) if isinstance(thread.spline, Placed) else (thread,)
    of, plan = PLANS.of(
        (*alike, system.piercings, system.gravity),
        lambda: make_plan(system, scheme, state, answer, motion, taut),
        (*values, *of_thread),
    )
    plan.given.y_free[:] = all_holds(system, answer.y_free)
    plan.given.C[:] = pad_compliance(system, answer.C)
    plan.scene.strands.taut[:] = taut
    return of, plan


def make_plan(
    system: System[Any], scheme: Scheme, state: State[Any], answer: Answer[Any], motion: Motion, taut: Flags
) -> tuple[Thread, Plan]:
    """Return a new plan with its thread; the arguments are those of `plan_of`."""
    problem = dynamic_problem(system, state, scheme.dt, answer, scheme)
    tables, bounds = tables_of(system.thread), bounds_of(problem)
    curve = own_curve(tables.curve) if system.thread.travels else tables.curve
    law = with_own(problem.law, "s_old", "s_held", "s_free", "stretch")
    given = with_own(given_of(problem), "q_ref", "load", "y_free", "C")
    one, other = (with_own(field, "at", "S", "c") for field in given.fields)
    given = given._replace(fields=(one, other))
    strands = with_own(strands_of(system, state, taut), "taut")
    room = empty_room(motion, system.thread.elastic_rule.w.shape[1])
    scene = scene_of(problem, state.present, strands, CREATED_BDF2 if isinstance(scheme, BDF2) else CREATED)
    solver = solver_for(curve, tables.knots, law, given, bounds, room.z, room.found)
    plan = Plan(curve, tables.knots, law, given, bounds, scene, pace_of(scheme), room, solver)
    return tables.thread, plan


def with_own(arrays: Arrays, *names: str) -> Arrays:
    """Return a tuple of arrays in which the arrays with these `names` are writable copies."""
    return arrays._replace(**{name: getattr(arrays, name).copy() for name in names})


class Course:
    """Steps of a scheme from a state, of which `made` have been made.

    It has the `energies`, `iterations` and largest axial `strains` of each step. `happened` is True
    if there is only one step and it has an event. `taut` (k + 1,) are the taut strands at the
    start. If `remembers`, a state keeps the one before it.
    """

    def __init__(
        self, system: System[Any], scheme: Scheme, state: State[Any], body: Body, taut: Flags, remembers: bool
    ) -> None:
        self._like, self._holes, self._body, self._remembers = state, len(system.piercings), body, remembers
        self._now, self._earlier = motion_of(state, body.now), motion_of(state.before or state, body.earlier)
        self._thread, self._plan = plan_of(system, scheme, state, body.answer, self._now, taut)

    def make_steps(self, energies: Sequence[float], times: Sequence[float], ends: tuple[Array, ...]) -> None:
        """Make steps to the `times` [s] as long as they are smooth.

        `ends` is the result of `coupling.run.march.tabled_ends`.
        """
        iterations, kept = np.zeros(len(times), np.int64), room_to_keep(self._now, len(times))
        motions = self._now, self._earlier
        with telling(march.march, is_kept(march.march, KEPT, march.__file__), "steps made at once"):
            self.made, why = march.march(
                self._plan, self._body.organ, Ends(*ends), *motions, np.array(energies), iterations, kept
            )
        self.happened, self._times = why == march.HAPPENED, times[: self.made]
        self.iterations, self._kept = iterations[: self.made], kept
        self.energies, self.strains = kept.energies[: self.made].tolist(), kept.strain[: self.made]
        self._ends = motion_on(kept.ends[: self.made], self._now[:-1])

    def states(self, first: int = 0) -> list[State[Any]]:
        """Return the states at the ends of the steps from step `first` on."""
        each = [self._state(step) for step in range(max(first - 1, 0), self.made)]
        each = each if first else [forgetful(self._like), *each]
        if not self._remembers:
            return each[1:]
        dt = self._plan.pace.dt
        return [replace(new, before=old, dt_before=dt) for old, new in pairwise(each)]

    def _state(self, step: int) -> State[Any]:
        motion = Motion(*[each[step] for each in self._ends])
        f_y, spline = motion.f_y[: self._holes].ravel(), self._thread.spline
        return State(
            time=self._times[step],
            q=motion.q,
            v=motion.v,
            N=motion.N,
            organ=self._body.state((motion.U, motion.V, motion.A, f_y, float(motion.drift[0]))),
            s=motion.s,
            s_dot=motion.s_dot,
            lam=motion.lam,
            y=motion.y,
            sigma=motion.sigma,
            present=self._like.present,
            sense=motion.sense,
            reaction=motion.reaction,
            stretch=motion.stretch,
            spline=spline.moved(motion.s) if isinstance(spline, Placed) else None,
            drive=motion.drive if isinstance(spline, Placed) else None,
        )

    def seen(self) -> Seen:
        """Return the data of the thread at the ends of all steps, for observations."""
        at, ends = self._kept.at, self._ends
        first = at.first[: self.made].ravel()
        b, D = (x[: self.made].reshape(-1, *x.shape[2:]) for x in (at.b, at.D))
        drive = ends.drive.ravel() if self._plan.given.ride.on else None
        elastic, by_hand = self._kept.elastic[: self.made], np.zeros_like(ends.sigma, dtype=bool)
        holds = ends.s, ends.sigma, ends.stretch, by_hand, ends.lam, ends.y
        return Seen(self._like.present, ends.q, elastic, *holds, Passage(first, b, D, drive))


def over_holds(x: Array, holds: int) -> Array:
    """Return numbers of the sites (9p,) over all holds, zero for holds off the organ, shape `(m, 9)`."""
    out = np.zeros((holds, NINE))
    out[: x.size // NINE] = x.reshape(-1, NINE)
    return out


def pace_of(scheme: Scheme) -> Pace:
    """Return the numbers of a scheme."""
    now, before = (*scheme.weights, 0.0)[:2]
    return Pace(float(scheme.dt), float(scheme.a), float(scheme.d), now, before, isinstance(scheme, BDF2))


def scene_of(problem: Problem[Any], present: Flags, strands: Strands, create: float) -> Scene:
    """Return the constant data of steps whose first problem is given.

    `present` (m,) are the present holds, and `strands` those of the thread. `create` is the share
    of the available energy that a step may create.
    """
    system, thread, factor = problem.system, problem.system.thread, problem.mass_factor
    strength = np.array([piercing.strength for piercing in system.piercings], dtype=float) * system.bearing_areas
    by_place = thread.largest_bending + factor * thread.largest_mass
    give = float((thread.spline.end - thread.spline.start) / thread.EA)
    return Scene(
        weight=plain(system.weight),
        along=with_own(along_of(system), "breaks", "axial", "greville", "share"),
        present=present,
        here=np.ascontiguousarray(problem.rows[:, 0]),
        strength=strength,
        damping=float(thread.damping),
        epsilon=float(system.epsilon),
        by_place=float(by_place),
        borne=float(borne_pressure(thread, factor) / thread.EA),
        shares=Shares(create, TRACE, SHARE, give),
        strands=strands,
        fit=fit_of(thread),
    )


def motion_of(state: State[Any], body: ModalMotion) -> Motion:
    """Return copies of the arrays of thread and holds of a state, with the motion of its organ."""
    names = state.q, state.v, state.N, state.s, state.s_dot, state.lam, state.y, state.sigma, state.sense
    U, V, A, f_y, drift = body
    stretch = np.ones_like(state.s) if state.stretch is None else state.stretch
    drive = np.zeros_like(state.s) if state.drive is None else state.drive
    all_of = *names, state.reaction, stretch, over_holds(f_y, len(state.s)), U, V, A, np.array([drift]), drive
    return motion_on(np.concatenate([x.ravel() for x in all_of], dtype=float), all_of)


def motion_on(numbers: Array, like: Sequence[Array]) -> Motion:
    """Return the `numbers` (…, size) of motions as arrays with the shapes (…, *shape) of the arrays `like`."""
    parts = np.split(numbers, np.cumsum([x.size for x in like[:-1]]), axis=-1)
    shapes = [(*numbers.shape[:-1], *x.shape) for x in like]
    return Motion._make([*(part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)), numbers])


def empty_room(motion: Motion, points: int) -> Scratch:
    """Return the arrays for steps of a motion; `points` is the number of bending points per span."""
    end, m = motion_on(np.zeros_like(motion.numbers), motion[:-1]), len(motion.s)
    z = Unknowns(end.q, end.N, end.s, end.lam, end.y, end.sigma)
    return Scratch(
        z=z,
        end=end,
        found=empty_found(z, points),
        was=empty_passing(m),
        at=np.zeros_like(end.q),
        T=np.zeros((m, 2)),
        going=Going(*np.zeros((3, len(end.U)))),
        turns=np.zeros(TURNS),
        body=np.zeros(BODY),
        after=np.zeros(ENERGIES),
        part=empty_ridden(len(end.q), m),
    )


def room_to_keep(motion: Motion, steps: int) -> Kept:
    """Return the arrays for the stored results of `steps` steps of a motion."""
    return Kept(
        ends=np.empty((steps, motion.numbers.size)),
        elastic=np.empty((steps, *motion.q.shape)),
        strain=np.empty(steps),
        at=empty_passing(steps, len(motion.s)),
        energies=np.empty((steps, ENERGIES + 1)),
    )
