"""The closed forms for comparison with the studies.

*Friction* at a hole, of a bending thread, and around a capstan. *Strips and sheets* of exponential
tissue. *Two holes of an elastic half-space*: their displacements under tensions, and the stress
around them. A hole on the surface is a disc, a hole below the surface a ball, each with the
parabolic weight of a footprint. The effect of one hole on the other is computed between points,
with a relative error of (a/w)². It is Mindlin's solution (J. Appl. Phys. 7 (1936) 195). Far from
the surface this is Kelvin's solution, and on the surface Cerruti's and Boussinesq's. The surface is
z = 0, and z points outwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from studies import unbounded
from studies.arrays import Array
from tissue import Material
from tissue.materials.density import Sum
from tissue.materials.isotropic import Exponential, Volumetric
from tissue.sites import footprint

WEIGHT = "parabolic"
STEP = 1e-4  # of a footprint: step of difference quotients of displacements


# --- friction ---------------------------------------------------------------------------------------------


def point_ratio(mu: float, turn: float) -> float:
    """Return (1 + μt)/(1 − μt), t = tan θ/2, for one hole.

    The tangent in the hole is half-way between the strands. The hole turns the thread by
    `turn` [rad]; the ratio is infinite if the thread locks.
    """
    mt = mu * np.tan(turn / 2)
    return float((1 + mt) / (1 - mt)) if mt < 1.0 else float("inf")


def bent_ratio(mu: float, turn: float) -> float:
    """Return T₁/T₂ of a bending thread, turned by `turn` [rad].

    The moment is the same on both sides (elastica): T₁(1 − cos α) = T₂(1 − cos β). Friction gives
    T₁ − T₂ = μ(T₁ sin α + T₂ sin β), and α + β is the turn.
    """

    def ratio(alpha: float) -> float:
        return float((1 + mu * np.sin(turn - alpha)) / (1 - mu * np.sin(alpha)))

    def jump_of_moment(alpha: float) -> float:
        return float(ratio(alpha) * (1 - np.cos(alpha)) - (1 - np.cos(turn - alpha)))

    return ratio(brentq(jump_of_moment, 1e-9, turn / 2))


def capstan(mu: float, turn: float) -> float:
    """Return the ratio of tensions at a post around which a limp thread turns by `turn` [rad]."""
    return float(np.exp(mu * turn))


def tensions_by_law(before: Array, hand: float, ratios: Array) -> Array:
    """Return the tensions behind each hole [N], shape `(holes,)`, after the hand changed its pull.

    `before` are the tensions before the change. `ratios` (holes − 1,) are the ratios at which the
    holes slip, without the knot. A segment keeps its tension if no hole between it and the hand
    slips. So its tension lies between the hand's tension divided by, and multiplied by, the product
    of their ratios.
    """
    reach = np.append(np.cumprod(ratios[::-1])[::-1], 1.0)
    return np.clip(before, hand / reach, hand * reach)


# --- strips and sheets ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fibrous:
    """Exponential tissue of E [Pa], ν and stiffening b."""

    youngs_modulus: float
    poisson_ratio: float
    stiffening: float

    def stress(self, *stretches: float) -> Array:
        """Return the first Piola stress at three principal stretches, shape `(3, 3)` [Pa]."""
        linear = Material(self.youngs_modulus, self.poisson_ratio, 1.0)
        density = Sum([Exponential(linear.lame_mu, self.stiffening), Volumetric(linear.bulk_modulus)])
        return np.asarray(density.stress(np.diag(stretches)[:, :, None])[:, :, 0])

    def strip(self, stretch: float) -> tuple[float, float]:
        """Return the nominal stress [Pa] and J of a strip at a stretch, with free sides."""
        low = 0.7 / np.sqrt(stretch)
        side = float(brentq(lambda x: float(self.stress(stretch, x, x)[1, 1]), low, 1.5))
        return float(self.stress(stretch, side, side)[0, 0]), stretch * side**2

    def thinned(self, stretch: float) -> float:
        """Return the stretch through the thickness of a free sheet [-].

        Both in-plane directions have an equal stretch.
        """
        low = 0.5 / stretch**2
        return float(brentq(lambda x: float(self.stress(stretch, stretch, x)[2, 2]), low, 1.5))


# --- two holes of a half-space ----------------------------------------------------------------------------


@dataclass(frozen=True)
class TwoHoles:
    """Two holes of radius `footprint` [m] in a half-space of E [Pa] and ν.

    They are at (∓`bite`/2, 0, −`depth`) [m]. The first hole is the entry.
    """

    bite: float
    depth: float
    footprint: float
    youngs_modulus: float
    poisson_ratio: float

    @property
    def places(self) -> Array:
        """Entry and exit, shape `(2, 3)` [m]."""
        return np.array([[-0.5 * self.bite, 0.0, -self.depth], [0.5 * self.bite, 0.0, -self.depth]])

    @property
    def compliance(self) -> Array:
        """Compliance of (x, z) of the entry, then of the exit, shape `(4, 4)` [m/N]."""
        E, nu, a = self.youngs_modulus, self.poisson_ratio, self.footprint
        if self.depth > 0.0:
            ball = unbounded.ball_compliance(nu) * np.eye(2) / (E * a)
            own = ball + image_term(0.0, self.depth, nu) / E
        else:
            own = unbounded.disc_compliance(nu)[np.ix_([0, 2], [0, 2])] / (E * a)
        other = (direct_term(self.bite, nu) + image_term(self.bite, self.depth, nu)) / E
        return np.block([[own, other.T], [other, own]])

    def displacements(self, held: float, between: float, pulled: float) -> Array:
        """Return (x, z) of entry and exit, shape `(2, 2)` [m], under the thread's tensions [N].

        The thread pulls up at the entry, along the bite between the holes, and up at the exit.
        """
        return np.reshape(self.compliance @ [between, held, -between, pulled], (2, 2))

    def stress(self, points: Array, forces: Array, holes: Sequence[int] = (0, 1)) -> Array:
        """Return the stress `(k, 3, 3)` [Pa] at points `(k, 3)` [m].

        It is under `forces` `(2, 3)` [N] on holes on the surface. It is the difference quotient of
        the displacements of Cerruti and Boussinesq, averaged over the disc.
        """
        disc, slope = footprint.disc(WEIGHT), np.zeros((len(points), 3, 3))
        for hole in holes:
            offset = (points - self.places[hole])[:, None] / self.footprint - disc.points
            for j, sign in np.ndindex(3, 2):
                shift = (1.0 - 2.0 * sign) * STEP
                field = unbounded.surface_force(offset + shift * np.eye(3)[j], self.poisson_ratio) @ forces[hole]
                slope[:, :, j] += np.einsum("q,kqi->ki", disc.weights, field) / (2.0 * shift)
        return hooke(slope / self.footprint**2, self.poisson_ratio)

    def mean_stress(self, hole: int, forces: Array) -> Array:
        """Return the stress averaged over the half ball below a hole, shape `(3, 3)` [Pa].

        The hole is on the surface. The hole's own part comes from the Fourier transform. The other
        hole's part is its value at the centre of the half ball.
        """
        own = unbounded.half_ball_compliance(self.poisson_ratio)[3:, :3] @ forces[hole]
        points, weights = half_ball()
        centre = self.places[hole] + self.footprint * (weights @ points)
        mine = hooke(own.reshape(1, 3, 3) / self.footprint**2, self.poisson_ratio)[0]
        return np.asarray(mine + self.stress(centre[None], forces, holes=[1 - hole])[0])


def half_ball() -> tuple[Array, Array]:
    """Return the points of the unit half ball z < 0, `(k, 3)`, and their weights.

    The weights sum to one.
    """
    ball = footprint.ball(WEIGHT)
    below = ball.points[:, 2] < 0.0
    return ball.points[below], 2.0 * ball.weights[below]


def hooke(slope: Array, nu: float) -> Array:
    """Return the stress over E for displacement gradients `(k, 3, 3)`."""
    strain = 0.5 * (slope + np.swapaxes(slope, 1, 2))
    trace = np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.asarray((strain + nu / (1.0 - 2.0 * nu) * trace) / (1.0 + nu))


def direct_term(distance: float, nu: float) -> Array:
    """Return Kelvin's displacement (x, z) at a distance [m] along x, shape `(2, 2)`, E = 1.

    It is in full space, under unit forces along x and z.
    """
    return np.asarray(unbounded.kelvin(np.array([distance, 0.0, 0.0]), nu)[np.ix_([0, 2], [0, 2])])


def image_term(distance: float, depth: float, nu: float) -> Array:
    """Return Mindlin's surface term for two points at the same depth [m], shape `(2, 2)`, E = 1."""
    x, c, R = distance, depth, float(np.hypot(distance, 2.0 * depth))
    k, free = 3.0 - 4.0 * nu, 4.0 * (1.0 - nu) * (1.0 - 2.0 * nu)
    along = 1.0 / R + k * x**2 / R**3 + 2.0 * c**2 / R**3 * (1.0 - 3.0 * x**2 / R**2)
    along += free / (R + 2.0 * c) * (1.0 - x**2 / (R * (R + 2.0 * c)))
    normal = (8.0 * (1.0 - nu) ** 2 - k) / R + (4.0 * k - 2.0) * c**2 / R**3 + 24.0 * c**4 / R**5
    across = x * (free / (R * (R + 2.0 * c)) - 12.0 * c**3 / R**5)
    return (1.0 + nu) / (8.0 * np.pi * (1.0 - nu)) * np.array([[along, across], [-across, normal]])
