"""A branch of equilibria, followed by arc length if load steps fail.

Beyond a limit point there is no close equilibrium under more of the loads, but the branch continues
under smaller loads. The share κ of the loads is therefore an additional unknown. The additional
equation is a plane normal to the way so far, in which all corrections stay (Riks, Int. J. Solids
Struct. 15, 1979, §3):

    n·(dq, ds, dκ) = 0,   (dq, ds) = a + b dκ

a is Newton's correction under constant loads, and b its derivative by κ, both of the same condensed
system. Lengths are relative to the length of the thread. The plane is only a tool: a solved point
is an equilibrium under its own share of the loads.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from coupling.arrays import Array
from coupling.calls import asked_before_corrections
from coupling.errors import (
    BranchError,
    CouplingError,
    EquilibriumError,
    InversionError,
    OutError,
    SpentError,
    StepError,
    TogetherError,
)
from coupling.integrators import Equilibrium
from coupling.interfaces import Answer, Body, Floats, Snapping
from coupling.kernels.bordered import PHI, S, SingularError, Y
from coupling.rest.equilibrium import (
    MOST_CORRECTIONS,
    equilibrium_state,
    let_lie,
    load_steps,
    pair_lips,
    settle_stretch,
    snapped,
    static_problem,
)
from coupling.step.newton import Iterate, Problem, Residual, allowed_share, direction, evaluate, moved, solve
from coupling.step.stepping import Step, ask_organ, end_configuration, refuse_impossible, where_it_is, with_ends
from coupling.system import State, System

log = logging.getLogger(__name__)

AHEAD = 1e-6  # of the loads: difference for the derivative of a correction by the loads; half of the digits are left
FIRST = 0.1  # of the remaining way, estimated at the start: the first step
LONGEST = 0.02  # of the thread's length and of the loads together: longest step along a branch
SHORTEST = 2.0**-12  # of LONGEST: shortest step
LONGER, SHORTER = 1.5, 0.5  # ratio of the next step to a step with few corrections, and to a failed step
FEW = 8  # corrections
NEAR = 2.0  # step lengths: an equilibrium further away is on another branch
POINTS = 300  # equilibria along a branch, at most
ON_TIME = 1e-12  # of the loads: tolerance of the share reached


@dataclass(frozen=True)
class Way:
    """A way in the space of the unknowns.

    `q` (n, c) [m, with twist rad] of the control points, `z` (m, 15) of the holds in the order of
    `coupling.kernels.bordered`, and the `share` of the loads. `scale` [m] is the length of the
    thread.
    """

    q: Array
    z: Array
    share: float
    scale: float

    def along(self, other: "Way") -> float:
        """Return the scalar product of two ways, over places, abscissae and share."""
        places = np.sum(self.q[:, :3] * other.q[:, :3]) / len(self.q) + self.z[:, S] @ other.z[:, S]
        return float(places / self.scale**2 + self.share * other.share)

    @property
    def length(self) -> float:
        """Length of the way [-]."""
        return float(np.sqrt(self.along(self)))

    def times(self, factor: float) -> "Way":
        """Return the way times a factor."""
        return replace(self, q=factor * self.q, z=factor * self.z, share=factor * self.share)

    def plus(self, other: "Way") -> "Way":
        """Return the sum of both ways."""
        return replace(self, q=self.q + other.q, z=self.z + other.z, share=self.share + other.share)


@dataclass(frozen=True)
class Branch(Generic[Body]):
    """A branch of equilibria at one of its equilibria, `state`.

    The load step takes the `duration` [s], and `began` is the state at its start.
    """

    system: System[Body]
    state: State[Body]
    duration: float
    began: State[Body]

    @property
    def share(self) -> float:
        """Share of the loads [-]."""
        return self.state.time / self.duration

    def problem(self, share: float, answer: Answer[Body]) -> Problem[Body]:
        """Return the problem of equilibrium under a share of the loads, from the last equilibrium."""
        problem = static_problem(self.system, self.state, share, self.duration, answer, self.state, self.began)
        return replace(problem, start=self.state if self.system.bears else None)

    def under(self, problem: Problem[Body], z: Iterate, share: float) -> tuple[Problem[Body], Iterate]:
        """Return a problem under another share of the loads, and its iterate with the ends at their
        prescribed places.
        """
        if problem.answer.linear:
            answer = ask_organ(self.system, Equilibrium(), [self.state], self.duration, share)
        else:
            answer = self.led(problem.answer, share)
        sets = {name: getattr(problem, name) for name in ("closed", "rubbing", "along")}
        there = replace(self.problem(share, answer), **sets)
        return there, replace(z, q=with_ends(z.q, self.system, there.time))

    def led(self, answer: Answer[Body], share: float) -> Answer[Body]:
        """Return an answer at the same place under another share of the loads; that of a linear organ is unchanged."""
        organ = self.system.organ
        return organ.under(answer, self.duration, share) if isinstance(organ, Snapping) else answer

    def ways(self, problem: Problem[Body], z: Iterate, r: Residual) -> tuple[Way, Way]:
        """Return Newton's correction under constant loads, and its derivative by the share of the loads.

        Raises `SingularError`.
        """
        scale = self.system.thread.spline.end - self.system.thread.spline.start
        here, share = direction(problem, z, r), problem.time / self.duration
        there, shifted = self.under(problem, z, share + AHEAD)
        beyond = direction(there, shifted, evaluate(there, shifted))
        b_q, b_z = (shifted.q - z.q + beyond[0] - here[0]) / AHEAD, (beyond[1] - here[1]) / AHEAD
        return Way(*here, 0.0, scale), Way(b_q, b_z, 1.0, scale)

    def start(self) -> tuple[Problem[Body], Iterate]:
        """Return the problem of the last equilibrium, and its solution."""
        answer = ask_organ(self.system, Equilibrium(), [self.state], self.duration, self.share)
        problem = self.problem(self.share, self.led(answer, self.share))
        return problem, where_it_is(problem, self.state)

    def outset(self) -> Way:
        """Return the unit way towards more of the loads, estimated at the last equilibrium. Raises
        `SingularError`.
        """
        problem, z = self.start()
        way = self.ways(problem, z, evaluate(problem, z))[1]
        return way.times(1.0 / way.length)

    def onward(self, way: Way, length: float) -> Step[Body]:
        """Continue along the branch by about a `length` of a unit `way`. Raises `StepError`, `InversionError`."""

        def correct(problem: Problem[Body], z: Iterate, r: Residual) -> tuple[Problem[Body], Iterate]:
            a, b = self.ways(problem, z, r)
            step = a.plus(b.times(-way.along(a) / way.along(b)))
            part = allowed_share(problem, step.q)
            went = moved(problem, z, r, part * step.q, part * step.z)
            return self.under(problem, went, problem.time / self.duration + part * step.share)

        problem, z = self.start()
        ahead = way.times(length)
        first = moved(problem, z, evaluate(problem, z), ahead.q, ahead.z)
        problem, first = self.under(problem, first, self.share + ahead.share)
        return self.concluded(replace(problem, along=correct), first)

    def arrived(self, step: Step[Body], share: float) -> Step[Body]:
        """Return the step to the equilibrium under a `share` of the loads that a `step` along the
        branch has passed.

        Raises `StepError`, `InversionError`.
        """
        return self.concluded(*self.under(step.solution.problem, step.solution.iterate, share))

    def concluded(self, problem: Problem[Body], first: Iterate) -> Step[Body]:
        """Solve a problem from the iterate `first`, and return the resulting step. Raises
        `StepError`, `InversionError`.
        """
        solution = let_lie(settle_stretch(solve(problem, first), solve))
        solution = replace(solution, problem=replace(solution.problem, along=None))
        new = equilibrium_state(self.state, solution)
        end = end_configuration(new, solution)
        return Step(self.state, new, solution.problem.dt, solution, end, along=True)

    def way_of(self, step: Step[Body]) -> Way:
        """Return the way of a step."""
        old, new, scale = step.old, step.new, self.system.thread.spline.end - self.system.thread.spline.start
        z = np.zeros((len(new.s), Y.stop))
        z[:, S], z[:, PHI], z[:, Y] = new.s - old.s, new.lam - old.lam, new.y - old.y
        return Way(new.q - old.q, z, (new.time - old.time) / self.duration, scale)


def reach(system: System[Body], state: State[Body], share: float, duration: float) -> list[Step[Body]]:
    """Reach the part `share` of the loads by load steps, and along the branch if these fail.

    Raises the errors of `coupling.rest.equilibrium.load_steps`.
    """
    taken: list[Step[Body]] = []
    try:
        for step in load_steps(system, state, share, duration):
            taken.append(step)
    except OutError:  # no branch continues from there
        raise
    except (StepError, InversionError, SpentError) as error:
        last = taken[-1].new if taken else state
        if isinstance(system.organ, Floats) or share * duration <= last.time:
            raise
        log.info("load steps fail at %.4g of the loads; the branch is followed by arc length", last.time / duration)
        try:
            taken += follow(Branch(system, last, duration, state), share)
        except CouplingError as lost:
            log.info("%s", lost)
            raise with_branch(error, lost) from error
    return taken


def with_branch(error: CouplingError, lost: CouplingError) -> CouplingError:
    """Return the error of a load step, with the failure of the branch beyond it added."""
    if not isinstance(lost, BranchError):
        return error
    if isinstance(error, SpentError):
        return replace(error, beyond=str(lost))
    return replace(error, cause=f"{error.cause}; {lost}") if isinstance(error, EquilibriumError) else error


def follow(branch: Branch[Body], share: float) -> list[Step[Body]]:
    """Follow a branch to the `share` of the loads.

    Raises `BranchError`, and `ConstraintError` if a hand draws the thread out.
    """
    taken: list[Step[Body]] = []
    left = iter(range(MOST_CORRECTIONS))

    def count() -> None:
        if next(left, None) is None:
            raise lost(branch, taken, f"takes more than {MOST_CORRECTIONS} corrections")

    with asked_before_corrections(count):
        try:
            for step in walk(branch, share):
                taken.append(step)
            taken[-1] = inside(branch.system, snapped(taken[-1], share, branch.duration, taken[-1].old))
            return [*taken[:-1], pair_lips(branch.system, taken[-1], share, branch.duration)]
        except (StepError, SingularError) as error:
            raise lost(branch, taken, getattr(error, "cause", str(error))) from error


def walk(branch: Branch[Body], share: float) -> Iterator[Step[Body]]:
    """Yield the steps along a branch to the `share` of the loads. Raises `StepError`, `SingularError`."""
    way = branch.outset()
    length = min(LONGEST, FIRST * (share - branch.share) / way.share)
    for _ in range(POINTS):
        step, length = further(branch, way, length, share)
        yield step
        if abs(step.new.time - share * branch.duration) <= ON_TIME * branch.duration:
            return
        branch, way = replace(branch, state=step.new), branch.way_of(step)
        way = way.times(1.0 / way.length)
        if branch.share <= 0.0:
            raise StepError(step.old.time, step.dt, "leads back to no loads at all")
    raise StepError(step.old.time, step.dt, "does not reach the wanted loads")


def further(branch: Branch[Body], way: Way, length: float, share: float) -> tuple[Step[Body], float]:
    """Return the next step along a branch, and the allowed length of the step after it.

    If the step passes the `share` of the loads, it ends there. Raises `StepError`,
    `ConstraintError`.
    """
    while length >= SHORTEST * LONGEST:
        try:
            step = near(branch, branch.onward(way, length), length)
            if branch.share < share <= step.new.time / branch.duration:
                step = near(branch, branch.arrived(step, share), length)
            few = step.solution.iterations <= FEW
            return step, min(LONGEST, LONGER * length) if few else length
        except (StepError, InversionError, TogetherError) as error:
            log.debug("a step of %.3g along the branch fails: %s", length, error)
            length *= SHORTER
    raise StepError(branch.state.time, 0.0, "has no equilibrium close to the last one")


def near(branch: Branch[Body], step: Step[Body], length: float) -> Step[Body]:
    """Return a step along a branch, if it is acceptable.

    Raises `StepError` if it is much longer than `length` or the thread left a hole, and
    `ConstraintError` if a hand drew the thread out.
    """
    if branch.way_of(step).length > NEAR * length:
        raise StepError(step.old.time, step.dt, "the equilibrium is on another branch")
    return inside(branch.system, step)


def inside(system: System[Body], step: Step[Body]) -> Step[Body]:
    """Return a step, if the thread is in all its holes. Raises as `near`."""
    if refuse_impossible(system, step).any():
        raise StepError(step.old.time, step.dt, "the thread runs out of a hole")
    return step


def lost(first: Branch[Body], taken: Sequence[Step[Body]], why: str) -> BranchError:
    """Return the error of a branch that was lost after the steps `taken`."""
    furthest = max([first.share, *(step.new.time / first.duration for step in taken)])
    return BranchError(
        f"the branch beyond was followed by arc length through {len(taken)} equilibria, to {100 * furthest:.4g} % of "
        f"the loads at most, and {why}"
    )
