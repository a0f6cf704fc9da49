"""The organ: small-strain linear elasticity on tetrahedra, and the nine numbers per piercing a thread sees of
it.
"""

from tissue.body import Elasticity, elasticity, held_components, holds_still
from tissue.dynamic import DynamicOrgan
from tissue.errors import FactorError, TissueError
from tissue.factor import Factor, factorize
from tissue.fixed import FixedSites, fixed_sites
from tissue.gaps import Gaps, build_gaps
from tissue.iterative import ConjugateGradients, conjugate_gradients
from tissue.material import Material
from tissue.organ import Equation, LinearAnswer, OrganEnergies, OrganState, SiteAnswer, TimeScheme
from tissue.quasi_static import QuasiStaticOrgan
from tissue.sites import Site, Sites, build_sites
from tissue.stress import StressRecovery, interpolation, stress_recovery, von_mises

__all__ = [
    "ConjugateGradients",
    "DynamicOrgan",
    "Elasticity",
    "Equation",
    "Factor",
    "FactorError",
    "FixedSites",
    "Gaps",
    "LinearAnswer",
    "Material",
    "OrganEnergies",
    "OrganState",
    "QuasiStaticOrgan",
    "Site",
    "SiteAnswer",
    "Sites",
    "StressRecovery",
    "TimeScheme",
    "TissueError",
    "build_gaps",
    "build_sites",
    "conjugate_gradients",
    "elasticity",
    "factorize",
    "fixed_sites",
    "held_components",
    "holds_still",
    "interpolation",
    "stress_recovery",
    "von_mises",
]
