"""An organ with inertia, solved in the Krylov space of its loads to the accuracy of a solution for
all unknowns.

    V = [K⁻¹F, (K⁻¹M) K⁻¹F, …, (K⁻¹M)ᵏ K⁻¹F],   F = [Yᵀ, weight, loads],   U = V η

as in `tissue.organs.basis`. If a body starts at rest and only F acts on it, it moves almost in this
space. The remainder decreases with every block, so that after a few blocks it is below the residual
of a solver. The remainder is known at every step. It is measured by the residual of the equations
of motion for all unknowns,

    r = F f − M (Ü + α U̇) − K (U + β U̇),   ‖r‖ in K⁻¹ = ‖R (η̈ + α η̇)‖,

with one small matrix R, because F, K V, and M V without its last block are in the space of K V. A
step is accepted if

    ‖r‖  ≤  ε ‖forces‖,   ‖forces‖ = ‖M (Ü + α U̇)‖ + ‖K (U + β U̇)‖ in K⁻¹, the largest so far.

Otherwise the step is solved again in a wider space, if a prediction says that a few more blocks are
enough. If not, this step and all later ones are solved for the whole organ. The sites are more
accurate than the field: their error is the product of two residuals, of the motion and of the
answer to a force at a site. The reason is that r has no part along V, and V nearly contains this
answer.

An impulse on the sites between two steps is solved for the whole organ. It moves only the nodes at
the sites, and this motion is far from the space.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tissue.arrays import Array
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.loads import Loads
from tissue.organs.basis import Level, Space
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.meshed import (
    NO_LIPS,
    SHARE,
    LinearAnswer,
    Lips,
    OrganEnergies,
    OrganState,
    SiteAnswer,
    TimeScheme,
)
from tissue.organs.modal import ModalArrays
from tissue.sites.site import Sites
from tissue.solvers.choice import GIGA, SolverChoice
from tissue.solvers.memory import free_memory
from tissue.supports import holds_still

log = logging.getLogger(__name__)

# ε. It is the relative error of fields. Sites are accurate to 1e-12 if the error of their answers in the space is
# below a thousandth. In the norm of `tissue.solvers.factor.RESIDUAL`, with its large weight of variations from node
# to node, ε is below 1e-10.
ACCURACY = 1e-9
START = 1  # blocks at the start: their residuals predict how many blocks are needed, if any number is enough
FIRST = 4  # blocks that any step can use: seven reach ε for forces that are not faster than the body's vibrations
MOST = 16  # blocks: a motion that needs more is not smooth; with two holes, 16 blocks cost as much as 350 steps
SHORT = 1e-8  # of a compliance: largest deficit accepted after a failed step; Newton does not notice a smaller one
AT_ONCE = 4  # further blocks that one step can add: a smooth start needs one or two, and more later
ROUNDED = 1e-13  # of the body's size: a smaller error of a site is round-off of the constraints
ALSO_MADE = 2  # blocks beyond the further ones: the static answers, and the block for the residual
TIMES_HELD = 4  # vectors, K times the vectors, and products and copies of a block during its construction


@dataclass(frozen=True)
class KrylovAnswer(SiteAnswer[OrganState]):
    """An answer in the Krylov space.

    `checked` returns an answer with the accuracy of the module under the forces f_y (9p,). For f_y
    = None the answer has this accuracy under all forces. If the given answer is accurate enough, it
    is returned unchanged.
    """

    checked: "Callable[[KrylovAnswer, Array | None], SiteAnswer[OrganState] | LinearAnswer]"

    def certified(self, f_y: Array) -> "SiteAnswer[OrganState] | LinearAnswer":
        """Return the answer that is accurate under the forces `f_y` (9p,)."""
        return self.checked(self, f_y)

    def faithful(self) -> "SiteAnswer[OrganState] | LinearAnswer":
        """Return the answer that has the compliance of the whole organ."""
        return self.checked(self, None)


@dataclass(frozen=True, eq=False)
class KrylovOrgan:
    """A linear organ with inertia, solved in its Krylov space.

    `full` has the mesh, the sites and the loads. If the space is not accurate enough, `full` solves
    instead. U, V, A of its states are η, η̇, η̈ [√J, …], as many as the vectors, or the fields of
    the whole organ.

    Raises `TissueError` for an organ with contact, for an organ that is not held, and if the memory
    is too small.
    """

    full: DynamicOrgan

    def __post_init__(self) -> None:
        organ, otherwise = self.full, 'or set solve.organ = "whole"'
        if organ.pairs:
            raise TissueError(
                f"the organ has {organ.pairs} pairs of nodes that can touch, and its Krylov space has no contact; "
                f"leave out contact, {otherwise}"
            )
        if not has_space(organ):
            raise TissueError(
                f"the organ is not held, and its Krylov space begins with static answers; clamp a boundary, {otherwise}"
            )
        vectors = (MOST + ALSO_MADE) * (organ.Y.shape[0] + 1 + organ.surface_load.shape[1])
        need, room = 8.0 * TIMES_HELD * vectors * organ.size, SHARE * free_memory()
        if need > room:
            raise TissueError(
                f"the Krylov space of the organ, {vectors} vectors of {organ.size} unknowns, takes about "
                f"{need / GIGA:.2g} GB and {room / GIGA:.2g} GB are available; take fewer holes or a coarser mesh, "
                f"{otherwise}"
            )

    @cached_property
    def space(self) -> Space:
        """The space with all blocks that were needed so far."""
        return Space(self.full, FIRST)

    def level(self, state: OrganState) -> Level | None:
        """Return the level of a state, or None for a state of the whole organ."""
        return None if state.U.size == self.full.size else self.space.level_of(state.U.size, MOST)

    def start(self) -> OrganState:
        """Return the undeformed state at rest; gravity and loads act from the first step."""
        rest = np.zeros(self.space.level(START).modes.size)
        return OrganState(rest, rest, rest, np.zeros(self.y0.size), shares=self.full.no_shares)

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> SiteAnswer[OrganState] | LinearAnswer:
        """Return the answer of a step of `scheme` from the states `past`, newest first.

        The part `share` of the loads acts at `time` [s].
        """
        level = self.level(max(past, key=lambda state: state.U.size))
        if level is None:
            return self._whole_answer(scheme, past, time, share)
        return self._answer(level, scheme, past, time, share)

    def _answer(
        self, level: Level, scheme: TimeScheme, past: Sequence[OrganState], time: float, share: float
    ) -> KrylovAnswer:
        """Return the answer at a level."""
        shares, past = self.full.shares_at(time, share), [self._at(level, state) for state in past]

        def accept(U: Array, V: Array, A: Array, f_y: Array) -> OrganState:
            """Return the state of a motion."""
            new = OrganState(U, V, A, f_y, shares=shares)
            return replace(new, tally=max(past[0].tally, level.forces(new)))

        def checked(answer: KrylovAnswer, f_y: Array | None) -> SiteAnswer[OrganState] | LinearAnswer:
            """Return the answer at a level that is wide enough, or the answer of the whole organ."""

            def excess(level: Level, answer: KrylovAnswer) -> float:
                """Return the residual of an answer divided by its bound."""
                return level.shortfall(scheme) / SHORT if f_y is None else self._excess(level, answer.accept(f_y))

            found = self._widened(level, answer, lambda wider: self._answer(wider, scheme, past, time, share), excess)
            return found or self._whole_answer(scheme, past, time, share)

        found = level.modes.answer(self.y0, scheme, past, shares, accept)
        return KrylovAnswer(found.y_free, found.compliance, found.accepted, checked)

    def _widened(
        self,
        level: Level,
        answer: KrylovAnswer,
        answer_of: Callable[[Level], KrylovAnswer],
        excess: Callable[[Level, KrylovAnswer], float],
    ) -> KrylovAnswer | None:
        """Return the narrowest Krylov answer whose residual bound is met, or None.

        The search adds at most AT_ONCE blocks to the present level, or to FIRST blocks if these are
        more.
        """
        before, most = np.inf, min(MOST, max(level.blocks, FIRST) + AT_ONCE)
        while (left := excess(level, answer)) > 1.0:
            falls = min(left / before, 1.0) if before < np.inf else 0.0
            if level.blocks == most or left * falls ** (most - level.blocks) > 1.0:
                log.info("organ: residual of %d vectors %.1g times its bound: solved whole", level.modes.size, left)
                return None
            before, level = left, self.space.level(level.blocks + 1)
            if level.modes.size == self.full.size:  # the size of the whole organ marks a state as whole
                return None
            answer = answer_of(level)
        return answer

    def _excess(self, level: Level, state: OrganState) -> float:
        """Return the residual of the equations of motion divided by its bound [-]."""
        allowed = ACCURACY * state.tally + self._rounded
        return level.left(state) / max(allowed, np.finfo(float).tiny)

    @cached_property
    def _rounded(self) -> float:
        """A residual that moves no site by more than round-off of its position [√J]."""
        modes = self.space.level(START).modes
        ways = modes.Y.reshape(-1, 9, modes.size)[:, :3]
        reach = np.linalg.norm(ways, 2, axis=(1, 2)).max(initial=0.0) if ways.size else 0.0
        points = self.full.elasticity.points
        return float(ROUNDED * np.ptp(points, axis=0).max() / reach) if reach else 0.0

    def _whole_answer(self, scheme: TimeScheme, past: Sequence[OrganState], time: float, share: float) -> LinearAnswer:
        """Return the answer of the whole organ."""
        found, work = self.full.answer(scheme, [self.whole(s) for s in past], time, share), past[0].tally
        return replace(found, accepted=lambda f_y, p: replace(found.accepted(f_y, p), tally=work))

    def _at(self, level: Level, state: OrganState) -> OrganState:
        """Return a state at its own level or a higher one.

        Its parts in the additional blocks are zero.
        """
        own = self.level(state)
        if own is level or own is None:
            return state
        U, V, A = (level.turn[: own.modes.size].T @ (own.turn @ x) for x in (state.U, state.V, state.A))
        return replace(state, U=U, V=V, A=A)

    def whole(self, state: OrganState) -> OrganState:
        """Return the state as a state of the full organ, with fields over the free unknowns."""
        if self.level(state) is None:
            return state
        U, V, A = (self.spread(state, x) for x in (state.U, state.V, state.A))
        return replace(state, U=U, V=V, A=A)

    def spread(self, state: OrganState, x: Array) -> Array:
        """Return the field over the free unknowns (N,) of U, V or A of a state."""
        level = self.level(state)
        return x if level is None else np.asarray(self.space.vectors[:, : level.modes.size] @ (level.turn @ x))

    def site_variables(self, state: OrganState) -> Array:
        """Return y, shape `(9p,)`."""
        level = self.level(state)
        return self.full.site_variables(state) if level is None else level.modes.site_variables(self.y0, state.U)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works of the step."""
        level = self.level(max(old, new, key=lambda state: state.U.size))
        if level is None:
            return self.full.energies(self.whole(old), self.whole(new))
        return level.modes.energies(self._at(level, old), self._at(level, new))

    def modes(self, scheme: TimeScheme, state: OrganState, times: Sequence[float]) -> ModalArrays | None:
        """Return the arrays with which a kernel makes steps, or None.

        The result is None if the loads change at the `times` [s], and for a state of the whole
        organ.
        """
        level = self.level(state)
        if level is None or not self.surface.are_steady(state.shares, times):
            return None
        modes, load = level.modes, level.modes.load_under(state.shares)
        W, within = modes.operator(scheme.a, scheme.d).W, (ACCURACY, self._rounded)
        return (modes.mu, load, W, modes.Y, self.y0, level.missed, *modes.rayleigh, *within)

    def motion(self, state: OrganState, like: OrganState) -> tuple[Array, Array, Array, Array, float]:
        """Return η, η̇, η̈ (n,) of a state, the site forces (9p,) and the largest norm of the
        forces so far [√J].

        η, η̇ and η̈ are those at the level of the state `like`.
        """
        level = self.level(like)
        at = state if level is None else self._at(level, state)
        return at.U, at.V, at.A, at.f_y, at.tally

    def moved(self, state: OrganState, motion: tuple[Array, Array, Array, Array, float]) -> OrganState:
        """Return the state of a `motion` under the loads of another state."""
        U, V, A, f_y, tally = motion
        return OrganState(U, V, A, f_y, shares=state.shares, tally=tally)

    def impulse(self, state: OrganState) -> SiteAnswer[OrganState]:
        """Return the answer of the whole organ to an impulse on the sites."""
        return self.full.impulse(self.whole(state))

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of the whole organ in a step in which the sites stay at `y`."""
        return self.full.displace(scheme, self.whole(state), y, f_y)

    # -- the field, and what the whole organ has -----------------------------------------------------------------------

    def field(self, state: OrganState) -> Array:
        """Return the displacement over the free unknowns, shape `(N,)` [m]."""
        return self.spread(state, state.U)

    def displacement(self, state: OrganState) -> Array:
        """Return the displacement of all unknowns of the mesh, shape `(N_all,)` [m]."""
        return self.full.whole(self.field(state))

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)` [m, -, -]."""
        return self.full.y0

    @property
    def directed(self) -> tuple[bool, ...]:
        """Whether each site was given a direction."""
        return self.full.directed

    @property
    def size(self) -> int:
        """Number of free unknowns of the full organ."""
        return self.full.size

    @property
    def elasticity(self) -> Elasticity:
        """The organ's discrete elasticity."""
        return self.full.elasticity

    @property
    def sites(self) -> Sites:
        """The organ's sites."""
        return self.full.sites

    @property
    def surface(self) -> Loads:
        """The loads on its boundaries."""
        return self.full.surface

    @property
    def choice(self) -> SolverChoice:
        """The solver used to build its space."""
        return self.full.choice

    def load_resultants(self, state: OrganState) -> Array:
        """Return the sum of the forces of each whole load, `(l, 3)` [N]."""
        return self.full.load_resultants(state)

    def lips(self, state: OrganState) -> Lips:
        """Return no pairs: this organ has no contact."""
        return NO_LIPS

    # -- the error of the space ------------------------------------------------------------------------------------

    def vectors(self, state: OrganState) -> int:
        """Return the number of vectors of a state; 0 for a state of the whole organ."""
        return 0 if self.level(state) is None else state.U.size

    def residual(self, state: OrganState) -> float:
        """Return the residual of the equations of motion divided by the largest forces so far [-].

        It is 0 for a state of the whole organ.
        """
        level, work = self.level(state), state.tally
        return 0.0 if level is None or not work else level.left(state) / work


def has_space(organ: DynamicOrgan) -> bool:
    """Return whether an organ has a Krylov space.

    Memory is not checked. The same scenario is therefore solved in the same way on every machine,
    and can be resumed from a checkpoint of another machine.
    """
    body = organ.elasticity
    return not organ.pairs and holds_still(body.points, body.held)
