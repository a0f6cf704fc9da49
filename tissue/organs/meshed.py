"""The organ in the coupled system: nine site variables per piercing, their compliance and one
back-substitution.

    acceleration⁺ = a (U⁺ − U_a),   velocity⁺ = d (U⁺ − U_d),   (a M + d C + K) U⁺ = b + Yᵀ f_y

with two numbers and two reference fields per time scheme; b has gravity and the loads on boundaries
(`tissue.loads`). Backward Euler has a = 1/Δt², U_a = U + Δt V and d = 1/Δt, U_d = U. `f_y` `(9p,)`
is the force on the organ conjugate to y; eliminating U is exact, so that y = y_free + C f_y.

The lips of a wound may be given gaps g = g0 + G U (`tissue.organs.lips`), and forces p that push
them apart:

    A U⁺ = b + Yᵀ f_y + Gᵀ p,   y = y_free + C f_y + C_yc p,   g = g_free + C_cy f_y + C_cc p

Behind the gaps g of all pairs stand two slips since the start of the step of each pair with
friction, and behind their forces p those along them, so that k is the number of both
(`MeshedOrgan.contacts`) where it is not that of the pairs. The columns A⁻¹Gᵀ are not kept: once
those of C_cc that belong to pressed pairs are known, p costs one more back-substitution a step.
Lips that slide are paired anew where a step begins, and G = S R sums the rows R of their nodes by
other weights S: C_cc = S (R A⁻¹ Rᵀ) Sᵀ needs a solve for each number of a node that it has not met
yet.

Points outside may bear on the surface (`tissue.organs.skin`): their rows d·x, with friction their
slips, stand behind those of all pairs. How many points there are may change from step to step, and
a state keeps what they faced.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix, hstack, vstack

from tissue.arrays import Array, Indices
from tissue.elasticity import Elasticity
from tissue.errors import TissueError
from tissue.loads import Loads, SurfaceLoad
from tissue.organs.lips import Gaps, tangents
from tissue.organs.skin import OWN, Skin
from tissue.sites.site import Sites
from tissue.solvers.choice import GIGA, Solver, SolverChoice, choose_solver, solver
from tissue.solvers.memory import free_memory
from tissue.supports import holds_still

KEPT_OPERATORS = 12  # cached operators, if memory allows: of BDF2, of backward Euler, and of each part of a halved step
ROWS_OF_NODE = 3  # one row for each component of the displacement
COLUMNS = 64  # of A⁻¹Gᵀ that are solved for together
SHARE = 0.5  # of the free memory that the compliance of the gaps can take
SLIPPING = 1.0 - 1e-9  # of the largest friction: a pair with at least this friction slips
EMPTY = np.zeros(0)
NO_POINTS = np.zeros((0, OWN))


@dataclass(frozen=True)
class OrganState:
    """Displacement U [m], velocity V [m/s], acceleration A [m/s²] over the free unknowns `(N,)`,
    the site forces, and the contact forces `(k,)` [N], those along the slips with them, None of an
    organ without gaps. `facing` `(pairs, 7)` is where and which way they act on the right lip
    (`tissue.organs.lips.Gaps.facing`), None: on the pairs of the reference. `linearised` `(N,)` [m]
    is where the tangent of a nonlinear organ was last made, which the next step goes on with, None
    of a linear organ. `shares` `(l,)` are the parts of the loads that act (`tissue.loads`), None of
    an organ without loads. `relaxing` is what relaxes, the stresses `(b, 3, 3, q, c)` [Pa]
    (`tissue.relaxation`) or of a linear organ fields `(b, N)` [m] (`tissue.organs.relaxing`), None
    where all has relaxed. `MU` [kg m], `MV` [N s] and `KU` [N] are products `(N,)` of mass and
    stiffness that the step has left, None if it left none. `points` `(j, 9 + l)` is what points
    outside face (`tissue.organs.skin.Skin.faced`), whose forces stand behind those of the pairs;
    None if nothing may bear on the organ. `ahead` `(j, 9 + l)` is the same for the next step.
    """

    U: Array
    V: Array
    A: Array
    f_y: Array
    p: Array | None = None
    facing: Array | None = None
    shares: Array | None = None
    linearised: Array | None = None
    MU: Array | None = None
    MV: Array | None = None
    KU: Array | None = None
    relaxing: Array | None = None
    points: Array | None = None
    ahead: Array | None = None


@dataclass(frozen=True)
class Pairing:
    """The pairing during a step: g = `g0` + `G` U, where G = `sums` R, `(k, 3r)`, of the rows R of
    the lips' nodes, with slips counted from the start of the step.

    `facing` as in a state: None means the pairs of the reference; `points` as in a state.
    """

    G: csr_matrix
    g0: Array
    sums: csr_matrix
    facing: Array | None
    points: Array | None = None


class TimeScheme(Protocol):
    """The coefficients of a time scheme that an organ reads: acceleration a (U − U_a) and velocity
    d (U − U_d).
    """

    @property
    def dt(self) -> float:
        """Length of the step [s], in equilibrium the time since the last equilibrium; infinite
        after complete relaxation.
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
    """Energies at the end of a step and work done during it [J].

    `friction` is the dissipation of contact friction, `prestretch` the energy of a prestretch in
    the reference shape.
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

    Arrays `(pairs,)`: the gaps g [m], the contact forces p that push the surfaces apart [N], and
    the sliding distances since the reference [m]. `friction` `(pairs, 3)` [N] is the friction that
    the left node of each pair exerts on the point that it faces. `slips` `(pairs,)` says whether
    the friction has its largest possible value.
    """

    gap: Array
    force: Array
    slide: Array
    friction: Array
    slips: NDArray[np.bool_]


NO_LIPS = Lips(EMPTY, EMPTY, EMPTY, np.zeros((0, 3)), np.zeros(0, dtype=bool))


class Equation(NamedTuple):
    """The organ's rows of the assembled matrix: A U⁺ = b + Yᵀ f_y + Gᵀ p with y = y0 + Y U and g =
    g0 + G U.
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
    """An answer of sites alone, y = y_free + C f_y; `compliance` is a function that returns C,
    shape (9p, 9p).

    `accepted` makes the organ's state at the end of the step from f_y and p.
    """

    y_free: Array
    compliance: Callable[[], Array]
    accepted: Callable[[Array, Array], Body]

    @property
    def linear(self) -> bool:
        """True: the answer is linear in the forces."""
        return True

    @property
    def C(self) -> Array:
        """Site compliance, shape `(9p, 9p)`."""
        return self.compliance()

    @property
    def g_free(self) -> Array:
        """No gaps, shape `(0,)`."""
        return EMPTY

    @property
    def C_cy(self) -> Array:
        """No gaps, shape `(0, 9p)`."""
        return np.zeros((0, self.y_free.size))

    def gaps_by_forces(self, some: Indices) -> Array:
        """No gaps, shape `(0, 0)`."""
        return np.zeros((0, 0))

    @property
    def friction(self) -> Array:
        """No pairs, shape `(0,)`."""
        return EMPTY

    @property
    def points(self) -> Array:
        """No points, shape `(0, 9)`."""
        return NO_POINTS

    def accept(self, f_y: Array, p: Array = EMPTY) -> Body:
        """Return the state at the end of the step."""
        return self.accepted(f_y, p)

    def again(self, f_y: Array, p: Array) -> "SiteAnswer[Body]":
        """Return itself: the answer is linear."""
        return self


@dataclass(frozen=True)
class LinearAnswer:
    """The answer of a meshed organ: `y_free` (9p,), `g_free` (k,) [m] and its factored operator.

    `accepted` makes the state at the end of the step from f_y and p. `right_hand_side` makes b of
    the organ's equation. `pairing` is the pairing of the lips during the step.
    """

    operator: "LipCompliance"
    y_free: Array
    g_free: Array
    accepted: Callable[[Array, Array], OrganState]
    right_hand_side: Callable[[], Array]
    pairing: Pairing

    @property
    def linear(self) -> bool:
        """True: the answer is linear in the forces."""
        return True

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
        """What points outside face, shape `(j, 9 + l)`."""
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
    """Common part of dynamic and quasi-static organs: the body, its sites and the blocks over the
    free unknowns.
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
    G: csr_matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        gravity = np.asarray(self.gravity, dtype=float)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise TissueError(f"gravity = {self.gravity}: allowed are three finite numbers [m/s²]")
        body, free = self.elasticity, self.elasticity.free
        if self.sites.Y.shape[1] != free.size:
            raise TissueError(
                f"sites over {self.sites.Y.shape[1]} unknowns on an organ of {free.size}; build them on it"
            )
        places = body.basis.doflocs[:, free].T
        K = csr_matrix(body.K[free][:, free])
        K.eliminate_zeros()  # removes a fifth of the entries of a block
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "Y", self.sites.Y)
        object.__setattr__(self, "load", body.body_force(gravity)[free])
        object.__setattr__(self, "surface", Loads(body, tuple(self.loads)))
        object.__setattr__(self, "surface_load", self.surface.columns[free])
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "choice", choose_solver(self.solver, K, places, self.solved_once))
        object.__setattr__(self, "G", self._gap_rows())

    def _gap_rows(self) -> csr_matrix:
        """Return G, shape `(k, N)`; refuse gaps whose compliance does not fit into memory."""
        N = self.elasticity.free.size
        if self.gaps is None:
            return csr_matrix((0, N))
        k, room = self.contacts, SHARE * free_memory()
        need = 8.0 * ((KEPT_OPERATORS + 2) * k**2 + COLUMNS * N)
        if self.gaps.G.shape[1] != N:
            raise TissueError(f"gaps over {self.gaps.G.shape[1]} unknowns on an organ of {N}; build them on it")
        if need > room:
            raise TissueError(
                f"contact: the {self.pairs} pairs of nodes on the lips take about {need / GIGA:.2g} GB and "
                f"{room / GIGA:.2g} GB are available; take a coarser mesh at the lips, or leave out contact"
            )
        G = self.gaps.G
        if k > self.pairs:
            G = vstack([G, self.gaps.slip_sums(self.gaps.start) @ self.gaps.rows])
        return G

    @property
    def pairs(self) -> int:
        """Number of pairs of nodes on the lips that can touch; 0 without gaps."""
        return 0 if self.gaps is None else len(self.gaps.g0)

    @property
    def touches(self) -> bool:
        """Whether surfaces of the organ may touch, one another or what is outside."""
        return self.gaps is not None or self.skin is not None

    @property
    def contacts(self) -> int:
        """Number of contact forces of pairs: one for each, and two more for each of those with
        friction.
        """
        return 0 if self.gaps is None else self.pairs + 2 * self.gaps.rough.size

    def friction(self, facing: Array | None) -> Array:
        """Return friction over contact force of each slipping pair, `(pairs,)` [-].

        p acts along the vector d of the facing, and the force normal to the surface is |d| p.
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
        """R, the displacement of the nodes of surfaces that may touch over all unknowns, shape
        `(3r, N)`: those of the lips, then those of the skin.
        """
        rows = [surface.rows for surface in (self.gaps, self.skin) if surface is not None]
        return csr_matrix(vstack(rows)) if rows else csr_matrix((0, self.size))

    @cached_property
    def _matched(self) -> Pairing:
        """The pairs of the reference."""
        if self.gaps is None:
            return Pairing(self.G, self.g0, csr_matrix((0, self.lip_rows.shape[0])), None)
        return Pairing(self.G, self.with_slips(self.g0), self._sums(self.gaps, self.gaps.start), None)

    def _sums(self, gaps: Gaps, facing: Array) -> csr_matrix:
        """Return gaps and slips by the displacement of the nodes of `lip_rows`, shape `(k, 3r)`."""
        sums = gaps.sums(facing)
        sums = csr_matrix(vstack([sums, gaps.slip_sums(facing)])) if gaps.rough.size else sums
        return hstack([sums, csr_matrix((sums.shape[0], self.lip_rows.shape[0] - sums.shape[1]))], format="csr")

    def with_slips(self, g: Array) -> Array:
        """Return gaps `(pairs,)` followed by slips of zero, shape `(k,)` [m]."""
        return np.append(g, np.zeros(self.contacts - self.pairs)) if self.contacts > self.pairs else g

    def pairing(self, facing: Array | None, points: Array | None = None) -> Pairing:
        """Return the gaps of the pairs and of the `points` outside, and the slips since the
        reference.
        """
        pairing = self._matched
        if self.gaps is not None and facing is not None:
            sums = self._sums(self.gaps, facing)
            pairing = Pairing(csr_matrix(sums @ self.lip_rows), self.with_slips(self.gaps.rest(facing)), sums, facing)
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
        """Return the pairing under a displacement of the free unknowns `(N,)`, of the lips anew."""
        facing, body = None, self.elasticity
        if self.gaps is not None:
            facing = self.gaps.facing(body.points, body.nodal(self.whole(U)))
        return self.slipping_from(U, self.pairing(facing, points))

    @property
    def finest(self) -> float:
        """Smallest height of a facet that points outside may bear on [m]."""
        assert self.skin is not None
        return self.skin.finest

    def faced(self, state: OrganState, places: Array, labels: Array) -> Array:
        """Return what points outside at `places` `(j, 3)` [m], with `labels` `(j, l)`, face, shape
        `(j, 9 + l)`.
        """
        assert self.skin is not None
        return self.skin.faced(self.elasticity.nodal(self.whole(self.field(state))), places, labels)

    def touched(self, state: OrganState, points: Array) -> OrganState:
        """Return the state in front of a step in which points outside face `points` `(j, 9 + l)`."""
        return replace(state, ahead=points)

    def field(self, state: OrganState) -> Array:
        """Return the displacement over the free unknowns, shape `(N,)` [m]."""
        return state.U

    def gaps_of(self, state: OrganState) -> Array:
        """Return the gaps and slips of all pairs, and behind them those of points outside, of a
        state, `(k,)` [m].
        """
        pairing = self.pairing_of(state)
        return np.asarray(pairing.g0 + pairing.G @ state.U)

    def touching_points(self, state: OrganState) -> tuple[Array, Array]:
        """Return what points outside faced in the step to a state, `(j, 9 + l)`, and their forces
        on the organ along d, with friction those along both tangents of each behind them, `(j,)` or
        `(3j,)` [N].
        """
        if state.points is None:
            return NO_POINTS, EMPTY
        return state.points, self.contact_forces(state)[self.contacts :]

    def slipping_from(self, U: Array, pairing: Pairing) -> Pairing:
        """Return the pairing with its slips counted from a displacement of the free unknowns
        `(N,)`.
        """
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
        """Return how far each pair of the lips has slid under a displacement of the free unknowns,
        shape `(pairs,)` [m].
        """
        return EMPTY if self.gaps is None else self.gaps.slides(self.elasticity.nodal(self.whole(U)))

    def contact_forces(self, state: OrganState) -> Array:
        """Return p, shape `(k,)` [N]."""
        return EMPTY if state.p is None else state.p

    def rubbing(self, state: OrganState) -> tuple[Array, NDArray[np.bool_]]:
        """Return the friction of each pair's left node on its facing point, `(pairs, 3)` [N], and
        whether it slips, `(pairs,)`.
        """
        out, p = np.zeros((self.pairs, 3)), self.contact_forces(state)
        if self.gaps is None or not self.gaps.rough.size:
            return out, np.zeros(self.pairs, dtype=bool)
        facing = self.gaps.start if state.facing is None else state.facing
        rough = self.gaps.rough
        along = p[self.pairs : self.contacts].reshape(-1, 2)
        out[rough] = np.einsum("mt,mtx->mx", along, tangents(facing[rough, 4:]))
        bound = self.friction(state.facing) * p[: self.pairs]
        return out, (bound > 0.0) & (np.linalg.norm(out, axis=1) >= SLIPPING * bound)

    def slipping_surfaces(self, state: OrganState) -> dict[str, bool]:
        """Return by name whether each pressed contact surface with friction slips as a whole.

        A surface slips as a whole if all of its pressed pairs slip. Surfaces without pressed pairs
        are not included.
        """
        if self.gaps is None or not self.gaps.rough.size:
            return {}
        pressed, slips = self.contact_forces(state)[: self.pairs] > 0.0, self.rubbing(state)[1]
        own = zip(self.gaps.parts, self.gaps.slices, strict=True)
        there = [(part.name, at) for part, at in own if part.friction and pressed[at].any()]
        return {name: bool(slips[at][pressed[at]].all()) for name, at in there}

    def contact_works(self, p: Array, ways: Array) -> tuple[float, float]:
        """Return the energies that contact forces `(k,)` dissipate: numerical −p·Δg, and friction
        [J].

        `ways` `(k,)` [m] are the changes of the gaps and slips. The part −p·Δg counts as
        dissipation of the time integrator.
        """
        works, rubs = -p * ways, np.zeros(len(p), dtype=bool)
        points = (len(p) - self.contacts) // (3 if self.skin is not None and self.skin.friction else 1)
        rubs[self.pairs : self.contacts] = rubs[self.contacts + points :] = True
        return float(works[~rubs].sum()), float(works[rubs].sum())

    def shares_at(self, time: float, share: float) -> Array | None:
        """Return the parts of the loads that act at `time` [s], or at a `share` of the load steps;
        None without loads.
        """
        return self.surface.shares(time, share) if self.surface.each else None

    @property
    def no_shares(self) -> Array | None:
        """Zero parts of all loads, `(l,)`; None without loads."""
        return np.zeros(len(self.surface.each)) if self.surface.each else None

    def load_under(self, shares: Array | None) -> Array:
        """Return the forces of gravity and of the given parts of the loads `(l,)`, shape `(N,)`
        [N].
        """
        return self.load if shares is None else self.load + self.surface_load @ shares

    def load_resultants(self, state: OrganState) -> Array:
        """Return the sum of the forces of each whole load, `(l, 3)` [N]; in a linear organ the
        forces keep their direction.
        """
        return self.surface.resultants

    def contact_or_none(self, p: Array) -> Array | None:
        """Return the contact forces `(k,)` for a state, or None without gaps."""
        return p if self.touches else None

    @property
    def no_contact(self) -> Array | None:
        return self.contact_or_none(np.zeros(self.contacts))

    @property
    def solved_once(self) -> bool:
        """Whether the organ only ever solves for the columns of the sites and for the load."""
        return False

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

    def whole(self, field: Array) -> Array:
        """Return a field over the free unknowns as one over all unknowns of the mesh, shape
        `(N_all,)`.
        """
        return self.elasticity.extended(field)


@dataclass(frozen=True)
class Remade:
    """A matrix whose solver is rebuilt for each use, so that it needs no memory in between."""

    A: csr_matrix
    made: Callable[[csr_matrix], Solver]

    def solve(self, b: Array, guess: Callable[[], Array] | None = None, rough: bool = False) -> Array:
        """Return A⁻¹ b for b of shape `(n,)` or `(n, k)`; `guess` and `rough` as for any solver."""
        return self.made(self.A).solve(b, guess, rough)


def slips_since(past: Sequence[OrganState], scheme: TimeScheme) -> OrganState:
    """Return the state from which slips are counted: the newest one, or in equilibrium the oldest
    one.

    In equilibrium, the oldest of the states `past` is the one at which the load step began.
    """
    return past[0] if scheme.a else past[-1]


def refuse_loose(body: Elasticity) -> None:
    """Raise `TissueError` if a body without inertia can move as a rigid body."""
    if not holds_still(body.points, np.isin(body.nodes, body.clamped)):
        known = ", ".join(sorted(body.mesh.boundaries or {})) or "none"
        raise TissueError(
            f"clamp: a quasi-static organ that can move as a rigid body is singular; clamp a boundary (the mesh "
            f"names {known}) or give it inertia"
        )


class Columns:
    """A compliance `(k, k)` [m/N] whose columns are computed when first needed.

    Columns are expensive, and only few of the possible pairs touch.
    """

    def __init__(self, k: int, make: Callable[[Indices], Array]) -> None:
        """`make` returns some of the k columns, shape `(k, j)`."""
        self._make, self._at, self._C = make, np.full(k, -1), np.zeros((k, 0), order="F")

    def of(self, some: Indices) -> Array:
        """Return the columns of `some` `(j,)`, shape `(k, j)` [m/N]."""
        new = np.unique(some[self._at[some] < 0])
        if new.size:
            self._at[new] = self._C.shape[1] + np.arange(new.size)
            self._C = np.asfortranarray(np.hstack([self._C, self._make(new)]))
        return self._C[:, self._at[some]]

    def times(self, p: Array) -> Array:
        """Return the compliance times forces p `(k,)` [N], shape `(k,)` [m]."""
        acts = np.flatnonzero(p)
        return np.asarray(self.of(acts) @ p[acts])


class LipCompliance:
    """The compliance of the gaps, computed when first needed."""

    organ: MeshedOrgan
    A: csr_matrix
    factor: Solver
    W: Array
    C: Array

    def free_values(self, y: Array, g: Array, f_y: Array, p: Array, pairing: Pairing) -> tuple[Array, Array]:
        """Return `y_free` and `g_free` of an answer that has y and g under the forces `f_y` and
        `p`.
        """
        y = y - self.C @ f_y
        if not g.size:
            return y, g
        C_cy = self.gaps_by_sites(pairing)
        return y - p @ C_cy, g - C_cy @ f_y - self.by_pairs(pairing).times(p)

    def by_pairs(self, pairing: Pairing) -> Columns:
        """Return G A⁻¹ Gᵀ, gaps by contact forces, `(k, k)` [m/N]."""
        if pairing.facing is None and pairing.points is None:
            return self.C_cc
        S = pairing.sums

        def some_pairs(some: Indices) -> Array:
            weights = S[some]
            rows = ROWS_OF_NODE * np.unique(weights.indices // ROWS_OF_NODE)[:, None] + np.arange(ROWS_OF_NODE)
            whole = rows.ravel()  # of whole nodes
            return np.asarray(S @ (self.C_rr.of(whole) @ weights[:, whole].toarray().T))

        return Columns(S.shape[0], some_pairs)

    def gaps_by_sites(self, pairing: Pairing) -> Array:
        """Return G W, gaps by site forces, shape `(k, 9p)`."""
        return np.asarray(pairing.sums @ self.C_ry)

    @cached_property
    def C_cc(self) -> Columns:
        """G A⁻¹ Gᵀ of the pairs of the reference, `(k, k)` [m/N]."""
        return gap_compliance(self.factor, self.organ.G)

    @cached_property
    def C_ry(self) -> Array:
        """R W of the nodes of the lips, shape `(3r, 9p)`."""
        return touching(self.organ.lip_rows, self.W)

    @cached_property
    def C_rr(self) -> Columns:
        """R A⁻¹ Rᵀ of the nodes of the lips, `(3r, 3r)` [m/N]; not needed before a pair has slid.

        Columns are solved node by node, so that a resumed run, which asks for other nodes together,
        has equal bits.
        """
        return gap_compliance(self.factor, self.organ.lip_rows, together=ROWS_OF_NODE)


def compliance(factor: Solver, Y: csr_matrix, rough: bool = False) -> tuple[Array, Array]:
    """Return W = A⁻¹ Yᵀ `(N, 9p)` and C = Y W `(9p, 9p)`, which is exactly symmetric.

    Rows of zeros in Y, which belong to frames that do not move, are not solved for.

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


def gap_compliance(factor: Solver, G: csr_matrix, together: int = COLUMNS) -> Columns:
    """Return G A⁻¹ Gᵀ `(k, k)`, whose columns are solved so many `together`."""

    def some_rows(some: Indices) -> Array:
        """Return the columns, computed a few at a time."""
        few = [some[first : first + together] for first in range(0, some.size, together)]
        return np.hstack([touching(G, factor.solve(G[rows].T.toarray())) for rows in few])

    return Columns(G.shape[0], some_rows)


def touching(Y: csr_matrix, W: Array) -> Array:
    """Return Y W, shape `(k, j)`, for a matrix Y `(k, N)` with entries in few columns.

    The product of scipy would first copy all of W into another memory order.
    """
    touched = np.unique(Y.indices)
    return np.asarray(Y[:, touched] @ W[touched])
