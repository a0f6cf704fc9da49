"""An organ with inertia in a small basis, U ≈ V η.

The cost of a step does not depend on the size of the mesh.

In parallel with this model, a check runs under the same forces. The basis of the check has one more
block of the Krylov space (`tissue.organs.basis`). Let y_k, y_{k+1} and y be the site variables of
the model, of the check and of the whole organ. Then

    |y − y_k|  ≤  |y_{k+1} − y_k| + |y − y_{k+1}|,      |y_i − y_{k+1,i}| ≤ ‖Y_i‖ ‖e‖,   ‖Y_i‖² = (Y K⁻¹ Yᵀ)_ii
    ‖e(t)‖ in K  ≤  ‖r(t)‖ + Σ ‖Δr‖,   both in K⁻¹

If the second term is small, the first term is the error. The last line holds because a body that is
released from rest does not swing beyond its initial displacement: e = K⁻¹r(t) − Σ g Δr with |g| ≤ 1
in each mode, for backward Euler, BDF2 and continuous time. An impulse or a displacement between two
steps leaves a further residual, which is added in the same norm. The bound does not include the
change of the thread's forces due to the error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tissue.arrays import Array
from tissue.errors import TissueError
from tissue.organs.basis import Space
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.meshed import SHARE, OrganEnergies, OrganState, SiteAnswer, TimeScheme
from tissue.organs.modal import ModalArrays, Modes, OrganOfModes
from tissue.solvers.choice import GIGA
from tissue.solvers.memory import free_memory
from tissue.supports import holds_still

ALSO_MADE = 3  # blocks beyond the requested ones: static answers, the check's block, the block for its residual
TIMES_HELD = 4  # vectors, K times the vectors, and products and copies of a block during its construction


@dataclass(frozen=True)
class Reduction:
    """An organ in two bases: the first `size` numbers of each array belong to the model, the rest
    to its check.

    `vectors` (N, size) is V of the model. `mu` (n,) are the masses for a stiffness of one. `Y` (9p,
    n), `load` (n,) and `surface_load` (n, l) are as in `tissue.organs.modal`. `missed` (m, c) is R
    of the check, as in `tissue.organs.basis`.
    """

    vectors: Array
    mu: Array
    Y: Array
    load: Array
    surface_load: Array
    missed: Array

    @property
    def size(self) -> int:
        """Number of vectors of the model."""
        return self.vectors.shape[1]

    @cached_property
    def reach(self) -> Array:
        """Largest displacement of each site's point per unit of strain energy, ‖Y_x‖ in K⁻¹, `(p,)`
        [m/√J].
        """
        own = self.Y[:, self.size :].reshape(-1, 9, self.mu.size - self.size)[:, :3]
        return np.linalg.norm(own, 2, axis=(1, 2)) if own.size else np.zeros(len(own))

    @cached_property
    def stiffness(self) -> Array:
        """Largest static stiffness of each site's point, `(p,)` [N/m]."""
        own = self.Y[:, self.size :].reshape(-1, 9, self.mu.size - self.size)[:, :3]
        least = np.linalg.svd(own, compute_uv=False)[:, -1] if own.size else np.ones(len(own))
        return np.asarray(1.0 / least**2)


def reduce_organ(organ: DynamicOrgan, blocks: int, modes: int = 0) -> Reduction:
    """Return the reduction of an organ by static answers, `blocks` of the Krylov space and `modes`
    vibration modes.

    Raises `TissueError` for an organ with contact, for an organ that is not held, and for
    impossible numbers.
    """
    check_reducible(organ, blocks, modes)
    space = Space(organ, blocks + 1, modes)
    model, check = levels = space.level(blocks), space.level(blocks + 1)
    return Reduction(
        vectors=space.vectors[:, : len(model.turn)] @ model.turn,
        mu=np.concatenate([level.modes.mu for level in levels]),
        Y=np.hstack([level.modes.Y for level in levels]),
        load=np.concatenate([level.modes.load for level in levels]),
        surface_load=np.vstack([level.modes.surface_load for level in levels]),
        missed=check.missed,
    )


def check_reducible(organ: DynamicOrgan, blocks: int, modes: int) -> None:
    """Raise `TissueError` if an organ has no small basis, or one that does not fit into memory."""
    check_held(organ)
    if blocks < 0 or not (0 <= modes <= organ.size // 2):
        raise TissueError(
            f"reduction: blocks = {blocks}, modes = {modes}; allowed are 0 or more, and modes up to half of the "
            f"{organ.size} unknowns"
        )
    check_memory(organ, blocks, modes, "take fewer blocks, modes or holes, or a coarser mesh")


def check_held(organ: DynamicOrgan) -> None:
    """Raise `TissueError` for an organ with contact, and for an organ that is not held."""
    body = organ.elasticity
    if organ.pairs:
        raise TissueError(
            f"reduction: the organ has {organ.pairs} pairs of nodes that can touch, and a reduced organ has no "
            "contact; leave out contact, or the reduction"
        )
    if not holds_still(body.points, body.held):
        raise TissueError("reduction: the organ is not held and has no static answer; clamp a boundary")


def check_memory(organ: DynamicOrgan, blocks: int, modes: int, remedy: str) -> None:
    """Raise `TissueError` with a remedy if the blocks and modes do not fit into memory."""
    vectors = modes + (blocks + ALSO_MADE) * (organ.Y.shape[0] + 1 + organ.surface_load.shape[1])
    need, room = 8.0 * TIMES_HELD * vectors * organ.size, SHARE * free_memory()
    if need > room:
        raise TissueError(
            f"reduction: making {vectors} vectors of {organ.size} unknowns takes about {need / GIGA:.2g} GB and "
            f"{room / GIGA:.2g} GB are available; {remedy}"
        )


@dataclass(frozen=True, eq=False)
class ReducedOrgan(OrganOfModes):
    """A linear organ with inertia in a reduced basis; `full` has the mesh, the sites and the loads.

    U, V, A of its states are η, η̇, η̈ of the model, followed by those of its check, `(n,)` [√J, …].
    """

    reduction: Reduction

    @cached_property
    def both(self) -> Modes:
        """The modes of model and check; only the model moves the sites."""
        given = self.reduction
        return Modes(given.mu, given.Y, given.load, given.surface_load, self.full.rayleigh, given.size)

    def start(self) -> OrganState:
        """Return the undeformed state at rest; gravity and loads act from the first step."""
        rest = np.zeros(self.reduction.mu.size)
        return OrganState(rest, rest, rest, np.zeros(self.y0.size), shares=self.full.no_shares)

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> SiteAnswer[OrganState]:
        """Return the answer of a step of `scheme` from the states `past`, newest first.

        The part `share` of the loads acts at `time` [s].
        """
        shares = self.full.shares_at(time, share)

        def accept(U: Array, V: Array, A: Array, f_y: Array) -> OrganState:
            """Return the state of a motion, with the error estimates so far."""
            new = OrganState(U, V, A, f_y, shares=shares)
            change = self.both.rates(new) - self.both.rates(past[0])
            return replace(new, tally=past[0].tally + self._dual_norm(change))

        return self.both.answer(self.y0, scheme, past, shares, accept)

    def site_variables(self, state: OrganState) -> Array:
        """Return y, shape `(9p,)`."""
        return self.both.site_variables(self.y0, state.U)

    def spread(self, state: OrganState, x: Array) -> Array:
        """Return the field over the free unknowns (N,) of U, V or A of a state."""
        return np.asarray(self.reduction.vectors @ x[: self.reduction.size])

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works of the step, exact for the model."""
        return self.both.energies(old, new)

    def modes(self, scheme: TimeScheme, state: OrganState, times: Sequence[float]) -> ModalArrays | None:
        """Return the arrays with which a kernel makes steps, or None if the loads change at the
        `times` [s].

        The arrays are masses and loads of model and check (n,), W (n, 9p), Y of the model, y0 and R
        of the check. Then follow Rayleigh's α and β, and two zeros: no bound on the residual of a
        step.
        """
        shares, given = state.shares, self.reduction
        if not self.surface.are_steady(shares, times):
            return None
        W = self.both.operator(scheme.a, scheme.d).W
        loads, Y = self.both.load_under(shares), given.Y[:, : given.size]
        return (given.mu, loads, W, Y, self.y0, given.missed, *self.full.rayleigh, 0.0, 0.0)

    def motion(self, state: OrganState, like: OrganState) -> tuple[Array, Array, Array, Array, float]:
        """Return η, η̇, η̈ (n,) of model and check, the site forces (9p,), and Σ‖Δr‖ of the check
        so far [√J].
        """
        return state.U, state.V, state.A, state.f_y, state.tally

    def impulse(self, state: OrganState) -> SiteAnswer[OrganState]:
        """Return the answer to an impulse on the sites, dy/dt = Y η̇, with the masses of the basis.

        A hole has more mass in the basis than in the mesh, where only its nodes take an impulse.
        """
        own = self.reduction.size

        def struck(j: Array, p: Array) -> OrganState:
            V = state.V + self._mobility @ j
            left = float(j @ (self.full.mobility[1] - self.reduction.Y[:, own:] @ self._mobility[own:]) @ j)
            return replace(state, V=V, tally=state.tally + float(np.sqrt(max(left, 0.0))))

        C = self.reduction.Y[:, :own] @ self._mobility[:own]
        return SiteAnswer(self.reduction.Y[:, :own] @ state.V[:own], lambda: C, struck)

    @cached_property
    def _mobility(self) -> Array:
        """M⁻¹ Yᵀ of model and check, `(n, 9p)`; modes without mass take no impulse."""
        mu = self.reduction.mu
        inverse = np.divide(1.0, mu, out=np.zeros_like(mu), where=np.greater(mu, 0.0))
        return np.asarray(inverse[:, None] * self.reduction.Y.T)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> SiteAnswer[OrganState]:
        """Return the answer of a step in which the sites stay at `y` (9p,) while the forces are
        constant.

        V does not change.
        """
        operator = self.both.operator(scheme.a, scheme.d)

        def displaced(f_new: Array, p: Array) -> OrganState:
            way = operator.W @ (f_new - f_y)
            left = self._dual_norm((scheme.a + self.full.rayleigh[0] * scheme.d) * way)
            return replace(state, U=state.U + way, f_y=state.f_y + f_new - f_y, tally=state.tally + left)

        return SiteAnswer(y - operator.C @ f_y, lambda: operator.C, displaced)

    # -- the error of the basis ------------------------------------------------------------------------------------

    def difference(self, state: OrganState) -> Array:
        """Return the distances between the site points of the model and of its check, `(p,)` [m]."""
        own, Y = self.reduction.size, self.reduction.Y
        apart = Y[:, own:] @ state.U[own:] - Y[:, :own] @ state.U[:own]
        return np.asarray(np.linalg.norm(apart.reshape(-1, 9)[:, :3], axis=1))

    def bound(self, state: OrganState) -> Array:
        """Return bounds of the errors of the site points, `(p,)` [m].

        The errors are the differences from the whole organ under the same forces.
        """
        left = self._dual_norm(self.both.rates(state)) + state.tally
        return np.asarray(self.difference(state) + self.reduction.reach * left)

    def _dual_norm(self, rates: Array) -> float:
        """Return the norm in K⁻¹ of the check's residual at these rates `(n,)` [√J]."""
        return float(np.linalg.norm(self.reduction.missed @ rates[self.reduction.size :]))
