"""A cut of the thread during a run: the spline gets a knot of multiplicity four, and no function crosses it.

Curve, angle of the section and velocity are the same functions on the new knots
(`thread.cutting.cut`), so that momentum and energy do not change. The tension at the cut drives the
new ends apart in the next steps, which have no memory of the earlier ones. At rest the pieces find
another equilibrium at once (`coupling.run.run.Run.load`). Springs are distributed anew on both
pieces; the change of their energy is the loss in the event.

If knots travel, the pieces get their own knots: the strand that is cut becomes two. Nothing is
transferred, because the inertia of the next steps is computed from the old curve at the material
points of the pieces. Their first shape is put on the new knots; the change of energies is the loss
in the event.
"""

from dataclasses import dataclass, replace

import numpy as np

from coupling.arrays import Array
from coupling.errors import CouplingError
from coupling.interfaces import Body
from coupling.reports.audit import stored
from coupling.run.events import Event
from coupling.step.packets import bent_over, due, put_on_knots
from coupling.system import State, System, forgetful
from thread.cutting import cut
from thread.errors import ThreadError


@dataclass(frozen=True)
class Cut:
    """A cut at the abscissa `s` [m], at the first end of a step that is not before `time` [s]."""

    s: float
    time: float


def cut_thread(system: System[Body], state: State[Body], s: float) -> tuple[System[Body], State[Body], Event]:
    """Cut the thread at `s` [m], or at a close knot; return system and state with the event.

    Raises `CouplingError` if the thread cannot be cut there.
    """
    thread, state = system.thread, forgetful(state)
    if thread.travels:
        return cut_strand(system.at(state), state, s)
    try:
        spline, place, fields = cut(thread.spline, s, [state.q, state.v])
    except ThreadError as error:
        raise CouplingError(str(error)) from None
    other, known = replace(system, thread=thread.with_spline(spline)), thread.axial
    (q, v), axial = fields, other.thread.axial
    N = thread.spline.interpolate(axial.s, axial.home, known.s, known.home, state.N)
    frame = None if state.frame is None else other.thread.interpolate_frame(state.frame, thread, q)
    moved = replace(state, q=q, v=v, N=N, frame=frame)
    x, y, z = (momentum(other, moved) - momentum(system, state)).tolist()
    loss = stored(system, state) - stored(other, moved)
    event = Event(state.time, "cut", s=place, loss=loss, impulse=(x, y, z), control_points=spline.n)
    return other, moved, event


def momentum(system: System[Body], state: State[Body]) -> Array:
    """Return the linear momentum of the thread, shape `(3,)` [N s]."""
    return np.asarray(system.thread.momentum(state.v)[:, :3].sum(axis=0))


def cut_strand(system: System[Body], state: State[Body], s: float) -> tuple[System[Body], State[Body], Event]:
    """Cut a thread whose knots travel at `s` [m], as in `cut_thread`."""
    spline, near = system.thread.spline, system.thread.section.diameter
    if not spline.start < s < spline.end or np.abs(spline.piece_ends - s).min() < near:
        cause = f"an end or a cut of the thread is closer than its diameter, {near:.3g} m; cut it elsewhere"
        raise CouplingError(f"cut at {s:.6g} m: {cause}")
    try:
        travel = due(system, state, bent_over(system, state), [s])
    except ThreadError as error:
        raise CouplingError(f"cut at {s:.6g} m: {error}") from None
    other, moved = put_on_knots(system, state, travel)
    loss = stored(system, state) - stored(other, moved)
    return other, moved, Event(state.time, "cut", s=s, loss=loss, control_points=other.thread.n)
