"""The case: a thread that draws up two holes of a block.

A thread comes down into one hole of a block, runs below its surface to the other and up again. Its start is held, its
end is drawn up by a dead load T, so that in linear theory both holes are drawn up by T and towards each other by T.
Each thing is changed alone about a reference case: a 3-0 braid under 0.1 N, 0.5 MPa, holes 10 mm apart on the surface,
a footprint of 1 mm, no friction. The bite's depth is that of the holes' centres: where the tissue bears the thread is
all that this model knows of a channel, so a deeper bite is one that bears deeper (a ball instead of a disc).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from studies.arrays import Array
from studies.friction.study import bent_ratio
from studies.study import unit_field
from studies.theory import TwoHoles
from studies.verdicts import LINEAR, bearing_strain
from thread.catalogue import suture

SIZE = (0.07, 0.06, 0.03)  # of the block, held at its bottom [m]
POISSON = 0.45
LEG = 0.03  # of the thread above each hole [m]
GIVEN = 0.4e-3  # by which the hand at the start gives way where there is friction, so that the thread slides [m]
DIP = 1e-3  # of the laid thread below the holes [m]
DAMPING, RELAXED, RELAXED_STEP = 400.0, 1.0, 1e-2  # of a dynamic run [1/s, s, s], its load rising all the while
ROUND = 48  # points of a ring
CURVE = 41  # points of a curve
CLEAR = 2.0  # footprints from a hole inside to the surface, at least
TAUT = 0.2  # of the bite: a thread that bends over less is as good as a string
COARSEST = 1.3  # cells at the holes over the footprint, on the coarsest mesh for stress; finer by its `refinement`
GROWTH = 3.0  # of its cells

TISSUES = {  # E [Pa]: order of magnitude at small strain, the spread is a decade
    "liver": 6e3,  # shear modulus 1.8 kPa (Phys. Med. Biol. 64 (2019) 225001)
    "small bowel": 250e3,  # biaxial, 180 to 307 kPa at low strain (Terry et al. 2014)
    "skin": 500e3,  # in vivo 0.1 to 1 MPa in plane (Geerligs 2011; Agache 1980)
    "fascia": 10e6,  # assumed; 28 to 57 MPa from the line loads of Förstemann et al. (J. Biomech. 44 (2011) 600)
}
CLINICAL = {  # tension [N] and where it is from
    "liver": (1.2, "0.27 MPa that tear liver on 10 mm × 0.45 mm; none was measured"),
    "small bowel": (4.62, "pull-out, Gong et al., J. Biomech. Eng. 2023"),
    "skin": (1.1, "largest on closing a wound of 36 × 5 mm, Capek et al., Med. Biol. Eng. Comput. 50 (2012) 193"),
    "fascia": (3.0, "running stitch, Horeman et al., PLoS ONE 8 (2013) e84466"),
}
MATERIALS: dict[str, dict[str, Any]] = {  # of one E and ν, which all of them have at small strain
    "linear": {},
    "neo-hookean": {"material": "neo-hookean"},
    "exponential, b = 1": {"material": "exponential", "stiffening": 1.0},
    "exponential, b = 5": {"material": "exponential", "stiffening": 5.0},
}
MATERIAL_STEPS = 8  # load steps to a tension of a material
DEPARTURE = 0.05  # of the displacement by which the linear organ is off where its range ends
MILLI, KILO = 1e-3, 1e3
THEORY = ("theory_mean_von_mises", "theory_mean_largest", "theory_ring_von_mises", "theory_ring_largest")
SOFT: dict[str, dict[str, Any]] = {  # ways to pull at an organ that is too soft for it
    "10 load steps": {"load_steps": 10},
    "40 load steps": {"load_steps": 40},
    "damped motion": {"way": "dynamic", "load_steps": round(RELAXED / RELAXED_STEP)},
}
STRESSES = ("mean_von_mises", "mean_largest", "mean_smallest", "ring_von_mises", "ring_largest", "ring_smallest")
FORMAL = {"exit_along": 4.0, "exit_normal": 4.0} | dict.fromkeys(STRESSES, 2.0)  # orders of P2
QUANTITIES = {
    "exit_along": "displacement along",
    "exit_normal": "displacement normal",
    "mean_von_mises": "von Mises stress below the hole",
    "mean_largest": "largest principal stress below the hole",
    "ring_von_mises": "von Mises stress on the ring",
    "ring_largest": "largest principal stress on the ring",
    "ring_smallest": "smallest principal stress on the ring",
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is run: `name` is a tissue, or in words what differs from the others of its `sweep`."""

    sweep: str
    name: str = ""
    suture: str = "3-0 polyglactin 910"
    knots: str = "adaptive"  # or "fixed"
    holes: str = "free"  # or "normal": the thread's direction in them
    way: str = "static"  # or "dynamic"
    load_steps: int = unit_field("-")
    tension: float = unit_field("N")  # asked for
    youngs_modulus: float = unit_field("Pa")
    bite: float = unit_field("m")
    depth: float = unit_field("m")  # of the holes' centres
    footprint: float = unit_field("m")
    mu: float = unit_field("-")
    given: float = unit_field("m")  # by which the hand at the start gives way
    ring: float = unit_field("footprints")  # radius of the ring on which stress is taken
    refinement: float = unit_field("-")  # of the mesh for stress
    material: str = "linear"
    stiffening: float = field(default=0.0, metadata={"unit": "-"})

    @property
    def theory(self) -> TwoHoles:
        """The same holes in a half-space."""
        return TwoHoles(self.bite, self.depth, self.footprint, self.youngs_modulus, POISSON)

    @property
    def places(self) -> Array:
        """Entry and exit, shape `(2, 3)` [m]."""
        return self.theory.places


@dataclass(frozen=True, kw_only=True)
class Row(Case):
    """One equilibrium. "along" is towards the other hole and "normal" out of the tissue; forces are those on it."""

    load: float = unit_field("N")  # that was reached
    entry_along: float = unit_field("m")
    entry_normal: float = unit_field("m")
    exit_along: float = unit_field("m")
    exit_normal: float = unit_field("m")
    theory_along: float = unit_field("m")  # of the exit, in a half-space
    theory_normal: float = unit_field("m")
    approach: float = unit_field("m")
    theory_approach: float = unit_field("m")
    drawn: float = unit_field("m")  # through the exit, since a taut thread in the undeformed organ
    theory_drawn: float = unit_field("m")
    held: float = unit_field("N")  # tension before the entry
    entered: float = unit_field("N")  # after it
    leaving: float = unit_field("N")  # before the exit
    pulled: float = unit_field("N")  # after it
    theory_held: float = unit_field("N")
    force_along: float = unit_field("N")  # on the exit
    force_normal: float = unit_field("N")
    couple: float = unit_field("N m")
    turn: float = unit_field("-")  # of the frame of a hole: what ⟨∇U⟩ makes of it
    compliance_along: float = unit_field("m/N")
    compliance_normal: float = unit_field("m/N")
    mean_von_mises: float = unit_field("Pa")
    mean_largest: float = unit_field("Pa")
    mean_smallest: float = unit_field("Pa")
    ring_von_mises: float = unit_field("Pa")
    ring_largest: float = unit_field("Pa")
    ring_smallest: float = unit_field("Pa")
    theory_mean_von_mises: float = unit_field("Pa")
    theory_mean_largest: float = unit_field("Pa")
    theory_ring_von_mises: float = unit_field("Pa")
    theory_ring_largest: float = unit_field("Pa")
    cells: float = unit_field("m")  # of the mesh for stress, (V/N)^⅓
    residual: float = unit_field("-")  # |C f − u| over |u|
    span_ratio: float = unit_field("-")
    springs: float = unit_field("-")  # share of a hole's compliance that is added to coarse cells
    kinetic: float = unit_field("J")
    elastic: float = unit_field("J")
    clear: bool  # of what the sub-grid compliance does not reckon with
    failed: str

    @property
    def moved(self) -> float:
        """How far the hole that moved farther did [m]."""
        return float(max(np.hypot(self.entry_along, self.entry_normal), np.hypot(self.exit_along, self.exit_normal)))

    @property
    def scaled_load(self) -> float:
        """τ = T/(E a²)."""
        return self.load / (self.youngs_modulus * self.footprint**2)

    @property
    def gap(self) -> float:
        """Distance of the holes along [m]."""
        return self.bite - self.approach

    @property
    def bearing(self) -> float:
        """T/(d ℓ E)."""
        return bearing_strain(self.load, suture(self.suture).diameter, self.bite, self.youngs_modulus)

    @property
    def is_linear(self) -> bool:
        """Whether the linear organ is entitled to it."""
        return self.moved <= LINEAR * self.footprint and self.bearing <= LINEAR and self.turn <= LINEAR

    @property
    def is_taut(self) -> bool:
        """Whether the thread bends over little of the bite."""
        return self.load > 0.0 and np.sqrt(suture(self.suture).EI / self.load) <= TAUT * self.bite


REFERENCE = Case(
    sweep="reference",
    load_steps=4,
    tension=0.1,
    youngs_modulus=500e3,
    bite=0.01,
    depth=0.0,
    footprint=1e-3,
    mu=0.0,
    given=0.0,
    ring=2.0,
    refinement=1.5,
)


def theory_tensions(case: Case, load: float) -> tuple[float, float, float]:
    """Return the tension before, between and after holes that each turn a bending thread by 90° [N]."""
    ratio = bent_ratio(case.mu, 0.5 * np.pi)
    return load / ratio**2, load / ratio, load
