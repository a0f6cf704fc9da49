"""The motion of the thread, in words."""

import numpy as np

from coupling.arrays import Array
from coupling.interfaces import Body, Snapping
from coupling.system import State, System

SLACK = 1e-6  # of EA: a thread under less tension is slack
TURNED_BACK = 0.3  # cosine of the angle between thread and directed hole (73°): below, the thread is turned back


def what_it_does(system: System[Body], state: State[Body]) -> tuple[str, str]:
    """Return the most important motion of the thread in a state, in words, and its piercing."""
    names, p = [piercing.name for piercing in system.piercings], len(system.piercings)
    if not p:
        return "the tissue deforms without the thread" if is_tissue_alone(system) else "the thread moves freely", ""
    fastest = int(np.argmax((np.abs(state.s_dot) * (state.present & system.may_slide))[:p]))
    if np.abs(state.s_dot[fastest]) > 1.0:
        return f"the thread snaps through it at {abs(state.s_dot[fastest]):.3g} m/s", names[fastest]
    turned = alignment(system, state)[:p]
    steepest = int(np.argmin(turned))
    if turned[steepest] < TURNED_BACK:
        angle = np.degrees(np.arccos(np.clip(turned[steepest], -1.0, 1.0)))
        return f"the couple of its direction turns the thread back ({angle:.0f}° off)", names[steepest]
    if float(np.median(state.N)) < SLACK * system.thread.EA:
        return "the thread is slack", names[fastest]
    loaded = int(np.argmax(np.linalg.norm(state.lam[:p, :3], axis=1)))
    return "the thread slides and bends", names[loaded]


def is_tissue_alone(system: System[Body]) -> bool:
    """Return whether a system has tissue at finite strain on which the thread has no force."""
    return isinstance(system.organ, Snapping) and not (system.piercings or system.bears)


def alignment(system: System[Body], state: State[Body]) -> Array:
    """Return the cosine between thread and hole in the sense in which the thread passes it, shape `(holds,)`.

    It is 1 for holds without a direction.
    """
    T = system.passage_of(state).T
    normal = np.cross(state.y[:, 3:6], state.y[:, 6:])
    size = np.linalg.norm(T, axis=1) * np.linalg.norm(normal, axis=1)
    cosine = state.sense * np.sum(T * normal, axis=1) / np.maximum(size, np.finfo(float).tiny)
    return np.where(system.rows[:, 3] & state.present, cosine, 1.0)
