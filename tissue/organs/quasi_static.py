"""An organ without inertia, which is always in equilibrium with its sites."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_matrix, vstack

from tissue.arrays import Array
from tissue.organs.meshed import (
    EMPTY,
    LinearAnswer,
    MeshedOrgan,
    Operator,
    OrganEnergies,
    OrganState,
    Pairing,
    Remade,
    TimeScheme,
    compliance,
    refuse_loose,
    slips_since,
)
from tissue.recent import Recent
from tissue.solvers.choice import MULTIGRID

CROSSED = 1e-9  # of the surfaces' extent: round-off of closed gaps
ALL = np.ones(1)  # the part of gravity, which has no ramp


@dataclass(frozen=True)
class QuasiStaticOperator(Operator):
    """The factorised A = K with known answers to gravity and to each load.

    The work in a step therefore does not grow with the mesh.

    `U_loads` (N, 1 + l) and `y_loads` (9p, 1 + l) are the answers of the field and of the sites,
    gravity first. `loads_work` (1 + l, 1 + l) [J] is the work of each load on the displacement due
    to each load.
    """

    organ: "QuasiStaticOrgan"
    U_loads: Array
    y_loads: Array
    loads_work: Array

    def y_load(self, parts: Array) -> Array:
        """Return the site variables under the `parts` (1 + l,) of the loads alone, `(9p,)`."""
        return np.asarray(self.organ.y0 + self.y_loads @ parts)

    def g_load(self, pairing: Pairing, parts: Array) -> Array:
        """Return the gaps under the `parts` (1 + l,) of the loads alone, shape `(k,)` [m]."""
        return np.asarray(pairing.g0 + pairing.G @ (self.U_loads @ parts))


@dataclass(frozen=True, eq=False)
class QuasiStaticOrgan(MeshedOrgan):
    """An organ without inertia: U = K⁻¹ (load + Yᵀ f_y).

    Its state has only forces; its field is computed when needed.
    """

    _fields: Recent[Array] = field(default_factory=Recent, init=False, repr=False)
    solved_once: ClassVar = True

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_loose(self.elasticity)

    @cached_property
    def _operator(self) -> QuasiStaticOperator:
        """The operator; K is factorised when first needed, because the check of a scenario does not
        need it.
        """
        factor, count = self.solver_of(self.K), self.Y.shape[0]
        loads = csr_matrix(np.column_stack([self.load, self.surface_load]).T)
        # The error of a column enters the gaps to first order. With contact, `rough` is therefore
        # not accurate enough.
        U, work = compliance(factor, csr_matrix(vstack([self.Y, loads])), rough=not self.touches)
        W, U_loads = U[:, :count], U[:, count:]
        # Without lips no column is solved again. The levels of multigrid are then discarded,
        # because they take more memory than the rest of the organ.
        kept = factor if self.touches or self.choice.name != MULTIGRID else Remade(self.K, self.solver_of)
        return QuasiStaticOperator(
            self, self.K, kept, W, work[:count, :count], U_loads, work[:count, count:], work[count:, count:]
        )

    def start(self) -> OrganState:
        """Return the equilibrium under gravity, without site forces, loads and contact forces."""
        return OrganState(EMPTY, EMPTY, EMPTY, np.zeros(self.y0.size), np.zeros(self.contacts), shares=self.no_shares)

    def parts(self, state: OrganState) -> Array:
        """Return the parts of gravity, always 1, and of each load that act in a state, shape `(1 +
        l,)`.
        """
        return ALL if state.shares is None else np.append(ALL, state.shares)

    def operator(self, a: float, d: float) -> QuasiStaticOperator:
        """Return the factorised K for any time scheme."""
        return self._operator

    def answer(
        self, scheme: TimeScheme, past: Sequence[OrganState], time: float = np.inf, share: float = 1.0
    ) -> LinearAnswer:
        """Return the answer of any step under the part `share` of the loads at `time` [s].

        The answer starts from the known equilibrium without site forces. With contact, the pairing
        is found in the field of the last state, which takes one back-substitution.
        """
        operator, shares = self._operator, self.shares_at(time, share)
        pairing = self.paired_after(past, scheme) if self.touches and past else self.pairing(None)

        def complete(f_y: Array, p: Array) -> OrganState:
            """Return the state of an organ in equilibrium with its forces."""
            return OrganState(EMPTY, EMPTY, EMPTY, f_y, p, pairing.facing, shares, points=pairing.points)

        parts = self.parts(complete(EMPTY, EMPTY))
        y_free, g_free = operator.y_load(parts), operator.g_load(pairing, parts)
        return LinearAnswer(operator, y_free, g_free, complete, lambda: self.load_under(shares), pairing)

    def paired_after(self, past: Sequence[OrganState], scheme: TimeScheme) -> Pairing:
        """Return the pairing after the states `past`.

        At a start under gravity, surfaces can cross, because no contact force acts yet. Their slips
        are then counted from the reference shape.
        """
        pairing, first = super().paired_after(past, scheme), slips_since(past, scheme)
        if self.gaps is None or not self.gaps.rough.size:
            return pairing
        if self.gap(first).min() < -CROSSED * self.gaps.extent:
            pairing.g0[self.pairs : self.contacts] = 0.0
        return pairing

    def is_unloaded(self, state: OrganState) -> bool:
        """Return whether no force acts on the organ, so that its displacement is zero."""
        forces = self.load, state.f_y, state.p
        return not any(force.any() for force in forces) and (state.shares is None or not state.shares.any())

    def site_variables(self, state: OrganState) -> Array:
        """Return y = y0 + Y U = y_load + C f_y + C_yc p, shape `(9p,)`."""
        p = state.p
        if self.is_unloaded(state):
            return self.y0
        y = self._operator.y_load(self.parts(state)) + self._operator.C @ state.f_y
        return y + p @ self._operator.gaps_by_sites(self.pairing_of(state)) if p.any() else y

    def gap(self, state: OrganState) -> Array:
        """Return g = g0 + G U = g_load + C_cy f_y + C_cc p, shape `(pairs,)` [m]."""
        return self.g0 if not self.pairs or self.is_unloaded(state) else self.gaps_of(state)[: self.pairs]

    def gaps_of(self, state: OrganState) -> Array:
        """Return the gaps g, as `gap`, and slips of all pairs, then those of outside points, `(k,)`
        [m].
        """
        pairing = self.pairing_of(state)
        g = self._operator.g_load(pairing, self.parts(state)) + self._operator.gaps_by_sites(pairing) @ state.f_y
        return g + self._operator.by_pairs(pairing).times(state.p)

    def field(self, state: OrganState) -> Array:
        """Return the displacement over the free unknowns, shape `(N,)` [m].

        The fields of the last two states are cached.
        """
        return self._fields.of((state,), lambda: self._field(state))

    def _field(self, state: OrganState) -> Array:
        U_load, p = self._operator.U_loads @ self.parts(state), state.p
        U = np.asarray(U_load + self._operator.W @ state.f_y)
        return U + self._operator.factor.solve(self.pairing_of(state).G.T @ p) if p.any() else U

    def impulse(self, state: OrganState) -> None:
        """Return None: an organ without mass has no answer to an impulse."""

    def displace(self, scheme: TimeScheme, state: OrganState, y: Array, f_y: Array) -> LinearAnswer:
        """Return the answer of a step in which the sites stay at `y` (9p,) while the forces are
        constant.
        """
        return self.displaced(self._operator, state, y, f_y, self.Y)

    def steady_loads(self, state: OrganState, times: Sequence[float]) -> tuple[float, Array, Array] | None:
        """Return the elastic energy under gravity and loads alone [J], the displacement of the
        sites under them, and the site forces.

        The last two have shape `(9p,)`. The result is None if the loads at the `times` [s] differ
        from the loads of the state, or if surfaces can touch.
        """
        if self.touches or not self.surface.are_steady(state.shares, times):
            return None
        parts = self.parts(state)
        return float(0.5 * parts @ (self._operator.loads_work @ parts)), self._operator.y_loads @ parts, state.f_y

    def energies(self, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies and works of a step, as for the dynamic organ.

        They follow from 9p + k + l numbers, because

        U = U_load + W f_y + K⁻¹Gᵀ p, K U_load = load, Y U_load = y_load − y0 and G U_load = g_load
        − g0.
        """
        p = new.p
        if p.any() or old.p.any():
            return self._energies_in_contact(p, old, new)
        C, work = self._operator.C, self._operator.loads_work
        parts, df = self.parts(new), new.f_y - old.f_y
        sag, more = self._operator.y_loads @ parts, parts - self.parts(old)
        elastic = 0.5 * parts @ (work @ parts) + sag @ new.f_y + 0.5 * new.f_y @ (C @ new.f_y)
        given, numerical = sag @ df, 0.5 * df @ (C @ df)
        if more.any():
            given += parts @ (work @ more)
            numerical += 0.5 * more @ (work @ more) + (self._operator.y_loads @ more) @ df
        return OrganEnergies(0.0, float(elastic), float(given), 0.0, float(numerical))

    def _energies_in_contact(self, p: Array, old: OrganState, new: OrganState) -> OrganEnergies:
        """Return the energies and works from the fields, if contact forces act or acted.

        −p⁺·Δg is part of `numerical`.
        """
        U = self.field(new)
        dU = U - self.field(old)
        pushes, friction = self.contact_works(p, self.pairing_of(new).G @ dU)
        return OrganEnergies(
            kinetic=0.0,
            elastic=float(0.5 * U @ (self.K @ U)),
            load_work=float(self.load_under(new.shares) @ dU),
            viscous=0.0,
            numerical=float(0.5 * dU @ (self.K @ dU)) + pushes,
            friction=friction,
        )
