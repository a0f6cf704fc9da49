"""The content of a checkpoint, and the run that continues from it."""

from dataclasses import replace
from typing import Any

import numpy as np

import tissue
from coupling.run.run import Run
from coupling.system import Solved
from studies.output.checkpoint import ANEW, CHECKPOINT, Arrays, pack, unpack
from studies.scenario import ScenarioError, because
from thread.relaxation import Memory
from thread.spline import Spline

OrganRun = Run[tissue.OrganState]

NONE = np.zeros(0)
REMADE = ("state.organ.MU", "state.before.organ.MU")  # an organ computes these from its displacement, to the same bits


def memory_of(now: OrganRun) -> Arrays:
    """Return all data that the later steps depend on, as arrays by name."""
    own = {
        "step": np.array(now.number),
        "s_begun": now.s_begun,
        "taut": now.taut,
        "knots": now.system.thread.spline.knots,
    }
    own |= {"tie_works": now.tie_works} if now.system.ties else {}
    state = {name: value for name, value in pack(now.state, "state").items() if name not in REMADE}
    return own | state | pack(now.energies, "energies")


def recall(beginning: OrganRun, memory: Arrays) -> OrganRun:
    """Return the run of a checkpoint.

    `beginning` is the same run at its start. Raises `ScenarioError`.
    """
    try:
        number, first = int(memory["step"]), replace(beginning.state, solved=None)
        nested: dict[str, Any] = {"before": first, "memory": Memory(NONE, NONE, NONE, 0.0)}
        if first.spline is not None:
            nested["solved"] = Solved(first.spline, first.q, first.v)
        state = unpack(first, memory, "state", nested)
        system = beginning.system
        if state.spline is None:
            system = replace(system, thread=system.thread.with_spline(Spline(memory["knots"])))
        now = replace(
            beginning,
            system=system.at(state),
            state=state,
            energies=unpack(beginning.energies, memory, "energies"),
            s_begun=memory["s_begun"],
            taut=memory["taut"],
            tie_works=memory["tie_works"] if system.ties else beginning.tie_works,
            number=number,
            fresh=number == 0 and beginning.fresh,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ScenarioError(f"{CHECKPOINT} is of another version of this code ({error}); {ANEW}") from None
    whole = not isinstance(system.organ, tissue.KrylovOrgan)
    if whole and state.organ.U.size != beginning.state.organ.U.size:
        # with "auto" the choice of the Krylov space depends on the solver, and this on free memory
        sizes = {"size": state.organ.U.size, "here": beginning.state.organ.U.size}
        raise ScenarioError(f"{CHECKPOINT} has {because('checkpoint-krylov', **sizes)}, or {ANEW}")
    return now
