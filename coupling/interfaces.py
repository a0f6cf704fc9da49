"""The coupling's interface of an organ: nine numbers per piercing, and their answer to forces.

`y`, shape `(9p,)`, has for each piercing the point x [m] and the frame vectors u, v [-]. `f_y`,
shape `(9p,)`, is the generalised force on the organ conjugate to y, Φ_yᵀλ. If the lips of a wound
may touch, `g`, shape `(k,)` [m], are the gaps of their pairs and `p`, shape `(k,)` [N], the contact
forces that push them apart; k = 0 without such lips. For each pair with friction, g has two slips
since the start of the step after the gaps of all pairs, in the order of the pairs, and p has the
forces along them. k is then larger than the number of pairs.

The state of an organ's body, of type `Body`, belongs to the organ: the coupling stores it and
returns it, and never reads it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

from coupling.arrays import Array, Indices
from tissue.organs.meshed import Lips, OrganEnergies, TimeScheme
from tissue.organs.modal import ModalArrays

Body = TypeVar("Body")

# For an organ without inertia: its elastic energy under weight and loads alone [J], the displacement of the sites by
# these, and the forces on the sites [N, N m], `(9p,)` each.
SteadyLoads = tuple[float, Array, Array]
# The motion of an organ in modes (`ModalArrays`): η, η̇, η̈ (n,), the forces on the sites (9p,), and the largest forces
# so far.
ModalMotion = tuple[Array, Array, Array, Array, float]


class Answer(Protocol[Body]):
    """The organ condensed for one iteration of a step: y = y_free + C f_y + C_cyᵀ p, g = g_free +
    C_cy f_y + C_cc p.
    """

    @property
    def linear(self) -> bool:
        """Whether the answer is valid under all forces, so that `again` returns itself."""

    @property
    def far(self) -> bool:
        """Whether a correction of the organ was shortened to less than a quarter, or prolonged, since the
        start of the step.
        """

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
        """Return the columns of C_cc of `some` pairs `(j,)`, shape `(k, j)` [m/N].

        C_cc is positive definite, and symmetric up to the residual of a solver. Each column is
        expensive at its first call.
        """

    @property
    def friction(self) -> Array:
        """Ratio of friction to contact force of each pair that slips, shape `(pairs,)` [-]."""

    @property
    def points(self) -> Array:
        """The facing data of points of the thread, shape `(j, 9 + l)`, from `Bearing.faced`.

        Their gaps, without the thread's part, and with friction their slips follow those of the
        pairs.
        """

    def accept(self, f_y: Array, p: Array) -> Body:
        """Return the organ's state at the end of the step under the forces `f_y` (9p,) and `p` (k,).

        Raises `tissue.OrganError` if a cell of a nonlinear organ is inverted there.
        """

    def again(self, f_y: Array, p: Array) -> "Answer[Body]":
        """Return the answer linearised again under the forces `f_y` (9p,) and `p` (k,).

        An answer that is valid under these forces returns itself. That of a linear organ always
        does; that of a nonlinear organ does when its own equations hold to their tolerance. Raises
        `tissue.OrganError` if the organ has no answer.
        """


class Organ(Protocol[Body]):
    """An elastic organ, or a set of fixed sites, as the coupling uses it."""

    @property
    def y0(self) -> Array:
        """Reference site variables, shape `(9p,)`."""

    def start(self) -> Body:
        """Return the state at the start of a run."""

    def answer(self, scheme: TimeScheme, past: Sequence[Body], time: float, share: float = 1.0) -> Answer[Body]:
        """Return the answer for a step of `scheme` from the states `past`, newest first.

        Ramped loads are those at `time` [s], times `share`. In equilibrium slips are counted from
        the last of `past`.
        """

    def site_variables(self, state: Body) -> Array:
        """Return y, shape `(9p,)`."""

    def lips(self, state: Body) -> Lips:
        """Return the gaps, forces, slips and friction of the pairs."""

    def energies(self, old: Body, new: Body) -> OrganEnergies:
        """Return the energies at `new`, and the works on the way from `old` [J]."""

    def impulse(self, state: Body) -> Answer[Body] | None:
        """Return the answer to an impulse on the sites [N s, N m s]: `y_free` is dy/dt, and C is Y M⁻¹ Yᵀ.

        None for an organ without mass, which takes no impulse.
        """

    def displace(self, scheme: TimeScheme, state: Body, y: Array, f_y: Array) -> Answer[Body]:
        """Return the answer of a step without motion from `y` (9p,) under the site forces `f_y` (9p,).

        The contact forces are those of `state`; velocities do not change.
        """


class FrictionLaw(Protocol):
    """Friction of a hole as functions of the force N ≥ 0 [N] that presses the thread on it, finite at N = 0.

    It is added to Coulomb's law and does not depend on the sliding speed.
    """

    def static(self, N: float) -> float:
        """Return the largest force along the thread at which it sticks [N]."""

    def kinetic(self, N: float) -> float:
        """Return the force along the sliding thread [N], at most the static one."""

    def slope(self, N: float) -> float:
        """Return the derivative of the kinetic force by N [-]."""


@runtime_checkable
class Snapping(Protocol):
    """Optional members of a nonlinear organ: round-off, and a way past loads without a close equilibrium."""

    @property
    def rounded_energy(self) -> float:
        """Round-off of its elastic energy [J]."""

    def under(self, answer: Answer[Any], time: float, share: float) -> Answer[Any]:
        """Return an `answer` of this organ for another `share` of the loads at `time` [s], at the same place."""

    def holds(self, answer: Answer[Any]) -> bool:
        """Return whether the organ is stable under dead forces at the place of its own `answer`."""

    def off_saddle(self, answer: Answer[Any], state: Any) -> tuple[Any, Any]:
        """Return an unstable `state` at the place of its `answer`, moved to both sides along a motion
        with negative stiffness.
        """

    def distance(self, one: Any, other: Any) -> float:
        """Return the largest difference of the displacements of two states [m]."""

    def has_jumped(self, answer: Answer[Any], old: Any, new: Any) -> bool:
        """Return whether a `new` state at rest is on another branch than an `old` one, beyond an
        energy barrier.

        `answer` is the organ's own, at the new state.
        """


@runtime_checkable
class Floats(Protocol):
    """Optional members of an organ at rest: one of its bodies may be held only by thread and contact."""

    def dragged(self, state: Any) -> float:
        """Return the ratio of the drag towards the last place to the forces on the organ; zero in equilibrium."""


@runtime_checkable
class Bearing(Protocol):
    """Optional members of an organ: the thread bears on its surface."""

    @property
    def finest(self) -> float:
        """Smallest height of a facet of the surface [m]."""

    def faced(self, state: Any, places: Array, labels: Array, before: Any = None, ratio: float = 0.0) -> Array:
        """Return the facing data of points of the thread in a state, shape `(j, 9 + l)`.

        The surface is moved on by `ratio` times its way since the state `before`; None means that it
        stays.

        The points are at `places` `(j, 3)` [m] and have `labels` `(j, l)`. The columns are: facet,
        barycentric coordinates in it, d, which points into the organ and is minus the gradient of
        the distance, the distance, d·(x − P) minus the distance [m], and the labels.
        """

    def touched(self, state: Any, points: Array) -> Any:
        """Return the state at the start of a step in which points of the thread face `points` `(j, 9 + l)`."""

    def touching_points(self, state: Any) -> tuple[Array, Array]:
        """Return the facing data of points in the step to a state, `(j, 9 + l)`, and their forces
        on the organ [N].

        The forces have shape `(j,)`; with friction they are followed by those along both tangents
        of each point, `(3j,)`.
        """


@runtime_checkable
class Paired(Protocol):
    """Optional members of an organ: its surfaces are paired, and the pairs change as they slide."""

    def paired_nearer(self, last: Any, now: Any) -> Any:
        """Return the equilibrium `now`, whose pairs are those after the state `last`, with pairs closer to its own."""


@runtime_checkable
class Rubs(Protocol):
    """Optional members of an organ: friction between its surfaces."""

    def slipping_surfaces(self, state: Any) -> Mapping[str, bool]:
        """Return by name, for each pressed surface with friction, whether it slips as a whole."""


@runtime_checkable
class Steady(Protocol):
    """Optional members of a linear organ without inertia: only the site forces change for a while."""

    def steady_loads(self, state: Any, times: Sequence[float]) -> SteadyLoads | None:
        """Return the loads of a state; None if the loads change until one of the `times` [s], or if
        surfaces may touch.
        """


@runtime_checkable
class Modal(Protocol):
    """Optional members of a linear organ with inertia: its motion is in modes."""

    def modes(self, scheme: TimeScheme, state: Any, times: Sequence[float]) -> ModalArrays | None:
        """Return the data of the modes for steps of a scheme; None if the loads at the `times` [s]
        are not those of the state.
        """

    def motion(self, state: Any, like: Any) -> ModalMotion:
        """Return the motion of a state in the modes of a later one."""

    def moved(self, state: Any, motion: ModalMotion) -> Any:
        """Return the state of a `motion` under the loads of another state."""


@runtime_checkable
class Certified(Protocol):
    """Optional members of the answer of a linear organ in a smaller space, which is accurate under
    some forces only.
    """

    def certified(self, f_y: Array) -> Answer[Any]:
        """Return an answer that is accurate for the whole organ under the forces `f_y` (9p,) of a solved step.

        It is the answer itself, or that of a larger space or of the whole organ.
        """

    def faithful(self) -> Answer[Any]:
        """Return the answer of the whole organ, accurate under all forces, for a step without a solution."""


@runtime_checkable
class KnowsDirections(Protocol):
    """Optional members of an organ: which of its sites have a given direction."""

    @property
    def directed(self) -> tuple[bool, ...]:
        """Whether each site has a given direction; empty if this is unknown."""
