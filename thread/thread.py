"""The thread: a spline with mass and elastic energies, assembled over its spans.

Unknowns are the control values `q`, shape `(n, c)`, numbered point by point: unknown c i + a is
coordinate a of point i. The c coordinates of a point are x, y, z [m] and, with twist, the angle θ
[rad] of the section about the tangent (`thread.frames`). Matrices are banded (`thread.banded`).
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg.blas import dsbmv
from scipy.sparse import csr_matrix, dia_array

from thread.arrays import Array, Indices
from thread.banded import Elements, diagonal_of
from thread.energies.coil import Coil
from thread.energies.continuous import Continuous
from thread.energies.interface import AxialEnergy, Energy
from thread.energies.springs import SpringLayout, Springs, spread_springs
from thread.energies.torsion import Torsion, evaluate
from thread.errors import ThreadError
from thread.frames import (
    Frame,
    Stations,
    gauss_stations,
    interpolate_frame,
    transport_frame,
    turns_too_far,
    untwisted_frame,
)
from thread.placed import Placed
from thread.quadrature import GaussRule, carried, gauss_rule, knot_rule, legendre
from thread.relaxation import POINTS, Memory, Series
from thread.spline import Spline

LOCAL = 4  # functions of a cubic on one span
POSITION = 3  # coordinates of a position

MASS_POINTS = 4  # exact for the product of two cubics
BENDING_POINTS = 2
OF_KNOTS = "knot_rules", "mass_over_knots"  # cached parts that do not change if the knots travel
# Cached parts that depend on the memory.
OF_MEMORY = ("axial", "energies", "_parts", "_memory_of_spans", "_natural", "_placed")


class CrossSection(Protocol):
    """The properties of a section that a thread uses; `thread.catalogue.Section` has them."""

    @property
    def diameter(self) -> float:
        """Diameter [m]."""

    @property
    def rhoA(self) -> float:
        """Mass per rest length [kg/m]."""

    @property
    def EA(self) -> float:
        """Axial stiffness [N]."""

    @property
    def EI(self) -> float:
        """Bending stiffness [N m²]."""

    @property
    def GJ(self) -> float:
        """Torsional stiffness [N m²]."""

    @property
    def rhoJ(self) -> float:
        """Polar moment of inertia of the mass per rest length [kg m]."""


def axial_points(spline: Spline) -> tuple[Array, Array]:
    """Return the parameters of the points of stretch, two per span, shape `(spans, 2)`, and which
    of them count.

    If a span has only one point, the second is the same and does not count. A span has two points
    if it is the first or the last of its piece, if it begins at a repeated knot or if it ends at a
    triple one. These are its Gauss points or, with travelling knots, its middle and this end.
    """
    breaks, repeats = np.unique(spline.knots, return_counts=True)
    left, right = breaks[:-1, None], breaks[1:, None]
    two = ((repeats[:-1] > 1) | (repeats[1:] >= LOCAL - 1))[:, None]
    if isinstance(spline, Placed):
        middle = 0.5 * (left + right)
        at_end = np.where((repeats[:-1] > 1)[:, None], np.hstack([left, middle]), np.hstack([middle, right]))
        points = np.where(two, at_end, middle)
    else:
        gauss = 0.5 * (left + right) + 0.5 * (right - left) * legendre(2)[0]
        points = np.where(two, gauss, 0.5 * (left + right))
    return points, np.hstack([np.ones_like(two), two])


def hole_rule(spline: Spline) -> GaussRule:
    """Return the rule of the ends of the spans over the parameter of the knots, shape `(spans, 2)`.

    The weight is half of the span at a hole, else zero. All weights are zero without travelling
    knots, because then no knot is at a hole.
    """
    ends = np.stack([spline.parameters[:-1], spline.parameters[1:]], axis=1)
    held = np.zeros(len(spline.parameters), dtype=bool)
    if isinstance(spline, Placed):
        held[spline.travel.at[spline.travel.holds]] = True
    return knot_rule(spline, ends, 0.5 * np.diff(ends) * np.stack([held[:-1], held[1:]], axis=1))


def exact_weights(spline: Spline, s: Array) -> Array:
    """Return quadrature weights, in the parameter of the knots, that integrate each function of T
    exactly.

    There are as many points `s` as functions of T: one fewer than control points in every piece.
    Raises `ThreadError` if a weight is not positive, because the spans are too unequal.
    """
    if s.size != spline.n - spline.pieces:
        raise ThreadError("knots: repeated knots at both ends of a span; put a span between them")
    points = np.split(s, spline.piece_starts[1:] - np.arange(1, spline.pieces))
    w = np.empty(0)
    for first, own in zip(spline.piece_starts, points, strict=True):
        t = spline.knots[first + 1 : first + own.size + LOCAL]
        w = np.append(w, np.linalg.solve(BSpline(t, np.eye(own.size), 2)(own).T, (t[3:] - t[:-3]) / 3.0))
    if not np.all(w > 0.0):
        raise ThreadError("knots: neighbouring spans differ too much for a positive rule; grade them more gently")
    return np.asarray(w, dtype=np.float64)


@dataclass(frozen=True)
class Points:
    """The evaluated thread of an iterate, which energy, force and tangent share.

    `strain` at the abscissae of `Thread.axial.s` [-]; `at`, one entry per energy.
    """

    strain: Array
    at: tuple[Any, ...]


@dataclass(frozen=True)
class Thread:
    """A spline thread with the section's mass and stiffness.

    `bending` False sets EI = 0. `damping` [1/s] is mass-proportional viscosity. `point_masses` (2,)
    [kg] are at the start and the end. `twist` adds the angle of the section to the coordinates of a
    control point, and torsion. Energies: ½∫EA ε² ds + ½∫EI κ² ds (§3; straight at rest) + ½∫GJ ω²
    ds; with a number of `springs` the energies of `thread.energies.springs` instead. `coil` [1/m]
    is the curvature at rest, towards the section's first direction (`thread.energies.coil`). This
    direction points to `coil_towards` (3,) at the start of the initial thread; None means a
    direction chosen by the code. `relaxation` is the relaxation of its stretch, None: no
    relaxation. `memory` has the earlier strains that the step uses, None if there are none
    (`thread.relaxation`).
    """

    spline: Spline
    section: CrossSection
    bending: bool = True
    damping: float = 0.0
    point_masses: tuple[float, float] = (0.0, 0.0)
    twist: bool = False
    springs: int | None = None
    coil: float = 0.0
    coil_towards: Array | None = None
    relaxation: Series | None = None
    memory: Memory | None = None

    def __post_init__(self) -> None:
        if not self.damping >= 0.0:
            raise ThreadError(f"damping: {self.damping} 1/s; allowed is 0 or more")
        if not min(self.point_masses) >= 0.0:
            raise ThreadError(f"mass of an end: {min(self.point_masses)} kg; allowed is 0 or more")
        if self.twist and not self.bending:
            raise ThreadError("twist: a twisted thread without bending stiffness collapses; give it bending")
        if self.coil and not self.twist:
            raise ThreadError("coil: the side to which a thread coils turns with its section; give it twist")
        if self.relaxation is not None and self.springs is not None:
            raise ThreadError("relaxation: springs do not relax; take the continuous energy")
        fewest = self.n - self.spline.pieces
        if self.springs is not None and self.springs < fewest:
            raise ThreadError(f"springs: {self.springs}; {self.n} control points need at least {fewest} springs")

    @property
    def travels(self) -> bool:
        """Whether the thread's knots travel with its holes."""
        return isinstance(self.spline, Placed)

    def on(self, spline: Spline) -> "Thread":
        """Return the thread on another spline; the same thread if the spline is its own."""
        return self if spline is self.spline else replace(self, spline=spline)

    def placed(self, s: Array) -> "Thread":
        """Return the thread with its holes at `s` (m,) [m]; the same thread if its knots are fixed
        or already there.
        """
        spline = self.spline
        if not isinstance(spline, Placed) or np.array_equal(spline.travel.places(s), spline.places):
            return self
        last, thread = self.__dict__.get("_placed", (None, self))  # an iterate asks for the same one several times
        if last is None or not np.array_equal(last, s):
            thread = replace(self, spline=spline.moved(s))
            thread.__dict__.update({name: getattr(self, name) for name in OF_KNOTS})
            self.__dict__["_placed"] = s.copy(), thread
        return thread

    def with_spline(self, spline: Spline) -> "Thread":
        """Return the thread on another spline; the number of springs grows with the number of
        functions of T.
        """
        more = spline.n - spline.pieces - (self.n - self.spline.pieces)
        return replace(self, spline=spline, springs=None if self.springs is None else self.springs + more)

    @property
    def coordinates(self) -> int:
        """Coordinates of a control point: x, y, z and, with twist, θ."""
        return POSITION + self.twist

    @cached_property
    def lever(self) -> Array:
        """Factors from coordinates to lengths, shape `(c,)`: 1 for x, y, z, and the diameter [m]
        for θ.
        """
        return np.array([1.0, 1.0, 1.0, self.section.diameter][: self.coordinates])

    @property
    def n(self) -> int:
        """Number of control points."""
        return self.spline.n

    @property
    def EA(self) -> float:
        """Axial stiffness in the step [N]."""
        if self.relaxation is None or self.memory is None:
            return self.section.EA
        return self.section.EA * float(self.relaxation.met(self.memory.dt))

    @property
    def EI(self) -> float:
        """Bending stiffness [N m²]; zero without bending."""
        return self.section.EI if self.bending else 0.0

    @cached_property
    def points_of_span(self) -> Indices:
        """Control points of each span, shape `(spans, 4)`."""
        return self.spline.first[:, None] + np.arange(LOCAL)

    @cached_property
    def knot_rules(self) -> tuple[GaussRule, GaussRule, GaussRule]:
        """The rules of bending, of stretch and of the holes over the parameter of the knots."""
        stretch = knot_rule(self.spline, *self.axial_parameters)
        return gauss_rule(self.spline.chi, BENDING_POINTS), stretch, hole_rule(self.spline)

    @cached_property
    def mass_over_knots(self) -> GaussRule:
        """The rule of the mass over the parameter of the knots."""
        return gauss_rule(self.spline.chi, MASS_POINTS)

    @cached_property
    def mass_rule(self) -> GaussRule:
        """Gauss rule of the mass."""
        return carried(self.spline, self.mass_over_knots)

    @cached_property
    def elastic_rule(self) -> GaussRule:
        """Gauss rule of the bending energy."""
        return carried(self.spline, self.knot_rules[0])

    @cached_property
    def axial_rule(self) -> GaussRule:
        """Rule of the stretching energy, mostly with one point in the middle of each span.

        The two end spans, a span that begins at a repeated knot, and a span that ends at a triple
        knot or at a cut have two points (`axial_points`).

        A cubic cannot keep |T| = 1 along a span with changing curvature. At the stiffness of a real
        suture, a full rule blocks its bending (membrane locking). The rule has n − 1 points per
        piece, as many as T has functions, so that every stretch is seen. Its weights integrate each
        of these functions exactly, so that a uniform tension is in equilibrium on any knots. A
        single point is stored as two equal points, so that all spans have the same shape.

        Between these points |T| can still fall to zero. A hole that imposes a sharp turn would lead
        there, because T·u = 0 holds for T = 0. The term `thread.kernels.curve.crushing`, on the
        rule of bending, prevents this, and `barrier` prevents it at the knots of holes.
        """
        return carried(self.spline, self.knot_rules[1])

    @cached_property
    def axial_parameters(self) -> tuple[Array, Array]:
        """Points and weights of `axial_rule` in the parameter of the knots, shape `(spans, 2)`
        each.

        Two equal points share their weight. Raises `ThreadError` as `exact_weights` does.
        """
        points, once = axial_points(self.spline)
        w = np.zeros(points.shape)
        w[once] = exact_weights(self.spline, points[once])
        return points, np.where(once.all(axis=1, keepdims=True), w, 0.5 * w.sum(axis=1, keepdims=True))

    # -- linear parts ------------------------------------------------------------------------------------------

    @cached_property
    def _line_mass(self) -> Array:
        """∫ρA b_i b_j ds in banded storage with three diagonals on each side, shape `(7, n)`."""
        points, reach, b = self.points_of_span, LOCAL - 1, self.mass_rule.b[:, :, 0]
        blocks = self.section.rhoA * np.einsum("eg,egi,egj->eij", self.mass_rule.w, b, b)
        at = (points[:, :, None] - points[:, None, :] + reach) * self.n + points[:, None, :]
        return np.bincount(at.ravel(), blocks.ravel(), (2 * reach + 1) * self.n).astype(float).reshape(-1, self.n)

    @cached_property
    def mass_diagonals(self) -> Array:
        """The mass matrix in banded storage, as `_line_mass`, shape `(7, n)` [kg]."""
        band = self._line_mass.copy()
        band[LOCAL - 1, [0, -1]] += self.point_masses
        return band

    @cached_property
    def mass_matrix(self) -> csr_matrix:
        """Consistent mass ∫ρA b_i b_j ds (eq. 3) plus the end masses, shape `(n, n)` [kg]; the same
        for x, y, z.
        """
        return csr_matrix(dia_array((self.mass_diagonals, np.arange(LOCAL - 1, -LOCAL, -1)), shape=(self.n, self.n)))

    @cached_property
    def largest_mass(self) -> float:
        """Largest entry of the mass matrix [kg]."""
        return float(np.abs(self.mass_diagonals).max())

    @cached_property
    def mass_band(self) -> Array:
        """The inertia of all coordinates in banded storage [kg, for θ kg m²].

        The inertia of the sections' spin about the tangent is ∫ρJ b_i b_j ds. The turn of the
        spin's axis with the thread (a gyroscopic couple) is neglected. Its ratio to the inertia of
        the mass is (diameter/wavelength)².
        """
        c, h = self.coordinates, self.half_band
        band = np.zeros((3 * h + 1, c * self.n))
        rows = 2 * h + c * np.arange(1 - LOCAL, LOCAL)
        for axis in range(c):
            spins = axis == POSITION
            band[rows, axis::c] = (
                self.section.rhoJ / self.section.rhoA * self._line_mass if spins else self.mass_diagonals
            )
        return band

    @cached_property
    def _lower_mass_band(self) -> Array:
        """The main and lower diagonals of the inertia, in Fortran order."""
        diagonal, reach = diagonal_of(self.mass_band), self.coordinates * (LOCAL - 1)
        return np.asfortranarray(self.mass_band[diagonal : diagonal + reach + 1])

    def momentum(self, v: Array) -> Array:
        """Return the inertia times control values `v` (n, c), shape `(n, c)`."""
        band = self._lower_mass_band
        return np.asarray(dsbmv(len(band) - 1, 1.0, band, v.ravel(), lower=1)).reshape(v.shape)

    @cached_property
    def largest_bending(self) -> float:
        """Bending stiffness of the control point with the shortest spans h around it, 8/3 EI/h³
        [N/m].
        """
        return 8.0 / 3.0 * self.EI / float(np.diff(self.spline.breaks).min()) ** 3

    @property
    def force_unit(self) -> float:
        """EI/L² (EA·10⁻⁹ without bending): the force scale of a thread without load [N]."""
        length = self.spline.end - self.spline.start
        return self.EI / length**2 if self.bending else 1e-9 * self.EA

    # -- elastic energies --------------------------------------------------------------------------------------

    @cached_property
    def spring_layout(self) -> SpringLayout | None:
        """Layout of the springs; None means continuous energies."""
        return None if self.springs is None else spread_springs(self.spline, self.springs)

    @cached_property
    def axial(self) -> AxialEnergy:
        """The energy of stretch and bending."""
        if self.spring_layout is not None:
            return Springs(self.spring_layout, self.EA, self.EI)
        rules = self.elastic_rule, self.axial_rule, carried(self.spline, self.knot_rules[2])
        return Continuous(self.spline.first, *rules, self.EA, self.EI, self._natural)

    @cached_property
    def stations(self) -> Stations:
        """Stations at which the twist is evaluated."""
        if self.spring_layout is not None:
            return self.spring_layout.stations
        return gauss_stations(self.spline, self.elastic_rule)

    @cached_property
    def energies(self) -> tuple[Energy, ...]:
        """The terms of the thread's elastic energy."""
        twist = (Torsion(self.stations, self.section.GJ),) if self.twist else ()
        coil = (Coil(self.stations, self.EI, self.coil),) if self.coil else ()
        return self.axial, *twist, *coil

    @cached_property
    def half_band(self) -> int:
        """Number of diagonals on each side of the main diagonal of the thread's matrices."""
        reach = max(LOCAL, *(energy.reach for energy in self.energies))
        return self.coordinates * reach - 1

    @cached_property
    def _parts(self) -> tuple[tuple[Elements, Energy], ...]:
        return tuple((self.elements(energy.first, energy.reach, energy.seen), energy) for energy in self.energies)

    def _each(self, points: Points) -> Iterator[tuple[tuple[Elements, Energy], Any]]:
        return zip(self._parts, points.at, strict=True)

    def elements(self, first: Indices, reach: int, seen: int) -> Elements:
        """Return groups of control points with their places in the thread's vectors and matrices."""
        return Elements(first, reach, seen, self.n, self.coordinates, self.half_band)

    def band_at(self, first: Indices, blocks: Array) -> Array:
        """Return the sum, in banded storage, of matrices (m, 4, 4, 3, 3) of the positions of four
        points from `first` (m,) on.
        """
        return self.elements(first, LOCAL, POSITION).band(blocks)

    def vector(self, blocks: Array) -> Array:
        """Return the sum of span vectors of the positions, `(spans, 4, 3)`, at the control points,
        shape `(n, c)`.
        """
        return self.elements(self.spline.first, LOCAL, POSITION).vector(blocks)

    def points(self, q: Array, frame: Frame | None = None) -> Points:
        """Return the thread at the integration points of its energies.

        A thread with twist needs the `frame` at the start of the step, from which θ is measured;
        None without twist.
        """
        at = tuple([energy.evaluate(q, frame) for energy in self.energies])
        return Points(at[0].strain, at)

    def energy(self, points: Points) -> float:
        """Return the elastic energy [J]."""
        return sum(energy.energy(at) for (_, energy), at in self._each(points))

    def gradient(self, points: Points) -> Array:
        """Return the derivative of the elastic energy by the control values, shape `(n, c)` [N,
        with twist N m].
        """
        return total([elements.vector(energy.gradient(at)) for (elements, energy), at in self._each(points)])

    def tangent(self, points: Points, N: Array) -> Array:
        """Return the second derivative of the elastic energy, banded.

        `N` [N] is the axial force at the points of the strain: `EA * points.strain` for the exact
        Hessian, the iterated force for the mixed-integration-point Newton.
        """
        return total([elements.band(energy.tangent(at, N)) for (elements, energy), at in self._each(points)])

    def next_axial_force(self, points: Points, dq: Array) -> Array:
        """Return N of the next iterate, EA (ε + T·δT) [N]: the solution of the linearised equation
        N/EA = ε(q).
        """
        return self.axial.next_axial_force(points.at[0], dq)

    # -- relaxation --------------------------------------------------------------------------------------------

    @cached_property
    def _memory_of_spans(self) -> Memory | None:
        """The memory of each span, `(spans, 1)`; None for a thread without memory."""
        return None if self.memory is None else self.memory.over(self.spline.breaks)

    @cached_property
    def _natural(self) -> tuple[Array, Array] | None:
        """The natural strain of each span, `(spans,)` [-], and its excess at the ends of the span,
        `(spans, 2)` [1/m].

        The excess is over the length of the span. None means zero.
        """
        if self.relaxation is None or self._memory_of_spans is None:
            return None
        natural, breaks = self._memory_of_spans.natural(self.relaxation), self.spline.breaks
        at = self.natural_at(breaks)
        return natural[:, 0], (np.stack([at[:-1], at[1:]], axis=1) - natural) / np.diff(breaks)[:, None]

    def natural_at(self, s: Array) -> Array:
        """Return the natural strain at abscissae `s` [m], with the shape of `s` [-]."""
        if self.relaxation is None or self.memory is None:
            return np.zeros(s.shape)
        return np.interp(s, self.memory.s, self.memory.natural(self.relaxation))

    def whole_strain(self, elastic: Array) -> Array:
        """Return the strain ε at the abscissae of `Thread.axial.s` from `elastic` = ε − ε̄ [-]."""
        return elastic if self._natural is None else np.asarray(elastic + self._natural[0][:, None])

    def with_memory(self, memory: Memory | None) -> "Thread":
        """Return the thread with another memory; the same thread if the memory is its own.

        Cached parts that do not depend on the memory are not computed again.
        """
        if memory is self.memory:
            return self
        other = copy(self)
        for name in OF_MEMORY:
            other.__dict__.pop(name, None)
        object.__setattr__(other, "memory", memory)
        return other

    def after_step(self, q: Array, dt: float) -> Memory:
        """Return the memory at the start of a step of `dt` [s], after a step that ended at control
        values `q` (n, c).

        A thread without memory has been stretched to this state in no time.
        """
        assert self.relaxation is not None
        of_spans = self.whole_strain(self.axial.evaluate(q[:, :POSITION], None).strain).mean(axis=1)
        material = np.linspace(self.spline.start, self.spline.end, POINTS)
        span = np.searchsorted(self.spline.breaks, material, side="right") - 1
        strain = of_spans[np.clip(span, 0, len(of_spans) - 1)]
        if self.memory is None:
            return Memory(material, strain, np.outer(self.relaxation.shares, strain), dt)
        return Memory(material, strain, self.memory.held_after(self.relaxation, strain), dt)

    def stored_energy(self, points: Points) -> float:
        """Return the elastic energy [J]; for a relaxing thread the energy of its springs at the end
        of the step.
        """
        energy, series, memory = self.energy(points), self.relaxation, self._memory_of_spans
        if series is None or memory is None:
            return energy
        stored = self.section.EA * memory.stored(series, self.whole_strain(points.strain))
        return energy + float(np.sum(self.axial_rule.w * (stored - 0.5 * self.EA * points.strain**2)))

    def dissipated(self, points: Points) -> float:
        """Return the dissipation by relaxation in the step [J]."""
        series, memory = self.relaxation, self._memory_of_spans
        if series is None or memory is None:
            return 0.0
        taken = memory.dissipated(series, self.whole_strain(points.strain))
        return float(self.section.EA * np.sum(self.axial_rule.w * taken))

    # -- twist -------------------------------------------------------------------------------------------------

    def untwisted_frame(self, q: Array) -> Frame | None:
        """Return the frame of the initial thread `q` without twist; None if the thread has no
        twist.

        Raises `ThreadError` if `coil_towards` is along the thread.
        """
        if not self.twist:
            return None
        if self.coil_towards is not None:
            return untwisted_frame(self.spline, self.stations, q, self.coil_towards)
        along = np.abs(self.spline.curve(q[:, :POSITION], [self.spline.start])[0, 1])
        return untwisted_frame(self.spline, self.stations, q, np.eye(POSITION)[np.argmin(along)])

    def transport_frame(self, frame: Frame | None, q: Array) -> Frame | None:
        """Return the frame after the thread has moved to `q`; None for a thread without twist."""
        return None if frame is None else transport_frame(self.stations, frame, q)

    def interpolate_frame(self, frame: Frame, other: "Thread", q: Array) -> Frame:
        """Return the frame at this thread's stations on the curve `q`, interpolated from the
        stations of an `other` thread.

        This thread can have cuts that the other does not have.
        """
        return interpolate_frame(other.spline, frame, other.stations, self.stations, q)

    def turns_too_far(self, frame: Frame | None, q: Array) -> bool:
        """Return whether a tangent has turned too far for the frame to follow."""
        return frame is not None and turns_too_far(frame, self.stations.curve(q)[0])

    def torque(self, q: Array, frame: Frame) -> Array:
        """Return GJ ω about the tangent at the stations [N m], positive for a right-handed twist."""
        return self.section.GJ * evaluate(self.stations, q, frame).omega

    def torque_at(self, s: Array, home: Array, q: Array, frame: Frame) -> Array:
        """Return the torque at abscissae `s` (m,), interpolated between the stations [N m].

        `home` identifies the pieces. The torque is most accurate at the stations.
        """
        stations = self.stations
        return self.spline.interpolate(s, home, stations.s, stations.home, self.torque(q, frame))


def total(parts: list[Array]) -> Array:
    """Return the sum of arrays; a single array is returned unchanged."""
    return parts[0] if len(parts) == 1 else np.sum(parts, axis=0)
