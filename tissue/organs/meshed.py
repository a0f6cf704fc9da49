"""The organ in the coupled system: nine site variables per piercing and their compliance.

A step solves, by one back-substitution,

    acceleration⁺ = a (U⁺ − U_a),   velocity⁺ = d (U⁺ − U_d),   (a M + d C + K) U⁺ = b + Yᵀ f_y

A time scheme has two numbers a, d and two reference fields U_a, U_d. Backward Euler has a = 1/Δt²,
U_a = U + Δt V and d = 1/Δt, U_d = U. b contains gravity and the loads on boundaries
(`tissue.loads`). `f_y` `(9p,)` is the force on the organ conjugate to y. The elimination of U is
exact, so that y = y_free + C f_y.

The lips of a wound may have gaps g = g0 + G U (`tissue.organs.lips`), and forces p that push them
apart:

    A U⁺ = b + Yᵀ f_y + Gᵀ p,   y = y_free + C f_y + C_yc p,   g = g_free + C_cy f_y + C_cc p

Each pair with friction also has two slips since the start of the step. In g, the slips follow the
gaps of all pairs. In p, the forces along the slips follow the forces of all pairs. k is then the
number of gaps and slips (`MeshedOrgan.contacts`); without friction it is the number of pairs.

The columns A⁻¹Gᵀ are not stored. Once the columns of C_cc of the pressed pairs are known, p costs
one more back-substitution per step. Lips that slide are paired anew at the start of a step. G = S R
sums the rows R of their nodes with other weights S, and C_cc = S (R A⁻¹ Rᵀ) Sᵀ. This product
needs a solve for each row of R that it uses for the first time.

Outside points, such as those of a thread, may bear on the surface (`tissue.organs.skin`). Their
rows d·x, and with friction their slips, follow the rows of all pairs. The number of outside points
may change from step to step. A state stores their facing data.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix, hstack, vstack

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.loads import Loads, SurfaceLoad
from tissue.organs.lips import Gaps
from tissue.organs.skin import OWN, Skin
from tissue.sites.site import Sites
from tissue.solvers.choice import GIGA, Solver, SolverChoice, choose_solver, solver
from tissue.solvers.memory import free_memory
from tissue.supports import motions_in_words, rigid_motions

# Cached operators, if memory allows: of BDF2, of backward Euler, and of each part of a halved step.
KEPT_OPERATORS = 12
COLUMNS = 64  # columns of A⁻¹Yᵀ that are solved for together
PAIRS = 8  # columns of A⁻¹Gᵀ that are solved for together: more are faster by multigrid only, and often not needed
SHARE = 0.5  # of the free memory: the largest part that the compliance of the gaps can take
SLIPPING = 1.0 - 1e-9  # of the largest friction: a pair with at least this friction slips
EMPTY = np.zeros(0)
TINY = float(np.finfo(float).tiny)
NO_POINTS = np.zeros((0, OWN))


class Paired(NamedTuple):
    """The displacement `U` (N,) [m] at which surfaces are paired.

    It is a `share` of the `way` from the last such place to the equilibrium with its pairs; `way` is
    that of the nodes of the surfaces, `(3r,)` [m].
    """

    U: Array
    way: Array
    share: float


@dataclass(frozen=True)
class OrganState:
    """The state of an organ.

    - `U` [m], `V` [m/s], `A` [m/s²]: displacement, velocity and acceleration over the free unknowns
      `(N,)`.
    - `f_y` `(9p,)`: the site forces.
    - `p` `(k,)` [N]: the contact forces and the forces along the slips; k = 0 if the organ has
      neither gaps nor a skin.
    - `facing` `(pairs, 7)`: the points and directions of the contact forces on the right lip
      (`tissue.organs.lips.Gaps.facing`); None for the pairs of the reference.
    - `shares` `(l,)`: the parts of the loads that act (`tissue.loads`); None without loads.
    - `linearised` `(N,)` [m]: the displacement at which the tangent of a nonlinear organ was last
      computed; the next step reuses this tangent. None for a linear organ.
    - `linearised_H` `(3, 3, q, c)` [Pa]: the constant stress of this tangent (`tissue.relaxation`);
      None without relaxation.
    - `columns` `(N,)` [m]: the displacement at which the columns of the sites were computed; None
      if the tangent has its own.
    - `MU` [kg m], `MV` [N s], `KU` [N]: the products M U, M V and K U `(N,)`; None if they are
      not stored.
    - `relaxing`: the relaxing stresses `(b, 3, 3, q, c)` [Pa] (`tissue.relaxation`), or in a linear
      organ the fields e_i `(b, N)` [m] (`tissue.organs.relaxing`); None if all stress has relaxed.
    - `points` `(j, 9 + l)`: the facing data of outside points (`tissue.organs.skin.Skin.faced`),
      whose forces follow those of the pairs in `p`; None if no point may bear on the organ.
    - `ahead` `(j, 9 + l)`: the facing data for the next step.
    - `paired`: the place at which surfaces are paired in the next step; None for that of the state.
    - `tally` [√J]: for the error estimate of an organ in modes, the largest norm of the forces so
      far (`tissue.organs.krylov`).
    """

    U: Array
    V: Array
    A: Array
    f_y: Array
    p: Array = field(default_factory=lambda: EMPTY)
    facing: Array | None = None
    shares: Array | None = None
    linearised: Array | None = None
    MU: Array | None = None
    MV: Array | None = None
    KU: Array | None = None
    relaxing: Array | None = None
    points: Array | None = None
    ahead: Array | None = None
    paired: "Paired | None" = None
    tally: float = 0.0
    linearised_H: Array | None = None
    columns: Array | None = None


@dataclass(frozen=True)
class Pairing:
    """The pairing during a step: g = `g0` + `G` U.

    G = S R, with the weights S = `sums` `(k, 3r)` and the rows R of the lips' nodes. Slips are
    counted from the start of the step. `facing` and `points` are as in a state: `facing` is None
    for the pairs of the reference.
    """

    G: csr_matrix
    g0: Array
    sums: csr_matrix
    facing: Array | None
    points: Array | None = None


class TimeScheme(Protocol):
    """The coefficients of a time scheme that an organ reads.

    The acceleration is a (U − U_a), and the velocity is d (U − U_d).
    """

    @property
    def dt(self) -> float:
        """Length of the step [s].

        In equilibrium it is the time since the last equilibrium, which is infinite after complete
        relaxation.
        """

    @property
    def a(self) -> float:
        """Factor of the mass [1/s²]; 0 in equilibrium."""

    @property
    def d(self) -> float:
        """Factor of the damping [1/s]; 0 in equilibrium."""

    @property
    def coefficients(self) -> tuple[tuple[float, float, float], ...]:
        """(α, β [s], γ) of each earlier state, newest first: U_a = Σ (α U + β V), U_d = Σ γ U."""


class OrganEnergies(NamedTuple):
    """Energies at the end of a step, and works during the step [J].

    `numerical` is the loss by the integrator, with −p⁺·Δg of the contact forces p⁺ at the end of
    the step. `friction` is the dissipation of contact friction. `prestretch` is the energy of a
    prestretch in the reference shape.
    """

    kinetic: float
    elastic: float
    load_work: float
    viscous: float
    numerical: float
    friction: float = 0.0
    prestretch: float = 0.0


class Lips(NamedTuple):
    """The pairs of a state that can touch.

    `gap` [m], `force` [N] and `slide` [m], `(pairs,)` each, are the gaps g, the contact forces p
    that push the surfaces apart, and the sliding distances since the reference. `friction`
    `(pairs, 3)` [N] is the friction that the left node of each pair exerts on the point that it
    faces. `slips` `(pairs,)` is True if the friction has its largest possible value.
    """

    gap: Array
    force: Array
    slide: Array
    friction: Array
    slips: NDArray[np.bool_]


NO_LIPS = Lips(EMPTY, EMPTY, EMPTY, np.zeros((0, 3)), np.zeros(0, dtype=bool))


class Equation(NamedTuple):
    """The organ's rows of the assembled matrix.

    They are A U⁺ = b + Yᵀ f_y + Gᵀ p, with y = y0 + Y U and g = g0 + G U.
    """

    A: csr_matrix
    b: Array
    y0: Array
    Y: csr_matrix
    g0: Array
    G: csr_matrix


Body = TypeVar("Body")


@dataclass(frozen=True)
class SiteAnswer(Generic[Body]):
    """An answer for the sites alone, y = y_free + C f_y.

    `compliance()` returns C, shape (9p, 9p). `accepted(f_y, p)` returns the organ's state at the
    end of the step.
    """

    y_free: Array
    compliance: Callable[[], Array]
    accepted: Callable[[Array, Array], Body]
    linear: ClassVar = True  # in the forces
    far: ClassVar = False
    g_free: ClassVar = EMPTY  # no gaps
    friction: ClassVar = EMPTY  # no pairs
    points: ClassVar = NO_POINTS

    @property
    def C(self) -> Array:
        """Site compliance, shape `(9p, 9p)`."""
        return self.compliance()

    @property
    def C_cy(self) -> Array:
        """No gaps, shape `(0, 9p)`."""
        return np.zeros((0, self.y_free.size))

    def gaps_by_forces(self, some: Indices) -> Array:
        """No gaps, shape `(0, 0)`."""
        return np.zeros((0, 0))

    def accept(self, f_y: Array, p: Array = EMPTY) -> Body:
        """Return the state at the end of the step."""
        return self.accepted(f_y, p)

    def again(self, f_y: Array, p: Array) -> "SiteAnswer[Body]":
        """Return itself: the answer is linear."""
        return self


@dataclass(frozen=True)
class LinearAnswer:
    """The answer of a meshed organ: `y_free` (9p,), `g_free` (k,) [m] and its factorised operator.

    `accepted(f_y, p)` returns the state at the end of the step. `right_hand_side()` returns b of
    the organ's equation. `pairing` is the pairing of the lips during the step.
    """

    operator: "Operator"
    y_free: Array
    g_free: Array
    accepted: Callable[[Array, Array], OrganState]
    right_hand_side: Callable[[], Array]
    pairing: Pairing
    linear: ClassVar = True  # in the forces
    far: ClassVar = False

    @property
    def C(self) -> Array:
        """Site compliance Y A⁻¹ Yᵀ, shape `(9p, 9p)`."""
        return self.operator.C

    @cached_property
    def C_cy(self) -> Array:
        """Gaps by site forces, shape `(k, 9p)`."""
        return self.operator.gaps_by_sites(self.pairing)

    @cached_property
    def _by_forces(self) -> "Columns":
        return self.operator.by_pairs(self.pairing)

    def gaps_by_forces(self, some: Indices) -> Array:
        """Return the gaps by the contact forces of `some` pairs `(j,)`, shape `(k, j)` [m/N]."""
        return self._by_forces.of(some)

    @property
    def friction(self) -> Array:
        """Coefficient of friction of each pair, shape `(pairs,)` [-]."""
        return self.operator.organ.friction(self.pairing.facing)

    @property
    def points(self) -> Array:
        """The facing data of outside points, shape `(j, 9 + l)`."""
        return NO_POINTS if self.pairing.points is None else self.pairing.points

    def accept(self, f_y: Array, p: Array = EMPTY) -> OrganState:
        """Return the state at the end of the step."""
        return self.accepted(f_y, p)

    def again(self, f_y: Array, p: Array) -> "LinearAnswer":
        """Return itself: the organ is linear."""
        return self

    @property
    def equation(self) -> Equation:
        """The organ's rows of the assembled matrix."""
        organ = self.operator.organ
        return Equation(self.operator.A, self.right_hand_side(), organ.y0, organ.Y, self.pairing.g0, self.pairing.G)


@dataclass(frozen=True, eq=False)
class MeshedOrgan:
    """The common part of dynamic and quasi-static organs.

    It has the body, its sites and the blocks over the free unknowns.
    """

    elasticity: Elasticity
    sites: Sites
    gravity: ArrayLike = (0.0, 0.0, 0.0)
    solver: str = "auto"  # one of `tissue.solvers.choice.SOLVERS`
    gaps: Gaps | None = None
    loads: Sequence[SurfaceLoad] = ()
    skin: Skin | None = None
    choice: SolverChoice = field(init=False, repr=False)
    K: csr_matrix = field(init=False, repr=False)
    Y: csr_matrix = field(init=False, repr=False)
    surface: Loads = field(init=False, repr=False)
    load: Array = field(init=False, repr=False)
    surface_load: Array = field(init=False, repr=False)
    places: Array = field(init=False, repr=False)
    turns: ClassVar = False  # whether contact surfaces may turn far
    solved_once: ClassVar = False  # whether the organ solves only for the columns of the sites and for the load

    def __post_init__(self) -> None:
        gravity = np.asarray(self.gravity, dtype=float)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise TissueError(f"gravity = {self.gravity}: allowed are three finite numbers [m/s²]")
        body, free = self.elasticity, self.elasticity.free
        if self.sites.Y.shape[1] != free.size:
            raise TissueError(
                f"sites over {self.sites.Y.shape[1]} unknowns on an organ of {free.size}; build them on it"
            )
        K, places = body.free_stiffness, body.places
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "Y", self.sites.Y)
        object.__setattr__(self, "load", body.body_force(gravity)[free])
        object.__setattr__(self, "surface", Loads(body, tuple(self.loads)))
        object.__setattr__(self, "surface_load", self.surface.columns[free])
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "choice", choose_solver(self.solver, K, places, self.solved_once))
        if self.gaps is not None:
            self._check_gaps(self.gaps.rows.shape[1])

    def _check_gaps(self, unknowns: int) -> None:
        """Raise `TissueError` if the compliance of the gaps does not fit into memory, or if the
        gaps have another number of `unknowns`.
        """
        N, room = self.elasticity.free.size, SHARE * free_memory()
        need = 8.0 * ((KEPT_OPERATORS + 2) * self.contacts**2 + PAIRS * N)
        if unknowns != N:
            raise TissueError(f"gaps over {unknowns} unknowns on an organ of {N}; build them on it")
        if need > room:
            raise TissueError(
                f"contact: the {self.pairs} pairs of nodes on the lips take about {need / GIGA:.2g} GB and "
                f"{room / GIGA:.2g} GB are available; take a coarser mesh at the lips, or leave out contact"
            )

    @cached_property
    def M(self) -> csr_matrix:
        """Mass over the free unknowns, shape `(N, N)` [kg]."""
        free = self.elasticity.free
        return csr_matrix(self.elasticity.M[free][:, free])

    @property
    def pairs(self) -> int:
        """Number of pairs of nodes on the lips that can touch; 0 without gaps."""
        return 0 if self.gaps is None else len(self.gaps.g0)

    @property
    def touches(self) -> bool:
        """Whether surfaces of the organ may touch one another or outside points."""
        return self.gaps is not None or self.skin is not None

    @property
    def contacts(self) -> int:
        """Number of contact forces of pairs: one per pair, and two more per pair with friction."""
        return 0 if self.gaps is None else self.pairs + 2 * self.gaps.rough.size

    def friction(self, facing: Array | None) -> Array:
        """Return the ratio of friction to contact force of each slipping pair, `(pairs,)` [-].

        p acts along the vector d of `facing`, and the force normal to the surface is |d| p.
        """
        if self.gaps is None:
            return EMPTY
        mu = self.gaps.friction
        return mu if facing is None else mu * np.linalg.norm(facing[:, 4:], axis=1)

    @property
    def g0(self) -> Array:
        """Gaps of the reference shape, shape `(pairs,)` [m]."""
        return EMPTY if self.gaps is None else self.gaps.g0

    @cached_property
    def lip_rows(self) -> csr_matrix:
        """R, the displacement over the free unknowns of nodes that may touch, shape `(3r, N)`.

        The nodes of the lips come first, then those of the skin.
        """
        rows = [surface.rows for surface in (self.gaps, self.skin) if surface is not None]
        return csr_matrix(vstack(rows)) if rows else csr_matrix((0, self.size))

    @cached_property
    def _matched(self) -> Pairing:
        """The pairs of the reference."""
        if self.gaps is None:
            return Pairing(csr_matrix((0, self.size)), EMPTY, csr_matrix((0, self.lip_rows.shape[0])), None)
        return replace(self._facing(self.gaps, self.gaps.start), facing=None)

    def _facing(self, gaps: Gaps, facing: Array) -> Pairing:
        """Return the pairing of the pairs with a given `facing` `(pairs, 7)`."""
        sums, g0 = gaps.sums(facing), gaps.rest(facing)
        if gaps.rough.size:
            sums = csr_matrix(vstack([sums, gaps.slip_sums(facing)]))
            g0 = np.append(g0, np.zeros(self.contacts - self.pairs))
        sums = hstack([sums, csr_matrix((sums.shape[0], self.lip_rows.shape[0] - sums.shape[1]))], format="csr")
        return Pairing(csr_matrix(sums @ self.lip_rows), g0, sums, facing)

    def pairing(self, facing: Array | None, points: Array | None = None) -> Pairing:
        """Return the pairing of the pairs and of outside `points`.

        Its slips are counted from the reference.
        """
        pairing = self._matched
        if self.gaps is not None and facing is not None:
            pairing = self._facing(self.gaps, facing)
        if self.skin is None or points is None or not len(points):
            return pairing
        own = self.skin.sums(points)
        own = hstack([csr_matrix((own.shape[0], self.lip_rows.shape[0] - own.shape[1])), own], format="csr")
        G, sums = vstack([pairing.G, own @ self.lip_rows]), vstack([pairing.sums, own])
        g0 = np.append(pairing.g0, self.skin.rest(points))
        return Pairing(csr_matrix(G), g0, csr_matrix(sums), facing, points)

    def pairing_of(self, state: OrganState) -> Pairing:
        """Return the pairing at the end of the step to a state."""
        return self.pairing(state.facing, state.points)

    def paired_anew(self, U: Array, points: Array | None = None) -> Pairing:
        """Return a new pairing of the lips under a displacement of the free unknowns `(N,)`.

        If surfaces may turn far, it is along their current normals.
        """
        gaps, at_rest = self.gaps, self.elasticity.points
        facing = None if gaps is None else gaps.facing(at_rest, self.nodal(U), self.turns)
        return self.slipping_from(U, self.pairing(facing, points))

    def paired_after(self, past: Sequence[OrganState], scheme: TimeScheme) -> Pairing:
        """Return the pairing of a step from the states `past`, newest first.

        In equilibrium, slips are counted from the last state of `past`.
        """
        now, first = past[0], slips_since(past, scheme)
        pairing = self.paired_anew(self.place(now), now.ahead)
        if first is now or not self.slips(pairing).size:
            return pairing
        return self.slipping_from(self.field(first), pairing)

    def place(self, state: OrganState) -> Array:
        """Return the displacement of the free unknowns at which surfaces are paired after a state, `(N,)` [m]."""
        return self.field(state) if state.paired is None else state.paired.U

    def paired_nearer(self, last: OrganState, now: OrganState) -> OrganState:
        """Return the equilibrium `now` with the place at which its surfaces are paired to solve it again.

        Its pairs were found at the place of `last`. The new place is a share of the way from there to
        `now`, by Aitken's method (Küttler and Wall, Comput. Mech. 43, 2008). Forces on curved surfaces
        turn as the surfaces slide, and drive them back. If they turn by more than the surfaces are
        stiff, pairs at the place of the last equilibrium alternate.
        """
        before, U, share = self.place(last), self.field(now), 1.0
        way = self.lip_rows @ (U - before)
        if last.paired is not None:
            change = way - last.paired.way
            share = -last.paired.share * float(last.paired.way @ change) / max(float(change @ change), TINY)
            share = share if 0.0 < share < 1.0 else 1.0
        return replace(now, paired=Paired(before + share * (U - before), way, share))

    @property
    def finest(self) -> float:
        """Smallest height of a facet on which outside points may bear [m]."""
        assert self.skin is not None
        return self.skin.finest

    def faced(
        self, state: OrganState, places: Array, labels: Array, before: OrganState | None = None, ratio: float = 0.0
    ) -> Array:
        """Return the facing data of outside points, shape `(j, 9 + l)`.

        The points are at `places` `(j, 3)` [m] and have `labels` `(j, l)`. The surface is moved on by
        `ratio` times its way since the state `before`; None means that it stays.
        """
        assert self.skin is not None
        U = self.field(state)
        return self.skin.faced(
            self.nodal(U if before is None else U + ratio * (U - self.field(before))), places, labels
        )

    def touched(self, state: OrganState, points: Array) -> OrganState:
        """Return the state before a step with the facing data `points` `(j, 9 + l)`."""
        return replace(state, ahead=points)

    def field(self, state: OrganState) -> Array:
        """Return the displacement over the free unknowns, shape `(N,)` [m]."""
        return state.U

    def displacement(self, state: OrganState) -> Array:
        """Return the displacement of all unknowns, shape `(N_all,)` [m]."""
        return self.whole(self.field(state))

    def lips(self, state: OrganState) -> Lips:
        """Return the gaps, forces, slides and friction of the pairs; the slides are those to the
        place of the next pairs.
        """
        if not self.pairs:
            return NO_LIPS
        p, slides = state.p[: self.pairs], self.slides(self.place(state))
        return Lips(self.gap(state), p, slides, *self.rubbing(state))

    def gap(self, state: OrganState) -> Array:
        """Return g = g0 + G U, shape `(pairs,)` [m]."""
        return self.gaps_of(state)[: self.pairs]

    def gaps_of(self, state: OrganState) -> Array:
        """Return the gaps and slips of all pairs and outside points in a state, `(k,)` [m].

        Those of outside points follow those of the pairs.
        """
        pairing = self.pairing_of(state)
        return np.asarray(pairing.g0 + pairing.G @ state.U)

    def touching_points(self, state: OrganState) -> tuple[Array, Array]:
        """Return the facing data of outside points in the step to a state, and their forces.

        The facing data has shape `(j, 9 + l)`. The forces on the organ act along d, `(j,)` [N].
        With friction, the forces along both tangents of each point follow, `(3j,)`.
        """
        if state.points is None:
            return NO_POINTS, EMPTY
        return state.points, state.p[self.contacts :]

    def slipping_from(self, U: Array, pairing: Pairing) -> Pairing:
        """Return the pairing with slips counted from a displacement of the free unknowns `(N,)`."""
        slips = self.slips(pairing)
        if not slips.size:
            return pairing
        g0 = pairing.g0.copy()
        g0[slips] = -(pairing.G[slips] @ U)
        return replace(pairing, g0=g0)

    def slips(self, pairing: Pairing) -> Indices:
        """Return the numbers of the slips among the gaps and slips of a pairing."""
        points = 0 if pairing.points is None else len(pairing.points)
        return np.append(np.arange(self.pairs, self.contacts), np.arange(self.contacts + points, len(pairing.g0)))

    def slides(self, U: Array) -> Array:
        """Return the sliding distance of each pair of the lips, shape `(pairs,)` [m].

        `U` is the displacement of the free unknowns, `(N,)` [m].
        """
        return EMPTY if self.gaps is None else self.gaps.slides(self.nodal(U))

    def rubbing(self, state: OrganState) -> tuple[Array, NDArray[np.bool_]]:
        """Return the friction of each pair, `(pairs, 3)` [N], and whether it slips, `(pairs,)`.

        The friction is the force of the left node on the point that it faces.
        """
        out, p = np.zeros((self.pairs, 3)), state.p
        if self.gaps is None or not self.gaps.rough.size:
            return out, np.zeros(self.pairs, dtype=bool)
        facing = self.gaps.start if state.facing is None else state.facing
        rough = self.gaps.rough
        along = p[self.pairs : self.contacts].reshape(-1, 2)
        out[rough] = np.einsum("mt,mtx->mx", along, self.gaps.tangents(facing))
        bound = self.friction(state.facing) * p[: self.pairs]
        return out, (bound > 0.0) & (np.linalg.norm(out, axis=1) >= SLIPPING * bound)

    def slipping_surfaces(self, state: OrganState) -> dict[str, bool]:
        """Return whether each pressed contact surface with friction slips as a whole, by name.

        A surface slips as a whole if all of its pressed pairs slip. Surfaces without pressed pairs
        are not included.
        """
        if self.gaps is None or not self.gaps.rough.size:
            return {}
        pressed, slips = state.p[: self.pairs] > 0.0, self.rubbing(state)[1]
        own = zip(self.gaps.parts, self.gaps.slices, strict=True)
        there = [(part.name, at) for part, at in own if part.friction and pressed[at].any()]
        return {name: bool(slips[at][pressed[at]].all()) for name, at in there}

    def contact_works(self, p: Array, ways: Array) -> tuple[float, float]:
        """Return the energies that contact forces `p` `(k,)` dissipate [J].

        The first is −p·Δg, which counts as dissipation of the time integrator; the second is
        friction. `ways` `(k,)` [m] are the changes of the gaps and slips.
        """
        works, rubs = -p * ways, np.zeros(len(p), dtype=bool)
        points = (len(p) - self.contacts) // (3 if self.skin is not None and self.skin.friction else 1)
        rubs[self.pairs : self.contacts] = rubs[self.contacts + points :] = True
        return float(works[~rubs].sum()), float(works[rubs].sum())

    def displaced(self, operator: "Operator", state: OrganState, y: Array, f_y: Array, Y: csr_matrix) -> LinearAnswer:
        """Return the answer of a step without motion, with the rows `Y` (9p, N) of the sites.

        The sites stay at `y` (9p,) while the site forces `f_y` (9p,) and the contact forces of
        `state` are constant. The answer is linear in their change. V does not change.
        """
        p, pairing = state.p, self.pairing_of(state)
        y_free, g_free = operator.free_values(y, self.gaps_of(state), f_y, p, pairing)

        def complete(f_new: Array, p_new: Array) -> OrganState:
            # Only the change is used, because the forces of the state can include holes that ended at this time.
            df, U = f_new - f_y, state.U
            if U.size:  # the state of an organ without inertia has only forces
                U = operator.add_forces(U, df, p_new - p, pairing)
            return replace(state, U=U, f_y=state.f_y + df, p=p_new, MU=None, MV=None, KU=None)

        def right_hand_side() -> Array:
            return np.asarray(operator.A @ self.field(state) - Y.T @ f_y - pairing.G.T @ p)

        return LinearAnswer(operator, y_free, g_free, complete, right_hand_side, pairing)

    def shares_at(self, time: float, share: float) -> Array | None:
        """Return the parts of the loads that act, `(l,)`; None without loads.

        They are those at `time` [s], or at a `share` of the load steps.
        """
        return self.surface.shares(time, share) if self.surface.each else None

    @property
    def no_shares(self) -> Array | None:
        """Zero parts of all loads, `(l,)`; None without loads."""
        return np.zeros(len(self.surface.each)) if self.surface.each else None

    def load_under(self, shares: Array | None) -> Array:
        """Return the forces of gravity and of the parts `shares` (l,) of the loads, `(N,)` [N]."""
        return self.load if shares is None else self.load + self.surface_load @ shares

    def load_resultants(self, state: OrganState) -> Array:
        """Return the sum of the forces of each whole load, `(l, 3)` [N].

        In a linear organ the forces keep their direction.
        """
        return self.surface.resultants

    def solver_of(self, A: csr_matrix) -> Solver:
        """Return a solver for a matrix of the organ."""
        return solver(A, self.places, self.choice.name)

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)` [m, -, -]."""
        return self.sites.y0

    @property
    def directed(self) -> tuple[bool, ...]:
        """Whether each site was given a direction; empty if unknown."""
        return self.sites.directed

    @property
    def size(self) -> int:
        """Number of free unknowns N."""
        return int(self.K.shape[0])

    def nodal(self, field: Array) -> Array:
        """Return a field over the free unknowns as one vector per node, shape `(m, 3)`."""
        return self.elasticity.nodal(self.whole(field))

    def whole(self, field: Array) -> Array:
        """Return a field over the free unknowns, extended to all of the mesh, shape `(N_all,)`."""
        return self.elasticity.extended(field)


@dataclass(frozen=True)
class Remade:
    """A matrix whose solver is made again for each use, so that no factor is stored."""

    A: csr_matrix
    made: Callable[[csr_matrix], Solver]

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n,)` or `(n, k)`; arguments as of `Solver.solve`."""
        return self.made(self.A).solve(b, guess, rough)


def slips_since(past: Sequence[OrganState], scheme: TimeScheme) -> OrganState:
    """Return the state from which slips are counted.

    It is the newest of the states `past`. In equilibrium it is the oldest one, at which the load
    step began.
    """
    return past[0] if scheme.a else past[-1]


def refuse_loose(body: Elasticity) -> None:
    """Raise `TissueError` if a body without inertia can move as a rigid body."""
    if (motions := rigid_motions(body.points, body.held)).size:
        known = ", ".join(sorted(body.mesh.boundaries or {})) or "none"
        raise TissueError(
            f"clamp: an organ without inertia can still {motions_in_words(motions)} as a rigid body; clamp a boundary, "
            f"put rollers on more of them (the mesh names {known}) or give it inertia in a dynamic run"
        )


class Columns:
    """A compliance `(k, k)` [m/N] whose columns are computed when first needed, in fixed groups.

    Columns are expensive, and only few of the possible pairs touch. The last bits of a column
    depend on the other columns of a solve. Fixed groups make them independent of earlier requests,
    which a resumed run does not repeat.
    """

    def __init__(self, k: int, make: Callable[[Indices], Array], together: int = 1) -> None:
        """Make an empty cache; `make` returns some of the k columns, shape `(k, j)`, always whole
        groups of `together` columns.
        """
        self._make, self._together = make, together
        self._at, self._C = np.full(k, -1), np.zeros((k, 0), order="F")

    def of(self, some: Indices) -> Array:
        """Return the columns of `some` `(j,)`, shape `(k, j)` [m/N]."""
        groups = np.unique(some[self._at[some] < 0] // self._together)
        if groups.size:
            new = (self._together * groups[:, None] + np.arange(self._together)).ravel()
            new = new[new < self._at.size]
            self._at[new] = self._C.shape[1] + np.arange(new.size)
            self._C = np.asfortranarray(np.hstack([self._C, self._make(new)]))
        return self._C[:, self._at[some]]

    def times(self, p: Array) -> Array:
        """Return the compliance times forces p `(k,)` [N], shape `(k,)` [m]."""
        acts = np.flatnonzero(p)
        return np.asarray(self.of(acts) @ p[acts])


@dataclass(frozen=True)
class Operator:
    """A factorised matrix A with W = A⁻¹ Yᵀ and the compliance C = Y W of the sites.

    The compliance of the gaps is computed when first needed.
    """

    organ: MeshedOrgan
    A: csr_matrix
    factor: Solver
    W: Array
    C: Array

    def add_forces(self, U: Array, f_y: Array, p: Array, pairing: Pairing) -> Array:
        """Return U + W f_y + A⁻¹Gᵀ p, shape `(N,)` [m]."""
        U = U + self.W @ f_y
        return U + self.factor.solve(pairing.G.T @ p) if p.any() else U

    def free_values(self, y: Array, g: Array, f_y: Array, p: Array, pairing: Pairing) -> tuple[Array, Array]:
        """Return `y_free` and `g_free` of an answer with y and g under the forces `f_y` and `p`."""
        y = y - self.C @ f_y
        if not g.size:
            return y, g
        C_cy = self.gaps_by_sites(pairing)
        return y - p @ C_cy, g - C_cy @ f_y - self.by_pairs(pairing).times(p)

    def by_pairs(self, pairing: Pairing) -> Columns:
        """Return the gaps by contact forces, G A⁻¹ Gᵀ, `(k, k)` [m/N]."""
        if pairing.facing is None and pairing.points is None:
            return self.C_cc
        S = pairing.sums

        def some_pairs(some: Indices) -> Array:
            weights = S[some]
            rows = np.unique(weights.indices).astype(np.intp)
            return np.asarray(S @ (self.C_rr.of(rows) @ weights[:, rows].toarray().T))

        return Columns(S.shape[0], some_pairs)

    def gaps_by_sites(self, pairing: Pairing) -> Array:
        """Return the gaps by site forces, G W, shape `(k, 9p)`."""
        return np.asarray(pairing.sums @ self.C_ry)

    @cached_property
    def C_cc(self) -> Columns:
        """G A⁻¹ Gᵀ of the pairs of the reference, `(k, k)` [m/N]."""
        return gap_compliance(self.factor, self.organ.pairing(None).G)

    @cached_property
    def C_ry(self) -> Array:
        """R W of the nodes of the lips, shape `(3r, 9p)`."""
        return touching(self.organ.lip_rows, self.W)

    @cached_property
    def C_rr(self) -> Columns:
        """R A⁻¹ Rᵀ of the nodes of the lips, `(3r, 3r)` [m/N].

        It is not needed before a pair has slid.
        """
        return gap_compliance(self.factor, self.organ.lip_rows)


def compliance(factor: Solver, Y: csr_matrix, rough: bool = False) -> tuple[Array, Array]:
    """Return W = A⁻¹ Yᵀ `(N, 9p)` and the exactly symmetric C = Y W `(9p, 9p)`.

    Zero rows of Y belong to frames that do not move, and are not solved for.

    If `rough`, W has an error E, and the residual of the solve corrects C = Y W + Wᵀ(Yᵀ − A W). The
    error of C is then EᵀA E, of second order.
    """
    moving = np.flatnonzero(np.diff(Y.indptr))
    together = [moving[first : first + COLUMNS] for first in range(0, moving.size, COLUMNS)]
    W = np.zeros(Y.shape[::-1], order="F")
    for some in together:
        W[:, some] = factor.solve(Y[some].T.toarray(), rough=rough)
    C = touching(Y, W)
    for some in together if rough else ():
        C[:, some] += W.T @ (Y[some].T.toarray() - factor.A @ W[:, some])
    return W, 0.5 * (C + C.T)


def gap_compliance(factor: Solver, G: csr_matrix, together: int = PAIRS) -> Columns:
    """Return G A⁻¹ Gᵀ, `(k, k)`; `together` is the number of columns per solve."""

    def some_rows(some: Indices) -> Array:
        """Return the columns `some` `(j,)` of whole groups, one group at a time."""
        few = [some[first : first + together] for first in range(0, some.size, together)]
        return np.hstack([touching(G, factor.solve(G[rows].T.toarray())) for rows in few])

    return Columns(G.shape[0], some_rows, together)


def touching(Y: csr_matrix, W: Array) -> Array:
    """Return Y W, shape `(k, j)`, for a matrix Y `(k, N)` with entries in few columns.

    The product in scipy would first copy all of W into another memory order.
    """
    touched = np.unique(Y.indices)
    return np.asarray(Y[:, touched] @ W[touched])
