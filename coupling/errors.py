"""Named failures of the coupled solve."""

from dataclasses import dataclass, field

import numpy as np

from coupling.arrays import Flags


class CouplingError(RuntimeError):
    """The coupled system could not be set up or solved; the message says where."""


@dataclass
class StepError(CouplingError):
    """A step that did not converge, with what is needed to look into it.

    `time` [s] and `dt` [s] of the step; `piercing` names the worst constraint, if any; `cause` in words.
    """

    time: float
    dt: float
    cause: str
    piercing: str = ""

    def __str__(self) -> str:
        place = f", worst at piercing {self.piercing!r}" if self.piercing else ""
        return f"the step from t = {self.time:.6g} s with dt = {self.dt:.3g} s failed: {self.cause}{place}"


@dataclass
class UphillError(StepError):
    """A step that makes energy: it was solved, on another branch than the motion (`coupling.run.watch`)."""


@dataclass
class LentError(StepError):
    """A step of BDF2 that gives back so much of what the one before took that it is to forget it
    (`coupling.run.watch`)."""


@dataclass
class TurnedHoleError(StepError):
    """A step that was not solved where a linear organ has turned a hole so far that its frame hardly says a direction
    (`coupling.step.diagnosis`)."""


@dataclass
class RunAwayError(CouplingError):
    """A staggered run that is unstable: thread and organ answer each other with ever larger motions.

    `time` [s] and `dt` [s] of the step; at `piercing` the hole moved by `way` [m].
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
    """A linear step that made energy out of nothing, of which the next ones would live.

    `time` [s] and `dt` [s] of the step; `created` [J], `share` of the energy that there is; at `piercing`, if any,
    the thread is `off` [m] its hole, farther than at the others.
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
            f"{100 * self.share:.3g} % of the energy that there is{place}; take a smaller solve.dt, or solve.scheme = "
            '"newton"'
        )


OTHER_WAYS = "raise solve.load_steps, lay the path nearer to where the thread rests, or run it in time (solve.kind)"
HOLD_IT = f"hold an end, add friction or an anchor; else {OTHER_WAYS}"  # of a thread that may be drawn out of its holes


@dataclass
class EquilibriumError(StepError):
    """A load step without an equilibrium; `share` is the part of the final loads, `remedy` what may help."""

    share: float = 1.0
    remedy: str = OTHER_WAYS

    def __str__(self) -> str:
        place = f", worst at piercing {self.piercing!r}" if self.piercing else ""
        return (
            f"no equilibrium was found under {100 * self.share:.4g} % of the loads ({self.cause}{place}); {self.remedy}"
        )


@dataclass
class UnbalancedError(EquilibriumError):
    """Dead loads that have no equilibrium, however it is looked for."""

    remedy: str = "hold an end, add friction or an anchor, or let the loads differ by less"


@dataclass
class OutError(EquilibriumError):
    """A load step in which the thread runs out of its last hole: under more of the loads there is no equilibrium."""

    remedy: str = HOLD_IT


@dataclass
class RestError(CouplingError):
    """A run that was to start at rest, without a rest to start from; `cause` is what the equilibrium ended with."""

    cause: str

    def __str__(self) -> str:
        return (
            f'there is no rest to start from: {self.cause}; solve.start = "path" starts the clock where the thread is '
            "laid"
        )


@dataclass
class BranchError(CouplingError):
    """A branch of equilibria that was lost before it led to the loads asked for: `cause` says how far it was followed
    from `time` [s] on, and why not further."""

    time: float
    cause: str

    def __str__(self) -> str:
        return f"from t = {self.time:.6g} s on {self.cause}"


@dataclass
class LeavingError(StepError):
    """A load step on the way to whose equilibrium the thread runs out of holes, `gone` (holes,)."""

    gone: Flags = field(default_factory=lambda: np.zeros(0, dtype=bool))


@dataclass
class SpentError(CouplingError):
    """A load step that took all the corrections that it may, and found no equilibrium.

    `time` [s] where it began; `share` of the final loads; what the thread is `doing`, at `piercing`; what became of the
    branch `beyond` it, empty where none was followed; `remedy`, what may help.
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
    """Constraints that cannot be met together; `cause` names the piercings."""

    time: float
    cause: str

    def __str__(self) -> str:
        return f"at t = {self.time:.6g} s {self.cause}"


@dataclass
class TogetherError(ConstraintError):
    """Two holes that tissue lets come to lie in one place: nothing is left of the thread between them."""


@dataclass
class FormingError(CouplingError):
    """A piercing, or another `kind` of hold, that cannot begin: the thread is not where it is."""

    time: float
    piercing: str
    cause: str
    kind: str = "piercing"

    def __str__(self) -> str:
        return f"at t = {self.time:.6g} s {self.kind} {self.piercing!r} cannot begin: {self.cause}"
