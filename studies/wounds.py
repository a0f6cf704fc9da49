"""Wounds through a sheet of skin: published wounds, and hands that draw their stitches.

The hands draw until the lips nearly meet. The sheet is the one of
`studies/wound_closure/scene.toml`. The stitches are one thread that runs to and fro and is cut at
its turns. The hands draw both ends of a stitch equally.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray
from skfem import ElementVector, FacetBasis, LinearForm

import tissue
from coupling.arrays import Flags
from coupling.errors import EquilibriumError
from coupling.run import begin
from coupling.system import State
from studies.arrays import MILLI, Array
from studies.lists import study_list
from studies.scenario.stitch import TAIL
from studies.simulation.assembly import Assembly, assemble
from studies.study import require, scene
from studies.verdicts import bearing_strain
from thread.catalogue import suture
from tissue.elasticity import ELEMENTS

E, NU, THICKNESS = 0.8e6, 0.45, 1.5e-3  # [Pa], [-], [m]: skin, as implied by the published Et = 1.2 kN/m
STIFFNESS = E * THICKNESS  # of the sheet [N/m]
FOOTPRINT = 0.7e-3  # radius of the hole's averaging ball, limited by the sheet's thickness [m]
SUTURE = "3-0 polypropylene"
SPAN = 1e-3  # of the thread [m]
NEAR = 0.02  # of the open width: lips this near count as closed; for smaller gaps the last stitch's force has no limit
PRECISE = 1e-4  # of the width: tolerance of the hands
MOVES = 30  # largest number of moves of the hands
TOGETHER, IN_TURN = "all at once", "one after another"


# Published pairs of wounds, by their `name`: `wounds` are lengths and widths [m], `forces` the largest forces of a
# stitch [N], and `way` the order in which the stitches are drawn here for comparison.
SOURCES = tuple(
    SimpleNamespace(name=name, **of | {"wounds": tuple(map(tuple, of["wounds"]))})
    for name, of in study_list("wound_closure")["published"].items()
)
WOUNDS = tuple(dict.fromkeys(wound for source in SOURCES for wound in source.wounds))


@dataclass(frozen=True)
class Case:
    """A wound in its sheet [m], a slit if its width is zero.

    Raises `StudyError` for a wound that does not fit into the sheet or is shorter than a pitch.
    """

    length: float
    width: float
    sheet: float
    size: float
    far: float
    pitch: float
    bite: float
    near: float = NEAR  # of the open width: gap at which the lips count as closed
    variant: str = ""

    def __post_init__(self) -> None:
        fits = 0.0 <= self.width <= self.length < 0.5 * self.sheet and self.length >= self.pitch
        given = f"wounds: {self.length} × {self.width} m in a sheet of {self.sheet} m"
        remedy = f"give a width up to the length, and a length from {self.pitch:g} m to half the sheet's edge"
        require(fits, given, remedy)

    @property
    def places(self) -> Array:
        """Places of the stitches along the wound, each in the middle of its share [m]."""
        n = max(round(self.length / self.pitch), 1)
        return np.asarray((np.arange(n) - 0.5 * (n - 1)) * self.length / n)

    def opening(self, y: Array) -> Array:
        """Return the width of the open wound at y [m]."""
        return np.asarray(self.width * np.sqrt(np.maximum(1.0 - (2.0 * y / self.length) ** 2, 0.0)))

    def assembly(self, material: Mapping[str, object]) -> Assembly:
        """Return the sheet with its stitches, before anything is drawn.

        `material` are keys of the sheet's material. A wound without width is a slit.
        """
        y = self.places
        half = 0.5 * self.opening(y) + self.bite
        lengths = 2.0 * (1.0 + TAIL) * half  # of each stitch with its tails
        straight = {"depth": 0.0, "draw": [[0.0, 0.0]], "footprint": FOOTPRINT}
        shape = {"shape": "ellipse", "width": self.width} if self.width else {"generator": "gmsh"}
        sizes = {"size": [self.sheet, self.sheet, THICKNESS], "length": self.length, "depth": THICKNESS}
        values = {
            "tissue.mesh": {"kind": "wound", **shape, **sizes, "h": self.far, "h_site": self.size, "accuracy": "given"},
            "thread.control_points": int(np.sum(np.round(lengths / SPAN) + 3)),
            "stitch": [
                {"name": f"{k + 1}", "at": [0.0, y[k], -0.5 * THICKNESS], "bite": half[k], **straight}
                | {"along": [0.0, -1.0 if k % 2 else 1.0, 0.0]}
                for k in range(len(y))
            ],
        }
        return assemble(scene("wound_closure", values | {f"tissue.{key}": value for key, value in material.items()}))


class Wound:
    """A closed wound: its length and width [m], and the force of each stitch [N]."""

    length: float
    width: float
    forces: tuple[float, ...]

    @property
    def wound(self) -> tuple[float, float]:
        """Length and width [m]."""
        return self.length, self.width

    @property
    def name(self) -> str:
        """The size of the wound [mm]."""
        return f"{self.length / MILLI:g} × {self.width / MILLI:g}" if self.width else f"slit of {self.length / MILLI:g}"

    @property
    def middle(self) -> float:
        """Force of the stitch in the middle, or mean of the two next to it [N]."""
        n = len(self.forces)
        return float(np.mean(self.forces[(n - 1) // 2 : n // 2 + 1]))

    @property
    def bearing(self) -> float:
        """Bearing strain T/(d ℓ E) of the stitch with the largest force."""
        return bearing_strain(max(self.forces), suture(SUTURE).diameter, THICKNESS, E)

    def course(self, places: Sequence[float], values: Array) -> list[tuple[float, float]]:
        """Return places along the wound over half its length, each with its value."""
        return list(zip(2.0 * np.array(places) / self.length, values, strict=True))


@dataclass(frozen=True)
class Hands:
    """The hands that draw the stitches of a case and measure the gaps of the lips."""

    case: Case
    material: Mapping[str, object] = field(default_factory=dict)  # keys of the sheet's material

    @cached_property
    def assembly(self) -> Assembly:
        """Thread, sheet and holes before the hands draw."""
        return self.case.assembly(self.material)

    @property
    def organ(self) -> tissue.QuasiStaticOrgan | tissue.FiniteOrgan:
        """The sheet."""
        organ = self.assembly.organ
        assert isinstance(organ, tissue.QuasiStaticOrgan | tissue.FiniteOrgan)
        return organ

    @cached_property
    def rim(self) -> tuple[NDArray[np.intp], Array]:
        """Pairs of upper lip nodes, in order along the wound, and their places along it [m]."""
        assert self.organ.gaps is not None
        at = self.organ.elasticity.points[self.organ.gaps.nodes[:, 0]]
        upper = np.flatnonzero(at[:, 2] >= -1e-9 * THICKNESS)
        order = upper[np.argsort(at[upper, 1])]
        return order, at[order, 1]

    @cached_property
    def straight_state(self) -> State:
        """The state before drawing, with straight stitches through the holes."""
        return self.draw(self.assembly.start(), np.zeros(len(self.case.places)))

    @cached_property
    def answers(self) -> tuple[Array, Array]:
        """Changes of all gaps [-] and forces [N/m] over the length drawn at each stitch.

        The lips are open.
        """
        y, length, straight = self.case.places, 0.01 * self.case.width, self.straight_state
        each = [self.draw(straight, length * unit) for unit in np.eye(len(y))]
        gaps = np.column_stack([self.gaps(state, y) - self.gaps(straight, y) for state in each])
        forces = np.column_stack([self.forces(state) - self.forces(straight) for state in each])
        return gaps / length, forces / length

    @cached_property
    def uniform_traction(self) -> float:
        """Traction on the lips that closes a linear sheet in the middle [-].

        It is over the value of a large sheet, EW/(4c). It acts across the wound and is a force per
        length.
        """
        organ, body, (order, at) = self.organ, self.organ.elasticity, self.rim
        assert isinstance(organ, tissue.QuasiStaticOrgan)
        load = np.zeros(body.N)
        for name, inward in (("lip_left", 1.0), ("lip_right", -1.0)):
            lip = FacetBasis(body.mesh, ElementVector(ELEMENTS[body.element]()), facets=body.mesh.boundaries[name])
            load += inward * LinearForm(lambda v, w: abs(w.n[0]) * v[0]).assemble(lip)
        U = organ.operator(0.0, 0.0).factor.solve(load[body.free])
        traction = self.case.width / -float(np.interp(0.0, at, (organ.pairing(None).G @ U)[order]))
        return traction / (E * self.case.width / (2.0 * self.case.length))

    def draw(self, state: State, lengths: Array) -> State:
        """Return the equilibrium after stitch k is shortened by `lengths` (k,) [m].

        Each end is drawn by half of it. One unit of time is one move of the hands.
        """
        now, half = state.time, 0.5 * np.repeat(lengths, 2) * np.tile([-1.0, 1.0], len(lengths))
        tables = [np.array([[now, 0.0], [now + 1.0, length]]) for length in half]
        system = self.assembly.system
        pulled = zip(system.piercings, tables, strict=True)
        system = replace(system, piercings=tuple(replace(hole, draw=draw) for hole, draw in pulled))
        return begin(system, state).load(1.0, now + 1.0).state

    def forces(self, state: State) -> Array:
        """Return the tension of each stitch [N].

        It acts on the two holes of the stitch, because the tails are free.
        """
        first, last = state.lam[0::2, :3], state.lam[1::2, :3]
        across = state.y[0::2, :3] - state.y[1::2, :3]
        return 0.5 * np.vecdot(first - last, across) / np.linalg.norm(across, axis=1)

    def gaps(self, state: State, y: Array) -> Array:
        """Return the distance of the lips at y [m]; zero at the ends of the wound.

        In a sheet at finite strain it is the distance of points that were opposite at the start.
        """
        organ, (order, at) = self.organ, self.rim
        if isinstance(organ, tissue.QuasiStaticOrgan):
            apart = organ.gap(state.organ)[order]
        else:
            assert organ.gaps is not None
            x = organ.elasticity.points[:, 0] + organ.elasticity.nodal(organ.displacement(state.organ))[:, 0]
            apart = np.diff(x[organ.gaps.nodes[order]])[:, 0]
        end = 0.5 * self.case.length
        return np.interp(y, [-end, *at, end], [0.0, *apart, 0.0])

    def tighten(self, state: State, tying: Flags, slack: Flags) -> tuple[State, bool]:
        """Return the state with the stitches `tying` drawn until the lips nearly touch.

        The second result is whether this was reached. The stitches `slack` are drawn until their
        force is zero; the others are unchanged.
        """
        case, y, moving = self.case, self.case.places, tying | slack
        by_gap, by_force = self.answers
        answer = np.where(tying[:, None], by_gap, by_force)[np.ix_(moving, moving)]
        limit = np.where(tying, case.width, STIFFNESS * case.width)[moving] * PRECISE

        def missing(state: State) -> Array:
            gaps = self.gaps(state, y) - case.near * case.opening(y)
            return np.where(tying, gaps, self.forces(state))[moving]

        state, _, left = self.reach(state, missing, answer, limit, moving)
        return state, bool(np.all(np.abs(left) <= limit))

    def reach(
        self,
        state: State,
        missing: Callable[[State], Array],
        answer: Array,
        limit: Array | float,
        moving: Flags | slice = slice(None),
        moves: int = MOVES,
    ) -> tuple[State, Array, Array]:
        """Draw the `moving` stitches until the residual `missing` is within the `limit`.

        There are at most `moves` moves. Returns the state, the change of the residual per length
        drawn, and the residual, which is infinite without equilibrium. Broyden's method learns the
        effects of contact and stiffening.
        """
        left = missing(state)
        for _ in range(moves):
            if np.all(np.abs(left) <= limit):
                break
            lengths = np.zeros(len(self.case.places))
            lengths[moving] = step = np.linalg.solve(answer, -left)
            try:
                state = self.draw(state, lengths)
            except EquilibriumError:
                return state, answer, np.full_like(left, np.inf)
            before, left = left, missing(state)
            answer = answer + np.outer(left - before - answer @ step, step) / (step @ step)
        return state, answer, left
