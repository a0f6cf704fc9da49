"""The errors of the coupled solution."""

from dataclasses import dataclass, field

import numpy as np

from coupling.arrays import Flags


class CouplingError(RuntimeError):
    """The coupled system could not be set up or solved; the message gives the place."""


@dataclass
class StepError(CouplingError):
    """A step that did not converge.

    `time` [s] and `dt` [s] are those of the step. `piercing` is the name of the worst constraint,
    empty if there is none. `cause` is the reason in words.
    """

    time: float
    dt: float
    cause: str
    piercing: str = ""

    def __str__(self) -> str:
        place = f", worst at piercing {self.piercing!r}" if self.piercing else ""
        length = f" with dt = {self.dt:.3g} s" if self.dt else ""  # zero: equilibrium under unchanged loads
        return f"the step from t = {self.time:.6g} s{length} failed: {self.cause}{place}"


class FarError(CouplingError):
    """A load step too long for Newton's method: a correction of the tissue was shortened to less
    than a quarter, or prolonged, and the halves of the step are mostly cheaper.
    """


class UphillError(StepError):
    """A step that creates energy: its solution is on another branch than the motion (`coupling.run.watch`)."""


class LentError(StepError):
    """A step of BDF2 that returns too much energy of the last step and must be solved without
    memory (`coupling.run.watch`).
    """


class TurnedHoleError(StepError):
    """An unsolved step with a hole that a linear organ has turned too far.

    The frame of such a hole no longer defines a direction (`coupling.step.diagnosis`).
    """


@dataclass
class RunAwayError(CouplingError):
    """An unstable staggered run: the motions of thread and organ grow from step to step.

    `time` [s] and `dt` [s] are those of the step. At `piercing` the hole moved by `way` [m].
    """

    time: float
    dt: float
    piercing: str
    way: float

    def __str__(self) -> str:
        return (
            f"the staggered step from t = {self.time:.6g} s with dt = {self.dt:.3g} s ran away: the hole of piercing "
            f'{self.piercing!r} moved by {self.way:.3g} m; use solve.coupling = "monolithic", or another dt'
        )


@dataclass
class CreatedEnergyError(CouplingError):
    """A linear step that created energy, which would drive the next steps.

    `time` [s] and `dt` [s] are those of the step. `created` [J] is the created energy, and `share`
    its ratio to the available energy. At `piercing` the thread is `off` [m] from its hole, further
    than at the other holes; the name is empty without piercings.
    """

    time: float
    dt: float
    created: float
    share: float
    piercing: str
    off: float

    def __str__(self) -> str:
        place = (
            f", and the thread is {self.off:.3g} m off the hole of piercing {self.piercing!r}" if self.piercing else ""
        )
        return (
            f"the linear step from t = {self.time:.6g} s with dt = {self.dt:.3g} s created {self.created:.3g} J, "
            f"{100 * self.share:.3g} % of the available energy{place}; take a smaller solve.dt, or solve.scheme = "
            '"newton"'
        )


OTHER_WAYS = "raise solve.load_steps, lay the path closer to the equilibrium, or use a dynamic run (solve.kind)"
OF_TISSUE = "raise solve.load_steps, use a finer mesh or smaller loads, or use a dynamic run (solve.kind)"
OF_LOOSE_BODY = f"clamp the body that only thread and contact hold; or {OTHER_WAYS}"
HOLD_IT = f"hold an end, add friction or an anchor; or {OTHER_WAYS}"  # for a thread that can slide out of its holes


@dataclass
class EquilibriumError(StepError):
    """A load step without an equilibrium; `share` is the part of the final loads, and `remedy` may help."""

    share: float = 1.0
    remedy: str = OTHER_WAYS

    def __str__(self) -> str:
        place = f", worst at piercing {self.piercing!r}" if self.piercing else ""
        return (
            f"no equilibrium was found under {100 * self.share:.4g} % of the loads ({self.cause}{place}); {self.remedy}"
        )


@dataclass
class UnbalancedError(EquilibriumError):
    """Dead loads without an equilibrium."""

    remedy: str = "hold an end, add friction or an anchor, or let the loads differ by less"


@dataclass
class OutError(EquilibriumError):
    """A load step in which the thread runs out of its last hole, or a strand finds no place on the
    surface: no equilibrium continues from there.
    """

    remedy: str = HOLD_IT


@dataclass
class RestError(CouplingError):
    """A run that should start at rest, without an equilibrium to start from; `cause` is the error
    of the equilibrium.
    """

    cause: str

    def __str__(self) -> str:
        return (
            f'there is no rest to start from: {self.cause}; with solve.start = "path" the run starts from the laid '
            "thread"
        )


class BranchError(CouplingError):
    """A branch of equilibria that was lost before the wanted loads were reached; it says how far it
    was followed, and why not further.
    """


@dataclass
class LeavingError(StepError):
    """A load step in which the thread runs out of holes on the way to equilibrium; `gone` (holes,)
    are these holes.
    """

    gone: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))


@dataclass
class SpentError(CouplingError):
    """A load step that used all its corrections and found no equilibrium.

    It began at `time` [s] and has the `share` of the final loads. `doing` is the motion of the
    thread, at `piercing`. `beyond` is the failure of the branch beyond, empty if no branch was
    followed. `remedy` may help.
    """

    time: float
    share: float
    corrections: int
    doing: str
    piercing: str = ""
    beyond: str = ""
    remedy: str = OTHER_WAYS

    def __str__(self) -> str:
        place = (f" at piercing {self.piercing!r}" if self.piercing else "") + (self.beyond and f"; {self.beyond}")
        return (
            f"no equilibrium was found under {100 * self.share:.4g} % of the loads in {self.corrections} corrections, "
            f"from t = {self.time:.6g} s on, where {self.doing}{place}; {self.remedy}"
        )


@dataclass
class InversionError(CouplingError):
    """The thread's tangent flipped through a hole: an entry became an exit (§4.2)."""

    time: float
    piercing: str

    def __str__(self) -> str:
        return (
            f"at t = {self.time:.6g} s the thread flipped at piercing {self.piercing!r}: its tangent points out of the "
            "wrong side of the hole; pull less sideways, use a smaller dt, or more control points near the hole"
        )


@dataclass
class ConstraintError(CouplingError):
    """Constraints that cannot be satisfied together; `cause` names the piercings."""

    time: float
    cause: str

    def __str__(self) -> str:
        return f"at t = {self.time:.6g} s {self.cause}"


class TogetherError(ConstraintError):
    """Two holes that tissue moves to one place: the strand between them has no length left."""


@dataclass
class FormingError(CouplingError):
    """A piercing, or another `kind` of hold, that cannot begin, because the thread is not at its place."""

    time: float
    piercing: str
    cause: str
    kind: str = "piercing"

    def __str__(self) -> str:
        return f"at t = {self.time:.6g} s {self.kind} {self.piercing!r} cannot begin: {self.cause}"
