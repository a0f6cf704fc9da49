"""What the coupling asks of an organ: nine numbers per piercing, and how they answer to forces.

`y`, shape `(9p,)`, holds per piercing the point x [m] and the frame vectors u, v [-]. `f_y`, shape `(9p,)`, is the
generalized force on the organ conjugate to y, Φ_yᵀλ. Where the lips of a wound may touch, `g`, shape `(k,)` [m], are
the gaps of their pairs and `p`, shape `(k,)` [N], the contact forces that push them apart; k = 0 without such lips.
Behind those of all pairs stand two slips since the start of the step for each pair with friction, in the order of the
pairs, and the forces along them, so that k is then more than the number of pairs.

The state of an organ's body, of type `Body`, is the organ's own: the coupling keeps it, hands it back, and never looks
into it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

from coupling.arrays import Array, Flags, Indices
from coupling.integrators import Scheme

Body = TypeVar("Body")

# Kinetic and elastic energy at the end of a step, and what was done during it [J]: the work of weight and loads, what
# viscous damping took, what the integrator took (contact's −p⁺·Δg with it), what surfaces that rub took,
# and what a prestretch stores [J].
OrganEnergies = tuple[float, float, float, float, float, float, float]
# Of an organ without inertia: its elastic energy under weight and loads alone [J], the way that these move the sites
# and the forces that the sites bear [N, N m], `(9p,)` each.
SteadyLoads = tuple[float, Array, Array]
# Of an organ by modes of stiffness one, of which the first r answer and the others check them: masses and loads (n,),
# its way by the site forces in a step W (n, 9p), Y (9p, r), y0 (9p,), what the others leave open (k, n − r), Rayleigh's
# α [1/s] and β [s]; where all answer, what these leave open (k, n), and as what part of the largest forces and by what
# round-off [√J] that may be, else zeros. And its motion: η, η̇, η̈ (n,), the forces on the sites (9p,), and what the
# check left open so far, or the largest forces.
Modes = tuple[Array, Array, Array, Array, Array, Array, float, float, float, float]
ModalMotion = tuple[Array, Array, Array, Array, float]
# Of each pair that may touch: its gap g [m], its contact force p [N] and how far it has slid since the reference [m],
# shape `(pairs,)` each, the friction of its node on what that faces, `(pairs, 3)` [N], and whether that slips.
Lips = tuple[Array, Array, Array, Array, Flags]


class Answer(Protocol[Body]):
    """The organ condensed for one iteration of a step: y = y_free + C f_y + C_cyᵀ p, g = g_free + C_cy f_y + C_cc p."""

    @property
    def linear(self) -> bool:
        """Whether the answer stands under all forces, so that `again` returns itself."""

    @property
    def y_free(self) -> Array:
        """Site variables without site and contact forces, shape `(9p,)`."""

    @property
    def C(self) -> Array:
        """Site compliance, symmetric, shape `(9p, 9p)`."""

    @property
    def g_free(self) -> Array:
        """Gaps without site and contact forces, shape `(k,)` [m]."""

    @property
    def C_cy(self) -> Array:
        """Gaps by site forces, shape `(k, 9p)`."""

    def gaps_by_forces(self, some: Indices) -> Array:
        """Return the columns of C_cc of `some` pairs `(j,)`, shape `(k, j)` [m/N]; C_cc is symmetric to what a solver
        leaves, and positive definite. Each is expensive when first asked for."""

    @property
    def friction(self) -> Array:
        """Friction over contact force of each pair that slips, shape `(pairs,)` [-]."""

    @property
    def points(self) -> Array:
        """What points of the thread face, shape `(j, 9 + l)`, as `Bearing.faced` found it; their gaps, without the
        thread's part, and with friction their slips stand behind those of the pairs."""

    def accept(self, f_y: Array, p: Array) -> Body:
        """Return the organ's state at the end of the step under the forces `f_y` (9p,) and `p` (k,)."""

    def again(self, f_y: Array, p: Array) -> "Answer[Body]":
        """Return the answer linearised anew under the forces `f_y` (9p,) and `p` (k,).

        An answer that stands under these forces returns itself: a linear organ's always does, that of a nonlinear
        organ once its own equations hold to their tolerance. Raises `tissue.OrganError` where the organ has no
        answer.
        """


class Organ(Protocol[Body]):
    """An elastic organ, or none, as the coupling sees it."""

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)`."""

    def start(self) -> Body:
        """Return the state at the start of a run."""

    def answer(self, scheme: Scheme, past: Sequence[Body], time: float, share: float = 1.0) -> Answer[Body]:
        """Return the answer of a step of `scheme` from the states `past`, the newest first. Loads that are ramped are
        those at `time` [s], times `share`. In equilibrium slips are counted from the last of `past`."""

    def site_variables(self, state: Body) -> Array:
        """Return y, shape `(9p,)`."""

    def lips(self, state: Body) -> Lips:
        """Return the gaps, forces, ways and friction of the pairs."""

    def energies(self, old: Body, new: Body) -> OrganEnergies:
        """Return the energies at `new`, and what was done on the way from `old` [J]."""

    def impulse(self, state: Body) -> Answer[Body] | None:
        """Return the answer to an impulse on the sites [N s, N m s]: `y_free` is dy/dt, and C is Y M⁻¹ Yᵀ.

        None stands for an organ without mass, which takes no impulse.
        """

    def displace(self, scheme: Scheme, state: Body, y: Array, f_y: Array) -> Answer[Body]:
        """Return the answer of a step in which nothing moves from `y` (9p,) as long as the site forces are `f_y` (9p,)
        and the contact forces those of `state`; velocities are kept."""


class FrictionLaw(Protocol):
    """Friction of a hole as functions of the force N ≥ 0 [N] that presses the thread on it, finite at N = 0.

    It adds to Coulomb's, and it does not know how fast the thread slides.
    """

    def static(self, N: float) -> float:
        """Return the largest force along the thread that holds it [N]."""

    def kinetic(self, N: float) -> float:
        """Return the force along the thread that slides [N], no more than the static one."""

    def slope(self, N: float) -> float:
        """Return the derivative of the kinetic force by N [-]."""


@runtime_checkable
class Creeping(Protocol):
    """What a nonlinear organ may offer besides: a way past loads under which no equilibrium is near."""

    def creep(self, state: Any, time: float, share: float, pace: float) -> Answer[Any]:
        """Return the answer of an organ that is dragged back to a `state` on its way downhill to its equilibrium under
        `share` of the loads at `time` [s]: by a `pace` of 1 hardly lets it go, 0 does not hold it. Raises
        `tissue.OrganError`."""

    def under(self, answer: Answer[Any], time: float, share: float) -> Answer[Any]:
        """Return an answer of its own under another `share` of the loads at `time` [s], where it is."""

    def holds(self, answer: Answer[Any]) -> bool:
        """Whether the organ would stay where an answer of its own stands, under dead forces."""

    def has_jumped(self, answer: Answer[Any], old: Any, new: Any) -> bool:
        """Whether a `new` state at rest, where an answer of its own stands, lies beyond a barrier of energy from an
        `old` one and not on its branch."""


@runtime_checkable
class Floats(Protocol):
    """What an organ may say besides at rest: a body of it may be held by nothing but thread and contact."""

    def dragged(self, state: Any) -> float:
        """Return by how much of the forces on it the organ is still dragged towards where it was; zero in
        equilibrium."""


@runtime_checkable
class Bearing(Protocol):
    """What an organ may say besides: the thread bears on its surface."""

    @property
    def finest(self) -> float:
        """Smallest height of a facet of the surface [m]."""

    def faced(self, state: Any, places: Array, labels: Array) -> Array:
        """Return what points of the thread at `places` `(j, 3)` [m], with `labels` `(j, l)`, face in a state, shape
        `(j, 9 + l)`: facet, barycentric coordinates there, the unit vector into the organ, the distance and the
        bulge of the surface over the facet [m], and the labels."""

    def touched(self, state: Any, points: Array) -> Any:
        """Return the state in front of a step in which points of the thread face `points` `(j, 9 + l)`."""

    def touching_points(self, state: Any) -> tuple[Array, Array]:
        """Return what points faced in the step to a state, `(j, 9 + l)`, and their forces on the organ, with friction
        those along both tangents of each behind them, `(j,)` or `(3j,)` [N]."""


@runtime_checkable
class Rubs(Protocol):
    """What an organ may say besides: how its surfaces rub on one another."""

    def slipping_surfaces(self, state: Any) -> Mapping[str, bool]:
        """Return by name the surfaces with friction that press on one another, and whether they slip as a whole."""


@runtime_checkable
class Steady(Protocol):
    """What a linear organ without inertia may say besides: that nothing but the site forces changes for a while."""

    def steady_loads(self, state: Any, times: Sequence[float]) -> SteadyLoads | None:
        """Return what a state has of loads; None where those at the `times` [s] are others, or surfaces may touch."""


@runtime_checkable
class Modal(Protocol):
    """What a linear organ with inertia may say besides: that it goes on by modes alone."""

    def modes(self, scheme: Scheme, state: Any, times: Sequence[float]) -> Modes | None:
        """Return what steps of a scheme read of it; None where the loads at the `times` [s] are not those of a
        state."""

    def motion(self, state: Any, like: Any) -> ModalMotion:
        """Return the motion of a state by the modes of a later one."""

    def moved(self, state: Any, motion: ModalMotion) -> Any:
        """Return the state of a `motion` under the loads of another."""


@runtime_checkable
class Certified(Protocol):
    """What the answer of a linear organ may offer besides: it stands for the organ in a space, under some forces."""

    def certified(self, f_y: Array) -> Answer[Any]:
        """Return the answer that holds for the whole organ under the forces `f_y` (9p,) of a solved step: itself, or
        that of a wider space or of the whole organ."""

    def faithful(self) -> Answer[Any]:
        """Return the answer that is the whole organ's under all forces, for a step without a solution: as for one."""


@runtime_checkable
class KnowsDirections(Protocol):
    """What an organ may say besides: which of its sites were given a direction."""

    @property
    def directed(self) -> tuple[bool, ...]:
        """Whether each site was given a direction; empty where that is not known."""
