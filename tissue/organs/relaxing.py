"""A linear organ whose tissue relaxes (`tissue.relaxation`), with or without inertia.

    K U − Σ K_i U + Σ K_i e_i = forces,    de_i/dt + e_i/τ_i = dU/dt

K_i is the stiffness of the share of the distortion that relaxes with τ_i. The field e_i over the
free unknowns is the part of U that has not relaxed yet. Over a step

    e_i⁺ = e^(−x_i) e_i + φ_i (U⁺ − U).

The step is therefore that of an organ with the stiffness K − Σ (1 − φ_i) K_i under the additional
forces Σ K_i (φ_i U − e^(−x_i) e_i).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from tissue.arrays import Array
from tissue.elasticity import distortion
from tissue.organs.dynamic import DynamicOperator, DynamicOrgan
from tissue.organs.floating import Drag
from tissue.organs.meshed import (
    LinearAnswer,
    OrganEnergies,
    OrganState,
    Pairing,
    TimeScheme,
    refuse_loose,
    slips_since,
)
from tissue.relaxation import Prony
from tissue.stress import StressRecovery, stress_recovery

DIGITS = 12  # digits of a step's length in the key of a cached operator; further ones are round-off


@dataclass(frozen=True, eq=False)
class RelaxingOrgan(DynamicOrgan):
    """A linear organ whose distortion relaxes by a Prony series `relaxation`.

    If `inertia` is False, it is always in equilibrium. Its states have the fields e_i `(b, N)` [m]
    in `relaxing`; None if all stress has relaxed.
    """

    relaxation: Prony = field(kw_only=True)
    inertia: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.inertia:
            refuse_loose(self.elasticity)

    @cached_property
    def branches(self) -> list[csr_matrix]:
        """The matrices K_i, shape `(N, N)` [N/m] each."""
        free = self.elasticity.free
        return [csr_matrix(distortion(self.elasticity, share)[free][:, free]) for share in self.relaxation.shares]

    def operator_of(self, scheme: TimeScheme) -> DynamicOperator:
        """Return the factorised operator of a step of a scheme.

        The last few operators are cached.
        """
        key = scheme.a, scheme.d, f"{scheme.dt:.{DIGITS}g}"
        return self._operators.of((), lambda: self._factorized(scheme.a, scheme.d, self._soft(scheme.dt)), key)

    def _soft(self, dt: float) -> csr_matrix:
        """Return Σ (1 − φ_i) K_i of a step of `dt` [s]."""
        parts = zip(self.relaxation.means(dt), self.branches, strict=True)
        return csr_matrix(sum((1.0 - mean) * K for mean, K in parts))

    def scheme_of(self, scheme: TimeScheme) -> TimeScheme:
        """Return the scheme used for the organ.

        If the organ has no inertia, it is an equilibrium at the end of the step.
        """
        return scheme if self.inertia else Drag(0.0, coefficients=(), dt=scheme.dt)

    def start(self) -> OrganState:
        """Return the state at the start.

        It is undeformed and at rest. Without inertia, it is in equilibrium with gravity.
        """
        rest = super().start()
        if self.inertia:
            return rest
        return replace(rest, U=self.operator_of(Drag(0.0, coefficients=(), dt=np.inf)).factor.solve(self.load))

    def strains(self, state: OrganState) -> Array:
        """Return the fields e_i, shape `(b, N)` [m]."""
        none = np.zeros((len(self.branches), self.size))
        return none if state.relaxing is None else state.relaxing

    @cached_property
    def _stresses(self) -> list[StressRecovery]:
        """The stress of each share of the distortion."""
        return [stress_recovery(self.elasticity, share) for share in self.relaxation.shares]

    def relaxed_stress(self, state: OrganState) -> Array:
        """Return the relaxed stress at the nodes, shape `(m, 6)` [Pa].

        It is the instantaneous elastic stress minus the present stress.
        """
        left = zip(self._stresses, self.strains(state), strict=True)
        return np.asarray(sum(each.stress(self.whole(state.U - e)) for each, e in left))

    def answer_paired(
        self, scheme: TimeScheme, past: Sequence[OrganState], pairing: Pairing, time: float, share: float
    ) -> LinearAnswer:
        """Return the answer of a step with a given pairing.

        In equilibrium, relaxation is counted from the last state of `past`.
        """
        first, scheme = slips_since(past, scheme), self.scheme_of(scheme)
        e, decays, means = self.strains(first), self.relaxation.decays(scheme.dt), self.relaxation.means(scheme.dt)
        shares = self.shares_at(time, share)
        load, operator, history = self.load_under(shares), self.operator_of(scheme), self.history(scheme, past)
        # Resistance at the start: the instantaneous stiffness minus the stiffness of the step.
        soft = np.zeros(self.size)
        for K, part, decay, mean in zip(self.branches, e, decays, means, strict=True):
            load = load + K @ (mean * first.U - decay * part)
            soft += K @ ((1.0 - mean) * past[0].U)
        U_free = operator.predict(past[0], history, load + soft)
        answer = self._answered(operator, U_free, history, load, pairing, shares)

        def complete(f_y: Array, p: Array) -> OrganState:
            new = answer.accepted(f_y, p)
            return replace(new, relaxing=decays[:, None] * e + means[:, None] * (new.U - first.U))

        return replace(answer, accepted=complete)

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step without motion from `y` (9p,), as `DynamicOrgan.displace`.

        The displacement due to a change of the forces is instantaneous.
        """
        answer = super().displace(self.scheme_of(scheme), state, y, f_y)

        def displaced(f_new: Array, p_new: Array) -> OrganState:
            new = answer.accept(f_new, p_new)
            return replace(new, relaxing=self.strains(state) + (new.U - state.U))

        return replace(answer, accepted=displaced)

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies at `new` and the works of the step [J].

        The elastic energy is the part that remains after complete relaxation. The work of the
        relaxing stress counts as viscous and uses its value at the end of the step. Some of this
        work is returned if the tissue moves back.
        """
        whole, dU = super().energies(old, new), new.U - old.U
        lost, taken, relaxed = 0.0, 0.0, 0.0
        for K, e in zip(self.branches, self.strains(new), strict=True):
            lost += float(0.5 * new.U @ (K @ new.U))
            taken += float(0.5 * dU @ (K @ dU))
            relaxed += float(e @ (K @ dU))
        return whole._replace(
            elastic=whole.elastic - lost, viscous=whole.viscous + relaxed, numerical=whole.numerical - taken
        )
