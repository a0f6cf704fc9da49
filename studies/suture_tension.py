"""Tension of a suture: how far it moves two holes of an organ, the stress around them, and where linear theory ends.

A thread comes down into one hole of a block, runs below its surface to the other and up again. Its start is held, its
end is drawn up by a dead load T, so that in linear theory both holes are drawn up by T and towards each other by T.
Each thing is changed alone about a reference case: a 3-0 braid under 0.1 N, 0.5 MPa, holes 10 mm apart on the surface,
a footprint of 1 mm, no friction. The bite's depth is that of the holes' centres: where the tissue bears the thread is
all that this model knows of a channel, so a deeper bite is one that bears deeper (a ball instead of a disc).

Stress is no nodal maximum, which would grow with the mesh, but that averaged over the half ball below a hole, and the
mean round a ring about it. It is that of a P2 mesh of its own under the forces of the run: a uniform organ's stress
does not depend on E.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from threadpoolctl import threadpool_limits

import tissue
from coupling.errors import CouplingError
from coupling.observation import site_compliance, site_forces
from meshes.block import graded_block_structured
from meshes.grading import Grading
from studies.convergence import Verdict, verdict
from studies.figure import COLOURS, MARKERS, panels, ticks
from studies.friction import bent_ratio
from studies.half_space import TwoHoles, half_ball
from studies.limits import LINEAR, bearing_strain, not_settled, spans_too_coarse
from studies.scenario import Scenario, parse
from studies.simulation import OrganRun, Simulation, prepare, recorded
from studies.study import Study, StudyError, Table, unit
from thread.catalogue import suture

Array = NDArray[np.float64]

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
    load_steps: int = unit("-")
    tension: float = unit("N")  # asked for
    youngs_modulus: float = unit("Pa")
    bite: float = unit("m")
    depth: float = unit("m")  # of the holes' centres
    footprint: float = unit("m")
    mu: float = unit("-")
    given: float = unit("m")  # by which the hand at the start gives way
    ring: float = unit("footprints")  # radius of the ring on which stress is taken
    refinement: float = unit("-")  # of the mesh for stress

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

    load: float = unit("N")  # that was reached
    entry_along: float = unit("m")
    entry_normal: float = unit("m")
    exit_along: float = unit("m")
    exit_normal: float = unit("m")
    theory_along: float = unit("m")  # of the exit, in a half-space
    theory_normal: float = unit("m")
    approach: float = unit("m")
    theory_approach: float = unit("m")
    drawn: float = unit("m")  # through the exit, since a taut thread in the undeformed organ
    theory_drawn: float = unit("m")
    held: float = unit("N")  # tension before the entry
    entered: float = unit("N")  # after it
    leaving: float = unit("N")  # before the exit
    pulled: float = unit("N")  # after it
    theory_held: float = unit("N")
    force_along: float = unit("N")  # on the exit
    force_normal: float = unit("N")
    couple: float = unit("N m")
    turn: float = unit("-")  # of the frame of a hole: what ⟨∇U⟩ makes of it
    compliance_along: float = unit("m/N")
    compliance_normal: float = unit("m/N")
    mean_von_mises: float = unit("Pa")
    mean_largest: float = unit("Pa")
    mean_smallest: float = unit("Pa")
    ring_von_mises: float = unit("Pa")
    ring_largest: float = unit("Pa")
    ring_smallest: float = unit("Pa")
    theory_mean_von_mises: float = unit("Pa")
    theory_mean_largest: float = unit("Pa")
    theory_ring_von_mises: float = unit("Pa")
    theory_ring_largest: float = unit("Pa")
    cells: float = unit("m")  # of the mesh for stress, (V/N)^⅓
    residual: float = unit("-")  # |C f − u| over |u|
    span_ratio: float = unit("-")
    kinetic: float = unit("J")
    elastic: float = unit("J")
    clear: bool  # of what the sub-grid compliance does not reckon with
    failed: str

    @property
    def moved(self) -> float:
        """How far the hole that moved farther did [m]."""
        return float(max(np.hypot(self.entry_along, self.entry_normal), np.hypot(self.exit_along, self.exit_normal)))

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


def main(
    tissues: Sequence[str] = tuple(TISSUES),
    tensions: Sequence[float] = (0.02, 0.2, 2.0, 5.0),
    moduli: Sequence[float] = (1e5, 2e5, 5e5, 2e6, 1e7),
    bites: Sequence[float] = (0.005, 0.0075, 0.01, 0.015, 0.02),
    depths: Sequence[float] = (0.0, 2e-3, 4e-3, 8e-3),
    footprints: Sequence[float] = (0.5e-3, 1e-3, 2e-3),
    mus: Sequence[float] = (0.0, 0.1, 0.2, 0.3, 0.4),
    distances: Sequence[float] = (1.5, 2.0, 3.0, 4.0),
    refinements: Sequence[float] = (1.5, 2.0, 2.5, 3.0),
    soft_ways: Sequence[str] = ("10 load steps", "40 load steps", "damped motion"),
    refinement: float = 1.5,
) -> Iterator[Row]:
    """Every load step of the tensions, by tissue and up to the first that fails; the last one of everything else.

    Raises `StudyError`.
    """
    check(tissues, soft_ways, bites, depths, footprints, refinements)
    check_positive({"tensions": tensions, "moduli": moduli, "distances": distances})
    if min(mus) < 0.0 or max(mus) >= 1.0:
        raise StudyError(f"mus = {list(mus)} is refused: give coefficients from 0 to below 1")
    case = replace(REFERENCE, refinement=refinement)
    for name in tissues:
        yield from over_tension(replace(case, sweep="tension", name=name, youngs_modulus=TISSUES[name]), tensions)
    yield from (last(replace(case, sweep="stiffness", youngs_modulus=E)) for E in moduli)
    yield from (last(replace(case, sweep="friction", mu=mu, given=GIVEN)) for mu in mus)
    fine = replace(case, sweep="distance", refinement=max((refinement, *refinements)))
    yield from (last(replace(fine, ring=r)) for r in distances)
    yield from (last(replace(case, sweep="cells", refinement=k)) for k in sorted(refinements, reverse=True))
    yield from (last(replace(case, sweep="bite width", bite=w)) for w in bites)
    yield from (last(replace(case, sweep="bite depth", depth=c)) for c in depths)
    yield from (last(replace(case, sweep="footprint", footprint=a)) for a in footprints)
    yield from (last(replace(case, sweep="direction", name=holes, holes=holes)) for holes in ("free", "normal"))
    soft = replace(
        case, sweep="soft organ", suture="2-0 polypropylene", knots="fixed", holes="normal", tension=0.5,
        youngs_modulus=TISSUES["liver"],
    )  # fmt: skip
    yield from (last(replace(soft, name=name, **SOFT[name])) for name in soft_ways)


def check(
    tissues: Sequence[str],
    soft_ways: Sequence[str],
    bites: Sequence[float],
    depths: Sequence[float],
    footprints: Sequence[float],
    refinements: Sequence[float],
) -> None:
    """Refuse what has no meaning here. Raises `StudyError`."""
    for name in tissues:
        if name not in TISSUES:
            raise StudyError(f'tissues: "{name}" is refused: those known are {", ".join(TISSUES)}')
    for name in soft_ways:
        if name not in SOFT:
            raise StudyError(f'soft_ways: "{name}" is refused: those known are {", ".join(SOFT)}')
    if min(bites) < 4.0 * REFERENCE.footprint or max(bites) > 0.5 * SIZE[0]:
        raise StudyError(f"bites = {list(bites)} is refused: give 4 footprints (4e-3) to half the block (0.04) [m]")
    if any(0.0 < depth < CLEAR * REFERENCE.footprint for depth in depths) or max(depths) > 0.5 * SIZE[2]:
        raise StudyError(f"depths = {list(depths)} is refused: give 0 or 2 footprints (2e-3) to half the block [m]")
    if min(footprints) <= 0.0 or max(footprints) > 0.25 * REFERENCE.bite:
        raise StudyError(f"footprints = {list(footprints)} is refused: give numbers above 0 to 2.5e-3 [m]")
    if len(set(refinements)) == 2 or min(refinements) < 1.0:
        raise StudyError(
            f"refinements = {list(refinements)} is refused: give one, or three for a verdict, none below 1"
        )


def check_positive(numbers: Mapping[str, Sequence[float]]) -> None:
    """Refuse tensions, moduli and distances that are none. Raises `StudyError`."""
    for name, values in numbers.items():
        if min(values) <= 0.0:
            raise StudyError(f"{name} = {list(values)} is refused: give numbers above 0")


# --- runs -------------------------------------------------------------------------------------------------


def over_tension(case: Case, tensions: Sequence[float]) -> Iterator[Row]:
    """Runs to one tension after the other, and no further than the first that fails."""
    for tension in sorted(tensions):
        for row in run(replace(case, tension=tension)):
            yield row
        if row.failed:
            return


def last(case: Case) -> Row:
    """The end of a run."""
    *_, row = run(case)
    return row


def run(case: Case) -> Iterator[Row]:
    """Every load step; where one fails, the last equilibrium once more with the name of what failed."""
    simulation = prepare(scenario(case))
    now = simulation.beginning()
    while now.number < simulation.steps:
        before = now
        try:
            with threadpool_limits(limits=1, user_api="blas"):
                now = simulation.next(now)
        except CouplingError as error:
            yield measured(case, simulation, before, f"{type(error).__name__}: {error}")
            return
        if not now.state.present.all():
            yield measured(case, simulation, before, "left its hole: a hole came up to the hand that holds the start")
            return
        if case.way == "static" or now.number == simulation.steps:
            yield measured(case, simulation, now, "")


def scenario(case: Case) -> Scenario:
    """A thread down into a block and up again, its start held, its end drawn up."""
    x, bottom = 0.5 * case.bite, -case.depth - DIP
    hole: dict[str, object] = {"direction": case.holes, "footprint": case.footprint}
    if case.mu:
        hole["friction"] = {"static": case.mu, "kinetic": case.mu}
    ramp = RELAXED if case.way == "dynamic" else 0.0
    still: dict[str, object] = {"kind": "static", "load_steps": case.load_steps}
    return parse(
        {
            "title": f"suture tension: {case.sweep} {case.name}",
            "tissue": {
                "youngs_modulus": case.youngs_modulus,
                "poisson_ratio": POISSON,
                "density": 1070.0,
                "inertia": False,
                "clamp": ["bottom"],
                "mesh": {
                    "kind": "block",
                    "generator": "structured",
                    "size": list(SIZE),
                    "h": 0.01,
                    "h_site": case.footprint,
                    "growth": 1.8,
                },
            },
            "thread": {
                "suture": case.suture,
                "control_points": 60,
                "resolution": case.knots,
                "damping": DAMPING if ramp else 0.0,
                "path": [[-x, 0.0, LEG], [-x, 0.0, bottom], [x, 0.0, bottom], [x, 0.0, LEG]],
                "start": {"kind": "driven", "waypoints": [[0.0, -x, 0.0, LEG], [1.0, -x, 0.0, LEG - case.given]]},
                "end": {"kind": "pulled", "force": [0.0, 0.0, case.tension], "ramp": ramp},
            },
            "piercing": [
                {"name": name, "at": [float(c) for c in at], **hole}
                for name, at in zip(("entry", "exit"), case.places, strict=True)
            ],
            "solve": {"duration": RELAXED, "dt": RELAXED_STEP} if ramp else still,
        }
    )


def measured(case: Case, simulation: Simulation, now: OrganRun, failed: str) -> Row:
    """What there is to know of an equilibrium, beside theory."""
    seen, f = recorded(now), site_forces(now.system, now.state)
    load = case.tension * now.state.time / simulation.scenario.solve.duration
    entry, leave = seen.piercings
    C, moved = answer(case, now)
    tensions = in_theory(case, load)
    theory = case.theory.displacements(*tensions)
    return Row(
        **asdict(case),
        load=load,
        entry_along=float(moved[0]),
        entry_normal=float(moved[2]),
        exit_along=-float(moved[9]),
        exit_normal=float(moved[11]),
        theory_along=-float(theory[1, 0]),
        theory_normal=float(theory[1, 1]),
        approach=float(moved[0] - moved[9]),
        theory_approach=float(theory[0, 0] - theory[1, 0]),
        drawn=LEG + case.depth + case.bite - leave.s,
        theory_drawn=drawn_in_theory(case, theory, tensions),
        held=entry.tension_before,
        entered=entry.tension_after,
        leaving=leave.tension_before,
        pulled=leave.tension_after,
        theory_held=tensions[0],
        force_along=-float(f[1, 0]),
        force_normal=float(f[1, 2]),
        couple=float(np.linalg.norm(leave.couple)),
        turn=float(np.abs(moved.reshape(2, 3, 3)[:, 1:]).max()),
        compliance_along=float(C[9, 9]),
        compliance_normal=float(C[11, 11]),
        **stresses(case, now.state.organ),
        cells=float((np.prod(SIZE) / fine_organ(geometry(case)).elasticity.mesh.nelements) ** (1.0 / 3.0)),
        residual=float(np.linalg.norm(C @ f.ravel() - moved) / max(np.linalg.norm(moved), np.finfo(float).tiny)),
        span_ratio=seen.span_ratio,
        kinetic=now.energies.kinetic,
        elastic=now.energies.elastic,
        clear=all(gap["holds"] for gap in simulation.subgrid.values()),
        failed=failed,
    )


def answer(case: Case, now: OrganRun) -> tuple[Array, Array]:
    """Compliance `(18, 18)` of the holes and how far they moved `(18,)`; in the sweep of cells, what the mesh for
    stress makes of the forces of the run."""
    organ = now.system.organ
    if case.sweep == "cells":
        C = fine_organ(geometry(case)).operator(0.0, 0.0).C / case.youngs_modulus
        return C, C @ site_forces(now.system, now.state).ravel()
    return site_compliance(now.system, now.state), now.state.y.ravel() - organ.y0


def in_theory(case: Case, load: float) -> tuple[float, float, float]:
    """Tension before, between and after holes that each turn a bending thread by 90° [N]."""
    ratio = bent_ratio(case.mu, 0.5 * np.pi)
    return load / ratio**2, load / ratio, load


def drawn_in_theory(case: Case, moved: Array, tensions: tuple[float, float, float]) -> float:
    """What comes through the exit [m]: what holes that moved `(2, 2)` [m] and the hand give, and stretch, less what the
    bends take: 2√(EI/T)(1 − cos θ/2) of an elastica that turns by θ on one side of a hole."""
    held, between, _ = tensions
    if between == 0.0:
        return 0.0
    section, stretched = suture(case.suture), held * (LEG + case.depth) + between * case.bite
    inside, outside = (45.0, 45.0) if case.holes == "free" else (90.0, 0.0)
    bends = 2.0 * bend(section.EI, between, inside) + bend(section.EI, held, outside)
    given = case.given * tensions[2] / case.tension
    return float(moved[0, 0] - moved[1, 0] + moved[0, 1] + given + stretched / section.EA - bends)


def bend(EI: float, tension: float, turn: float) -> float:
    """Length that an elastica of stiffness EI [N m²] takes to turn by `turn` [degree] from its line [m]."""
    return float(2.0 * np.sqrt(EI / tension) * (1.0 - np.cos(np.radians(turn) / 2.0)))


# --- stress -----------------------------------------------------------------------------------------------


def geometry(case: Case) -> Case:
    """The case without what stress under given forces does not depend on, nor on the ring."""
    kept = {name: getattr(case, name) for name in ("bite", "depth", "footprint", "holes", "refinement")}
    return replace(REFERENCE, **kept)


@lru_cache(maxsize=3)
def fine_organ(case: Case) -> tissue.QuasiStaticOrgan:
    """The organ of a `geometry` on P2 cells that resolve its holes, E = 1 Pa."""
    k, a = case.refinement, case.footprint
    mesh = graded_block_structured(SIZE, Grading(SIZE[0], COARSEST * a / k, GROWTH ** (1.0 / k), a), case.places)
    body = tissue.elasticity(mesh, tissue.Material(1.0, POISSON, 1.0), "P2", ["bottom"])
    direction = "normal" if case.holes == "normal" else None
    sites = [tissue.Site(at, a, direction=direction) for at in case.places]
    return tissue.QuasiStaticOrgan(body, tissue.build_sites(body, sites))


@dataclass(frozen=True)
class Probe:
    """Where stress is taken: the recovery at the nodes, and the `points` of ball and ring from them, the ball's with
    `weights`."""

    recovery: tissue.StressRecovery
    points: csr_matrix
    weights: Array

    def tensors(self, U: Array) -> tuple[Array, Array]:
        """Mean stress below the exit `(1, 6)` and stress round the ring `(k, 6)` [Pa]."""
        values, count = np.asarray(self.points @ self.recovery.stress(U)), len(self.weights)
        return self.weights[None] @ values[:count], values[count:]


@lru_cache(maxsize=8)
def probe(case: Case, ring: float) -> Probe:
    """The exit's probe of a `geometry`."""
    body, (points, weights) = fine_organ(case).elasticity, below(case)
    at = tissue.interpolation(body, np.vstack([points, around(case, ring)]))
    return Probe(tissue.stress_recovery(body), at, weights)


def below(case: Case) -> tuple[Array, Array]:
    """Points of the half ball below the exit `(k, 3)` [m], and their weights."""
    points, weights = half_ball()
    return case.places[1] + case.footprint * points, weights


def around(case: Case, ring: float) -> Array:
    """Points of a ring about the exit, half a footprint below it, shape `(k, 3)` [m]."""
    angle = 2.0 * np.pi * (np.arange(ROUND) + 0.5) / ROUND
    circle = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.full(ROUND, -0.5)])
    return np.asarray(case.places[1] + case.footprint * circle)


def stresses(case: Case, state: tissue.OrganState) -> dict[str, Any]:
    """Von Mises and principal stresses under the forces of a state, measured and in the half-space [Pa]."""
    shape = geometry(case)
    mean, ring = probe(shape, case.ring).tensors(fine_organ(shape).displacement(state))
    out = named("mean", mean) | named("ring", ring)
    theory = dict.fromkeys(THEORY, float("nan"))
    if case.depth == 0.0 and case.holes == "free":
        forces = state.f_y.reshape(2, 9)[:, :3]
        exact = case.theory.mean_stress(1, forces)[None], case.theory.stress(around(case, case.ring), forces)
        known = named("mean", flat(exact[0])) | named("ring", flat(exact[1]))
        theory = {name: known[name.removeprefix("theory_")] for name in THEORY}
    return out | theory


def named(where: str, stress: Array) -> dict[str, float]:
    """Means over points of the von Mises, the largest and the smallest principal stress of `(k, 6)` [Pa]."""
    xx, yy, zz, xy, yz, xz = stress.T
    matrix = np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), 2, 0)
    principal = np.linalg.eigvalsh(matrix).mean(axis=0)
    return {
        f"{where}_von_mises": float(tissue.von_mises(stress).mean()),
        f"{where}_largest": float(principal[2]),
        f"{where}_smallest": float(principal[0]),
    }


def flat(stress: Array) -> Array:
    """Tensors `(k, 3, 3)` as xx, yy, zz, xy, yz, xz, shape `(k, 6)`."""
    return np.column_stack([stress[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))])


# --- table and remarks ------------------------------------------------------------------------------------

VARIED = {  # by sweep: what is written of its case
    "stiffness": lambda row: f"E = {row.youngs_modulus / KILO:g} kPa",
    "friction": lambda row: f"μ = {row.mu:g}",
    "distance": lambda row: f"ring of {row.ring:g} footprints",
    "bite width": lambda row: f"w = {row.bite / MILLI:g} mm",
    "bite depth": lambda row: f"c = {row.depth / MILLI:g} mm",
    "footprint": lambda row: f"a = {row.footprint / MILLI:g} mm",
    "cells": lambda row: f"h = {row.cells / MILLI:.3g} mm",
}


def said(row: Row) -> str:
    """What a row's case is, in words."""
    return row.name or VARIED[row.sweep](row)


def of(rows: Sequence[Row], sweep: str) -> list[Row]:
    """The rows of a sweep."""
    return [row for row in rows if row.sweep == sweep]


def by_tissue(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Load steps of the tensions by tissue, by load; the last may be one that failed."""
    runs = sorted(of(rows, "tension"), key=lambda row: (row.load, bool(row.failed)))
    return {
        name: [row for row in runs if row.name == name] for name in dict.fromkeys(x.name for x in of(rows, "tension"))
    }


def table(rows: Sequence[Row]) -> Table:
    """A line a run, of the tensions the last load step of each."""
    head = (
        "changed", "case", "T [N]", "u along [mm]", "u normal [mm]", "half-space [mm]", "u/a [-]", "approach [mm]",
        "half-space [mm]", "drawn through [mm]", "theory [mm]", "T held, between, pulled [N]", "theory [N]",
        "force along, normal [N]", "couple [N mm]", "below: von Mises, σ₁, σ₃ [kPa]", "half-space [kPa]",
        "ring: von Mises, σ₁, σ₃ [kPa]", "half-space [kPa]", "T/(d ℓ E) [-]", "verdict",
    )  # fmt: skip
    return Table(head, [line(row) for row in rows if row.sweep != "tension" or row.failed or row.load == row.tension])


def line(row: Row) -> tuple[str, ...]:
    """The cells of a row."""
    mm, kPa, side = 1.0 / MILLI, 1.0 / KILO, in_theory(row, row.load)
    return (
        row.sweep,
        said(row),
        f"{row.load:.3g}",
        f"{row.exit_along * mm:.4g}",
        f"{row.exit_normal * mm:.4g}",
        f"{row.theory_along * mm:.4g}, {row.theory_normal * mm:.4g}",
        f"{row.moved / row.footprint:.3g}",
        f"{row.approach * mm:.4g}",
        f"{row.theory_approach * mm:.4g}",
        f"{row.drawn * mm:.4g}",
        f"{row.theory_drawn * mm:.4g}",
        f"{row.held:.4g}, {row.leaving:.4g}, {row.pulled:.4g}",
        f"{side[0]:.4g}, {side[1]:.4g}, {side[2]:.4g}",
        f"{row.force_along:.4g}, {row.force_normal:.4g}",
        f"{row.couple * mm:.3g}",
        f"{row.mean_von_mises * kPa:.4g}, {row.mean_largest * kPa:.4g}, {row.mean_smallest * kPa:.4g}",
        in_kilo(row.theory_mean_von_mises, row.theory_mean_largest),
        f"{row.ring_von_mises * kPa:.4g}, {row.ring_largest * kPa:.4g}, {row.ring_smallest * kPa:.4g}",
        in_kilo(row.theory_ring_von_mises, row.theory_ring_largest),
        f"{row.bearing:.2g}",
        judged(row),
    )


def in_kilo(*values: float) -> str:
    """Numbers [k…], or that there are none."""
    return "none" if np.isnan(values[0]) else ", ".join(f"{value / KILO:.4g}" for value in values)


def judged(row: Row) -> str:
    """What a row is worth."""
    if row.failed:
        return f"FAILED: {row.failed.split(':')[0]}"
    return "linear" if row.is_linear else "BEYOND linear"


def has_ladder(rows: Sequence[Row]) -> bool:
    """Whether there are cells enough for a verdict."""
    return len({row.cells for row in of(rows, "cells")}) >= 3


def verdict_on(rows: Sequence[Row], quantity: str) -> Verdict:
    """The verdict on a quantity of the cells."""
    runs = of(rows, "cells")
    return verdict([row.cells for row in runs], [getattr(row, quantity) for row in runs], FORMAL[quantity])


def limits(runs: Sequence[Row]) -> tuple[float, float]:
    """Tension at which the holes have moved by LINEAR footprints, infinite where they have not, and that at which the
    bearing strain T/(d ℓ E) is LINEAR [N]; below the first load step both are proportional."""
    loads, moved = [0.0, *(row.load for row in runs)], [0.0, *(row.moved / row.footprint for row in runs)]
    moving = float(np.interp(LINEAR, moved, loads)) if moved[-1] > LINEAR else float("inf")
    return moving, LINEAR * runs[0].load / runs[0].bearing


def ranges(rows: Sequence[Row]) -> list[str]:
    """By tissue: up to which tension theory is linear, and whether a clinical one is."""
    out = []
    for name, runs in by_tissue(rows).items():
        moving, bearing = limits(runs)
        clinical, source = CLINICAL[name]
        first = min(moving, bearing)
        how = f"BEYOND, {clinical / first:.2g} times" if clinical > first else "within"
        far = f"{moving:.2g} N" if np.isfinite(moving) else f"more than {runs[-1].load:g} N"
        out.append(
            f"{name}, E = {runs[0].youngs_modulus / KILO:g} kPa: a hole has moved by {LINEAR} footprints at {far}, "
            f"T/(d ℓ E) is {LINEAR} at {bearing:.2g} N; a clinical tension of {clinical:g} N ({source}) is {how}"
        )
    return out


def slopes(rows: Sequence[Row]) -> list[str]:
    """Small-tension slopes over those of the half-space, and the residual of C f = u."""
    small = [row for row in of(rows, "tension") if row.is_linear and row.is_taut and not row.failed]
    out = []
    for way in ("along", "normal"):
        ratio = [getattr(row, f"exit_{way}") / getattr(row, f"theory_{way}") - 1.0 for row in small]
        if ratio:
            spread = f"{100 * min(ratio):+.2g} to {100 * max(ratio):+.2g} %"
            out.append(f"linear range, taut thread: the exit moves {way} by {spread} of what it does in a half-space")
    for way, k in (("along", 0), ("normal", 1)):
        block = getattr(rows[0], f"compliance_{way}") / rows[0].theory.compliance[k, k] - 1.0
        out.append(f"block and cells of the runs have {100 * block:+.2g} % of the half-space's compliance {way}")
    out.append(f"compliance times reported force is the reported displacement within {max_residual(rows):.1g}")
    return out


def max_residual(rows: Sequence[Row]) -> float:
    """Largest residual of C f = u."""
    return max(row.residual for row in rows)


def remarks(rows: Sequence[Row]) -> list[str]:
    """Ranges by tissue, slopes, verdicts on the cells, and what is beyond, failed, not settled or too near."""
    out = [*ranges(rows), *slopes(rows)]
    for quantity, name in QUANTITIES.items():
        if has_ladder(rows):
            found, off = verdict_on(rows, quantity), off_theory(rows, quantity)
            word = found.text if found.kind == "converged" else f"NOT CONVERGED ({found.text})"
            out.append(f"cells, {name}: {word}" + ("" if np.isnan(off) else f", {off:+.1%} off the half-space"))
    out += of_the_sweeps(rows)
    if not has_ladder(rows):
        out.append("cells: no ladder was run, so that no stress is SHOWN TO CONVERGE; the preset full has one")
    return list(dict.fromkeys([*out, *(line for row in rows for line in unsupported(row))]))


def unsupported(row: Row) -> list[str]:
    """What failed, is beyond, did not settle, is too coarse or too near in a row."""
    name, out = f"{row.sweep}, {said(row)}, {row.load:.3g} N", []
    if row.failed:
        out.append(f"{name}: FAILED beyond, {row.failed}")
    elif row.sweep not in ("tension", "cells", "distance") and not row.is_linear:
        out.append(f"{name}: {beyond(row)}")
    if row.gap < row.footprint and (row.failed or row.load == row.tension):
        where = f"the holes are {row.gap / row.footprint:.2g} footprints apart, of {row.bite / row.footprint:g}"
        out.append(f"{name}: {where}, and nothing keeps them apart: the MODEL ENDS there")
    if row.way == "dynamic":
        out += not_settled(name, row.kinetic, row.elastic)
    if not row.clear:
        out.append(f"{name}: a hole is TOO NEAR an edge, a clamp or another hole for its sub-grid compliance")
    return out if row.failed else [*out, *spans_too_coarse(name, row.span_ratio)]


def of_the_sweeps(rows: Sequence[Row]) -> list[str]:
    """How far the stress of the sweeps is from that of the half-space under the same forces."""
    runs = [row for row in rows if row.sweep not in ("cells", "distance") and np.isfinite(row.theory_ring_von_mises)]
    out = []
    for where, words in (("mean", "below the hole"), ("ring", "on the ring")):
        name = f"{where}_von_mises"
        known = [row for row in runs if getattr(row, f"theory_{name}") > 0.0]
        off = [getattr(row, name) / getattr(row, f"theory_{name}") - 1.0 for row in known]
        if off:
            spread = f"{min(off):+.1%} to {max(off):+.1%}"
            out.append(
                f"sweeps, cells of {runs[0].cells / MILLI:.2g} mm: von Mises {words} {spread} off the half-space"
            )
    return out


def beyond(row: Row) -> str:
    """By which measures a row is beyond the linear range."""
    measures = {
        "a hole moved by {:.2g} footprints": row.moved / row.footprint,
        "the bearing strain is {:.2g}": row.bearing,
        "a hole's frame turned by {:.2g}": row.turn,
    }
    words = [text.format(value) for text, value in measures.items() if value > LINEAR]
    return f"{', '.join(words)}, BEYOND the linear range (about {LINEAR})"


def off_theory(rows: Sequence[Row], quantity: str) -> float:
    """The finest cells' number over the half-space's, less 1; NaN where none is known."""
    finest = min(of(rows, "cells"), key=lambda row: row.cells)
    theory = getattr(finest, f"theory_{quantity.removeprefix('exit_')}", float("nan"))
    return float(getattr(finest, quantity) / theory - 1.0)


# --- figure -----------------------------------------------------------------------------------------------


def figure(rows: Sequence[Row]) -> Figure:
    """Displacement over tension, the same without dimension, stress over distance and cells, and each sweep beside
    theory."""
    drawing, grid = panels(4, 2)
    over_load(grid[0, 0], rows)
    collapsed(grid[0, 1], rows)
    over_distance(grid[1, 0], rows)
    over_cells(grid[1, 1], rows)
    approaches(grid[2, 0], rows)
    over_depth(grid[2, 1], rows)
    over_footprint(grid[3, 0], rows)
    over_friction(grid[3, 1], rows)
    return drawing


def over_load(axes: Axes, rows: Sequence[Row]) -> None:
    """How far the exit moved over the tension; crosses where no equilibrium was found, arrows at clinical tensions."""
    for (name, runs), colour, marker in zip(by_tissue(rows).items(), COLOURS, MARKERS, strict=False):
        loads, label = [row.load for row in runs], f"{name}, {runs[0].youngs_modulus / KILO:g} kPa"
        axes.plot(loads, [row.moved / MILLI for row in runs], color=colour, marker=marker, markersize=3, label=label)
        if runs[-1].failed:
            axes.plot(runs[-1].load, runs[-1].moved / MILLI, "x", color=colour, markersize=10)
        axes.axvline(CLINICAL[name][0], color=colour, linestyle=":")
    axes.axhline(LINEAR * rows[0].footprint / MILLI, color="black", linestyle="--", label=f"{LINEAR} footprints")
    axes.plot([], [], "x", color="black", markersize=10, label="fails beyond")
    axes.plot([], [], color="black", linestyle=":", label="clinical tension")
    axes.set(xscale="log", yscale="log", xlabel="tension T [N]", ylabel="displacement of a hole [mm]")
    axes.set_ylim(top=50.0 * axes.get_ylim()[1])
    axes.legend(fontsize=6, loc="upper left", ncols=2)


def collapsed(axes: Axes, rows: Sequence[Row]) -> None:
    """u/a over T/(E a²): one curve for all stiffnesses as long as theory is linear and the thread taut."""
    for (name, runs), colour, marker in zip(by_tissue(rows).items(), COLOURS, MARKERS, strict=False):
        x = [scaled_load(row) for row in runs]
        axes.plot(x, [row.exit_along / row.footprint for row in runs], marker, color=colour, markersize=4, label=name)
    runs = of(rows, "stiffness")
    x = [scaled_load(row) for row in runs]
    axes.plot(x, [row.exit_along / row.footprint for row in runs], "*", color="black", label="E alone changed")
    every = [row for row in of(rows, "tension") if row.load > 0.0]
    ends = np.array([min(scaled_load(row) for row in every), max(scaled_load(row) for row in every)])
    slope = every[0].theory_along / every[0].footprint / scaled_load(every[0])
    axes.plot(ends, slope * ends, color="black", label="half-space")
    axes.axhline(LINEAR, color="black", linestyle="--")
    axes.axhline(0.5 * rows[0].bite / rows[0].footprint, color="grey", linestyle=":", label="the holes meet")
    axes.set(xscale="log", yscale="log", xlabel="T/(E a²) [-]", ylabel="displacement along over a [-]")
    axes.legend(fontsize=6)


def scaled_load(row: Row) -> float:
    """T/(E a²)."""
    return row.load / (row.youngs_modulus * row.footprint**2)


def over_distance(axes: Axes, rows: Sequence[Row]) -> None:
    """Stress round a ring over its radius; lines are Cerruti's and Boussinesq's solutions."""
    runs = of(rows, "distance")
    x = [row.ring for row in runs]
    for name, colour, marker in (("von_mises", COLOURS[0], "o"), ("largest", COLOURS[1], "s")):
        label = {"von_mises": "von Mises", "largest": "largest principal"}[name]
        axes.plot(x, [getattr(row, f"ring_{name}") / KILO for row in runs], marker, color=colour, label=label)
        axes.plot(x, [getattr(row, f"theory_ring_{name}") / KILO for row in runs], color=colour)
    axes.plot(x, [-row.ring_smallest / KILO for row in runs], "^", color=COLOURS[2], label="− smallest principal")
    axes.plot([], [], color="black", label="half-space")
    axes.set(xscale="log", yscale="log", xlabel="distance from the hole [footprints]", ylabel="stress [kPa]")
    ticks(axes, "x", x)
    axes.legend()


def over_cells(axes: Axes, rows: Sequence[Row]) -> None:
    """Displacement and stress of the mesh for stress over its cells, each over theory."""
    runs = sorted(of(rows, "cells"), key=lambda row: row.cells)
    quantities = ("exit_along", "exit_normal", "mean_von_mises", "mean_largest", "ring_von_mises", "ring_largest")
    for quantity, colour, marker in zip(quantities, COLOURS, MARKERS, strict=True):
        theory = [getattr(row, f"theory_{quantity.removeprefix('exit_')}") for row in runs]
        ratio = [getattr(row, quantity) / value for row, value in zip(runs, theory, strict=True)]
        axes.plot([row.cells / MILLI for row in runs], ratio, color=colour, marker=marker, label=QUANTITIES[quantity])
    axes.axhline(1.0, color="black", label="half-space")
    axes.set(xlabel="cells (V/N)^⅓ [mm]", ylabel="measured over half-space [-]")
    axes.legend(fontsize=6)


def approaches(axes: Axes, rows: Sequence[Row]) -> None:
    """Approach of the holes over the bite."""
    runs = of(rows, "bite width")
    axes.plot([row.bite / MILLI for row in runs], [row.approach / MILLI for row in runs], "o", label="measured")
    bites = np.linspace(min(row.bite for row in runs), max(row.bite for row in runs), CURVE)
    cases = [replace(case_of(runs[0]), bite=float(bite)) for bite in bites]
    theory = [np.ptp(moved_in_theory(case)[:, 0]) / MILLI for case in cases]
    axes.plot(bites / MILLI, theory, color="black", label="half-space")
    axes.set(xlabel="bite [mm]", ylabel="approach of the holes [mm]")
    axes.legend()


def over_depth(axes: Axes, rows: Sequence[Row]) -> None:
    """Displacement of the exit over its depth: discs on the surface, balls below it."""
    runs = of(rows, "bite depth")
    deepest = max(row.depth for row in runs)
    below_surface = np.linspace(CLEAR * runs[0].footprint, max(deepest, 2.0 * CLEAR * runs[0].footprint), CURVE)
    over(axes, runs, "depth", below_surface, "depth of the holes [mm]")
    for k, colour in ((0, COLOURS[0]), (1, COLOURS[1])):
        disc = abs(moved_in_theory(replace(case_of(runs[0]), depth=0.0))[1, k])
        axes.plot(0.0, disc / MILLI, "_", color=colour, markersize=20)


def over_footprint(axes: Axes, rows: Sequence[Row]) -> None:
    """Displacement of the exit over the footprint."""
    runs = of(rows, "footprint")
    radii = np.geomspace(min(row.footprint for row in runs), max(row.footprint for row in runs), CURVE)
    over(axes, runs, "footprint", radii, "footprint [mm]")
    axes.set(xscale="log", yscale="log")
    ticks(axes, "x", [row.footprint / MILLI for row in runs])
    ticks(axes, "y", (0.05, 0.1, 0.2, 0.3))


def over(axes: Axes, runs: Sequence[Row], name: str, values: Array, label: str) -> None:
    """Displacement of the exit, along and normal, and lines of theory at `values` of what was changed."""
    x = [getattr(row, name) / MILLI for row in runs]
    cases = [Case(**(asdict(case_of(runs[0])) | {name: float(value)})) for value in values]
    theory = np.array([np.abs(moved_in_theory(case)[1]) for case in cases])
    for k, (way, colour, marker) in enumerate(zip(("along", "normal"), COLOURS, MARKERS, strict=False)):
        axes.plot(x, [getattr(row, f"exit_{way}") / MILLI for row in runs], marker, color=colour, label=way)
        axes.plot(values / MILLI, theory[:, k] / MILLI, color=colour)
    axes.plot([], [], color="black", label="half-space")
    axes.set(xlabel=label, ylabel="displacement of the exit [mm]")
    axes.legend()


def case_of(row: Row) -> Case:
    """What was run."""
    return Case(**{f.name: getattr(row, f.name) for f in fields(Case)})


def moved_in_theory(case: Case) -> Array:
    """(x, z) of entry and exit in a half-space under the whole tension, shape `(2, 2)` [m]."""
    return case.theory.displacements(*in_theory(case, case.tension))


def over_friction(axes: Axes, rows: Sequence[Row]) -> None:
    """Tensions behind each hole over the pull."""
    runs = of(rows, "friction")
    x = [row.mu for row in runs]
    for name, words, colour, marker in (
        ("leaving", "between the holes", COLOURS[0], "o"),
        ("held", "held", COLOURS[1], "s"),
    ):
        axes.plot(x, [getattr(row, name) / row.load for row in runs], marker, color=colour, label=words)
    mus = np.linspace(min(x), max(x), CURVE)
    theory = np.array([in_theory(replace(case_of(runs[0]), mu=float(mu)), 1.0) for mu in mus])
    for k, colour in ((1, COLOURS[0]), (0, COLOURS[1])):
        axes.plot(mus, theory[:, k], color=colour)
    axes.plot([], [], color="black", label="a thread that bends by 90° at each hole")
    axes.set(xlabel="friction μ [-]", ylabel="tension over the pull [-]", ylim=(0.0, 1.1))
    axes.legend()


STUDY = Study(
    main=main,
    question="How far does a suture under tension draw two holes together, what stress is around them, and up to which "
    "tension may a linear organ say so?",
    independent="displacement, approach and stress of two holes in a half-space (Cerruti, Boussinesq, Mindlin, and a "
    "footprint's own by Fourier transform), length drawn through and fall of tension of an elastica, u ∝ T/E",
    consistency="compliance times reported force is the reported displacement; sub-grid P1 of the runs against P2 of "
    "the mesh for stress",
    table=table,
    figure=figure,
    remarks=remarks,
    quick={
        "tissues": ("liver", "skin"),
        "tensions": (0.02, 0.2),
        "moduli": (1e5, 1e6),
        "bites": (0.005, 0.01, 0.02),
        "depths": (0.0, 4e-3),
        "footprints": (0.5e-3, 1e-3),
        "mus": (0.0, 0.2, 0.4),
        "distances": (1.5, 3.0),
        "refinements": (1.0,),
        "soft_ways": ("10 load steps",),
        "refinement": 1.0,
    },
)
