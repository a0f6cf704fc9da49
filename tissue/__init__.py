"""The organ: linear or finite-strain elasticity on tetrahedra, and its nine site variables per
piercing.
"""

from tissue.deformation import cauchy_stress, cell_energy, principal_stretch
from tissue.elasticity import Elasticity, elasticity
from tissue.errors import FactorError, OrganError, TissueError
from tissue.hyperelasticity import Hyperelasticity
from tissue.loads import SurfaceLoad
from tissue.material import Material
from tissue.organs.dynamic import DynamicOrgan
from tissue.organs.finite import FiniteOrgan
from tissue.organs.fixed import FixedSites, fixed_sites
from tissue.organs.floating import FloatingOrgan
from tissue.organs.krylov import KrylovOrgan, has_space
from tissue.organs.lips import Gaps, Part, build_gaps, surface_gaps
from tissue.organs.meshed import OrganState
from tissue.organs.quasi_static import QuasiStaticOrgan
from tissue.organs.relaxing import RelaxingOrgan
from tissue.organs.rim import Rim
from tissue.organs.skin import skin_of
from tissue.refinement.bound import relative_bounds
from tissue.refinement.estimate import Estimate
from tissue.refinement.mark import Zone, zones
from tissue.refinement.rounds import Fitted, fitted
from tissue.relaxation import Prony
from tissue.sites.site import Site, build_sites, cells_at
from tissue.sites.surface import depths, distances, landing
from tissue.solvers.factor import factorize
from tissue.solvers.iterative import conjugate_gradients
from tissue.strain import energy_measure, nodal_volume_ratio, strains, volume_ratio
from tissue.stress import StressRecovery, interpolation, principal, stress_recovery, von_mises
from tissue.supports import held_components, motions_in_words, rigid_motions

__all__ = [
    "DynamicOrgan",
    "Elasticity",
    "Estimate",
    "FactorError",
    "FiniteOrgan",
    "Fitted",
    "FixedSites",
    "FloatingOrgan",
    "Gaps",
    "Hyperelasticity",
    "KrylovOrgan",
    "Material",
    "OrganError",
    "OrganState",
    "Part",
    "Prony",
    "QuasiStaticOrgan",
    "RelaxingOrgan",
    "Rim",
    "Site",
    "StressRecovery",
    "SurfaceLoad",
    "TissueError",
    "Zone",
    "build_gaps",
    "build_sites",
    "cauchy_stress",
    "cell_energy",
    "cells_at",
    "conjugate_gradients",
    "depths",
    "distances",
    "elasticity",
    "energy_measure",
    "factorize",
    "fitted",
    "fixed_sites",
    "has_space",
    "held_components",
    "interpolation",
    "landing",
    "motions_in_words",
    "nodal_volume_ratio",
    "principal",
    "principal_stretch",
    "relative_bounds",
    "rigid_motions",
    "skin_of",
    "strains",
    "stress_recovery",
    "surface_gaps",
    "volume_ratio",
    "von_mises",
    "zones",
]
