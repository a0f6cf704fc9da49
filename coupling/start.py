"""A consistent start: Φ = 0, the thread as near a given path as that allows, nothing strained but by its length.

The thread is laid as an equilibrium: nearly inextensible, on an elastic bed along the path, with some bending
stiffness that rounds what the bed would kink, the abscissae held. The bed has the form of the inertia term of a step,
so the same Newton serves.
"""

from dataclasses import dataclass, replace

import numpy as np

from coupling.border import NINE
from coupling.constraints import Array, passage
from coupling.newton import Iterate, Problem, solve
from coupling.sliding import law_of
from coupling.stepping import all_holds, sense, with_ends
from coupling.system import State, System
from thread.spline import Spline
from thread.thread import Thread, gauss_rule

BED_SPANS = 2.0  # the bed lets go of the path over this many spans beside a hole that imposes another direction
# Axial stiffness EA h²/EI of the laid thread, soft at first. Then the bed is moved under it, so that what strain the
# path's corners left is let go into its bends and not locked by the bed. What remains is the spline's own: in a bend
# of curvature κ the strain of a span h swings by about (κh)²/100 about zero.
ON_PATH = (1e2, 1e4)
SETTLING = (1e4,) * 10


@dataclass(frozen=True)
class Cord:
    """Section of the thread while it is laid: unit bending stiffness, nearly inextensible."""

    EA: float
    EI: float = 1.0
    rhoA: float = 1.0
    diameter: float = 1.0


def projected(thread: Thread, path: Array) -> Array:
    """Least-squares control points (n, 3) of values `path` (spans, g, 3) at the points of the thread's mass rule."""
    rule = gauss_rule(thread.spline, path.shape[1])
    load = thread.vector(np.einsum("eg,egi,ega->eia", rule.w, rule.b[:, :, 0], path))
    M = thread.mass_matrix.toarray()
    return np.asarray(np.linalg.solve(M, load))


def laid_thread(thread: Thread, stretch: float, axial: float) -> Thread:
    """The thread over the path's own arc length (`stretch` times its rest length), with the section of a cord whose
    EA is `axial` EI/h², h the mean span."""
    spline = Spline(thread.spline.knots * stretch)
    span = (spline.end - spline.start) / (thread.n - 3)
    cord = Cord(EA=axial / span**2, diameter=span)
    return replace(thread, spline=spline, section=cord, bending=True, point_masses=(0.0, 0.0))


def lay(system: System, y: Array, s: Array, path: Array, stretch: float) -> Array:
    """Control points (n, 3) of the laid thread; `path` (spans, g, 3) [m] at its mass rule, `stretch` its length over
    the thread's rest length. Raises `StepError`.

    The bed gives way over BED_SPANS mean spans h: (4 EI/k)^¼ = BED_SPANS h with k the bed's stiffness, EI = 1.
    """
    first = laid_thread(system.thread, stretch, ON_PATH[0])
    on_path = projected(first, path)
    m, abscissae = system.holds, s * stretch
    z = Iterate(
        with_ends(on_path, system, 0.0),
        np.zeros_like(first.elastic_rule.w),
        abscissae,
        np.zeros((m, 5)),
        y,
        np.zeros(m),
    )
    for k, axial in enumerate(ON_PATH + SETTLING):
        laid = replace(system, thread=laid_thread(system.thread, stretch, axial), epsilon=0.0)
        z = solve(bed_problem(laid, on_path if k < len(ON_PATH) else z.q, y, abscissae), z).iterate
    return z.q


def bed_problem(system: System, on_path: Array, y: Array, s: Array) -> Problem:
    """A thread on an elastic bed along `on_path` (n, 3), its abscissae held."""
    thread, m = system.thread, system.holds
    span = (thread.spline.end - thread.spline.start) / (thread.n - 3)
    bed = 4.0 / (BED_SPANS * span) ** 4
    return Problem(
        system=system,
        time=0.0,
        dt=0.0,
        inertia=bed * thread.mass_band,
        mass_factor=bed,
        q_ref=on_path,
        load=np.zeros_like(on_path),
        y_free=y,
        C=np.zeros((NINE * m, NINE * m)),
        rows=system.rows,
        law=law_of(system, s, np.zeros(m, dtype=bool), 0.0, s),
    )


def start(system: System, s: Array, path: Array, stretch: float) -> State:
    """The state at t = 0, at rest: `s` (p,) [m] abscissae of the piercings, `path` and `stretch` as for `lay`."""
    organ = system.organ.start()
    y = all_holds(system, system.organ.site_variables(organ))
    s = np.concatenate([s, system.clamp_abscissae])
    q = lay(system, y, s, path, stretch)
    m = system.holds
    return State(
        time=0.0,
        q=q,
        v=np.zeros_like(q),
        N=system.thread.EA * system.thread.points(q).strain,
        organ=organ,
        s=s,
        s_dot=np.zeros(m),
        lam=np.zeros((m, 5)),
        y=y,
        slip=np.where(system.may_slide & ~system.rough, 1.0, 0.0),
        present=np.ones(m, dtype=bool),
        sense=sense(passage(system.thread.spline, q, s), y),
        reaction=np.zeros((2, 3)),
    )
