"""The arrays of a thread for the compiled loops, made once, and the additional arrays of a step."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from coupling.arrays import Array, Indices
from coupling.kernels import iteration
from coupling.kernels.address import address_of
from coupling.kernels.border import NINE
from coupling.kernels.bordered import empty_border
from coupling.kernels.iteration import Bounds, Found, Given, Knots, Passing, Trail, Unknowns
from coupling.step import newton
from coupling.step.configuration import GAP_TOLERANCE
from coupling.step.newton import Iterate, Problem
from coupling.step.sliding import empty_ruled
from thread.energies.continuous import Continuous
from thread.kernels.curve import Curve, Stretched
from thread.kernels.loops import files_of
from thread.kernels.travel import Ridden
from thread.riding import plain
from thread.spline import ORDERS
from thread.thread import Thread
from tissue.recent import Recent

log = logging.getLogger(__name__)

REACH = ORDERS - 1
OVER = {"over": True}  # mark of a log record: the wait is over
COMPILING = 12  # s, for a step or for steps at once: 14 and 7 s elapsed on a quiet machine, 22 and 13 s on a busy one
KEPT = "iteration.solve_of."  # first part of the file names of the loops on disk


@dataclass(frozen=True, eq=False)
class Tables:
    """The plain arrays of a thread."""

    thread: Thread

    @cached_property
    def curve(self) -> Curve:
        """The elastic thread."""
        assert isinstance(self.thread.axial, Continuous)  # `coupling.step.solver.covers` excludes springs
        return self.thread.axial.curve

    @cached_property
    def knots(self) -> Knots:
        """The spline."""
        spline, mass = self.thread.spline, self.thread.mass_diagonals[REACH:].T
        return Knots(plain(spline.breaks), self.curve.first, plain(spline.polynomials), plain(mass))


@dataclass(frozen=True, eq=False)
class Ended:
    """The result of the loops.

    `how` they ended (`coupling.kernels.iteration`), the number of `corrections`, the last iterate `z`,
    and the residual `found` there.
    """

    how: int
    corrections: int
    z: Iterate
    found: Found


RECENT: Recent[Tables] = Recent()  # a host program that moves an end makes a new system in every step


def tables_of(thread: Thread) -> Tables:
    """Return the tables of a thread; cached for the last ones."""
    return RECENT.of((thread,), lambda: Tables(thread))


def given_of(problem: Problem) -> Given:
    """Return the constant data of a step."""
    system, (y_free, C) = problem.system, problem.organ_at_holds
    spans, piece = pieces_of(system.thread, problem.law.s_old)
    piece = piece + np.array([system.width, -system.width])
    return Given(
        plain(problem.q_ref),
        plain(problem.load),
        system.held_flags,
        plain(y_free),
        plain(C),
        problem.rows,
        np.ascontiguousarray(system.rows[:, 3]),
        spans,
        piece,
        float(problem.mass_factor),
        problem.stiffen,
        plain(problem.gaps),
        np.zeros((system.holds, NINE)),
        problem.ride,
        problem.fields_read,
    )


def pieces_of(thread: Thread, home: Array) -> tuple[Indices, Array]:
    """Return the first and last spans (m, 2) and the ends (m, 2) [m] of the pieces of a cut thread.

    The pieces contain the abscissae `home` (m,) [m].
    """
    spline = thread.spline
    piece = spline.piece_of(home)[:, None] + np.arange(2)
    ends = np.searchsorted(spline.breaks, spline.piece_ends)
    return ends[piece] - np.arange(2), spline.piece_ends[piece]


def bounds_of(problem: Problem) -> Bounds:
    """Return the tolerances and limits of an iteration."""
    thread, spline = problem.system.thread, problem.system.thread.spline
    return Bounds(
        np.array([newton.rounded_force(problem)]),
        float(thread.force_unit),
        GAP_TOLERANCE * thread.section.diameter,
        newton.LONGEST_MOVE * (spline.end - spline.start),
        newton.MAX_ITERATIONS,
        newton.MAX_SETS,
        *problem.floating,
    )


def empty_found(z: Iterate | Unknowns, points: int) -> Found:
    """Return arrays for a residual at an iterate; `points` is the number of bending points per span."""
    (n, _), (spans, axial), m = z.q.shape, z.N.shape, len(z.s)
    return Found(
        elastic=np.empty((n, 3)),
        balance=np.empty((n, 3)),
        push=np.empty((n, 3)),
        holds=np.empty((m, 6)),
        site=np.empty((m, NINE)),
        f_y=np.empty((m, NINE)),
        passing=empty_passing(m),
        stretched=Stretched(
            T=np.empty((spans, points, 3)),
            K=np.empty((spans, points, 3)),
            T_axial=np.empty((spans, axial, 3)),
            strain=np.empty((spans, axial)),
            T_edge=np.empty((spans, 2, 3)),
        ),
        trail=Trail(np.empty((newton.MAX_SETS, m)), np.zeros(4, np.int64)),
        ridden=empty_ridden(n, m),
        border=empty_border(m),
        ruled=empty_ruled(m),
    )


def empty_passing(*m: int) -> Passing:
    """Return zero arrays for the thread at holes in an array of shape `m`."""
    return Passing(np.zeros(m, np.int64), np.zeros((*m, ORDERS, ORDERS)), np.zeros((*m, ORDERS, 3)), np.zeros(m))


def empty_ridden(n: int, m: int) -> Ridden:
    """Return zero arrays for the dependence of the potential on the abscissae of `m` holds."""
    return Ridden(np.zeros(n), np.zeros(m), np.zeros((m, m)), np.zeros((n, 3, m)), np.zeros((n, 4)))


def own_curve(curve: Curve) -> Curve:
    """Return a copy of a curve with its own functions and weights, which change if knots travel."""
    names = "slope", "bend", "w", "axial_slope", "axial_w"
    return curve._replace(**{name: getattr(curve, name).copy() for name in names})


def folder_of_loops() -> Path | None:
    """Return the folder of the loops of a step, as `folder_of`."""
    return folder_of(iteration.solve)


def folder_of(loops: object) -> Path | None:
    """Return the folder of compiled loops; None if no folder can be written or Numba is disabled."""
    stats = getattr(loops, "stats", None)
    return Path(stats.cache_path) if stats is not None and stats.cache_path else None


def is_ready() -> bool:
    """Return whether the loops of a step were on disk at the first call, as `is_kept`."""
    return is_kept(iteration.solve, KEPT, iteration.__file__)


@cache
def is_kept(loops: object, name: str, module: str) -> bool:
    """Return whether loops on disk at the first call were newer than the kernels that their `module` can call.

    Their files begin with `name`. True if Numba is disabled.
    """
    folder = folder_of(loops)
    if folder is None:
        return not hasattr(loops, "stats")
    changed = max(path.stat().st_mtime for path in files_of(module))
    return any(path.stat().st_mtime > changed for path in folder.glob(f"{name}*.nbi"))


def run_loops(*given: object) -> None:
    """Run the loops on their arrays."""
    with telling(iteration.solve, is_ready(), "the step"):
        iteration.solve(*given)


def solver_for(*given: object) -> int:
    """Return the address of the loops for such arrays; zero if Numba is disabled."""
    with telling(iteration.solve, is_ready(), "the step"):
        return address_of(iteration.solve, given)


@contextmanager
def telling(loops: Any, ready: bool, what: str) -> Iterator[None]:
    """Log the compilation of loops and its time if they are neither `ready` nor in memory; `what` names them."""
    if ready or loops.signatures:
        yield
        return
    log.info("compiling %s (first run only, about %d s, on a busy machine twice that)", what, COMPILING)
    began = perf_counter()
    yield
    log.info("compiled %s in %.0f s", what, perf_counter() - began, extra=OVER)


def run(problem: Problem, start: Iterate) -> Ended:
    """Run the loops from an iterate."""
    tables = tables_of(problem.system.thread)
    given, law, bounds = given_of(problem), problem.law, bounds_of(problem)
    z = Iterate(*(np.array(x, dtype=float) for x in (start.q, start.N, start.s, start.lam, start.y, start.sigma)))
    found, unknowns = empty_found(z, tables.curve.w.shape[1]), Unknowns(z.q, z.N, z.s, z.lam, z.y, z.sigma)
    made = found.trail.made
    curve = tables.curve if not given.ride.on else own_curve(tables.curve)
    run_loops(curve, tables.knots, law, given, bounds, unknowns, found)
    return Ended(int(made[iteration.HOW]), int(made[iteration.TOTAL]), z, found)
