"""What the multipliers do to thread and organ together."""

import numpy as np

from coupling.interfaces import Body
from coupling.kernels.constraints import site_force, thread_force
from coupling.system import State, System


def multiplier_imbalance(system: System[Body], state: State[Body]) -> tuple[float, float]:
    """Return the total force [N] and moment [N m] of the multipliers on thread and organ together: zero but for
    round-off.

    The moment is taken on the site variables, x×f_x + u×f_u + v×f_v (Φ is invariant under a common rotation).
    """
    at = system.passage_of(state)
    on_thread, on_sites = thread_force(at, state.lam, state.y), site_force(at, state.lam, state.y).reshape(-1, 3, 3)
    force = on_thread[:, 0].sum(axis=0) + on_sites[:, 0].sum(axis=0)
    moment = np.cross(at.P, on_thread[:, 0]) + np.cross(at.T, on_thread[:, 1])
    moment += np.cross(state.y.reshape(-1, 3, 3), on_sites).sum(axis=1)
    return float(np.abs(force).max(initial=0.0)), float(np.abs(moment.sum(axis=0)).max(initial=0.0))
