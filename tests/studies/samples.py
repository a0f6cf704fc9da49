"""Scenarios, frames and a simulation of no physics, for the tests of the studies package."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from coupling.reports.audit import Energies
from coupling.reports.observation import PiercingObservation
from studies.output.checkpoint import Arrays
from studies.output.fields import OrganTopology, ThreadRecord
from studies.output.records import (
    LIST,
    ContactRecord,
    Ending,
    OrganRecord,
    Record,
    Snapshot,
    StepRecord,
)
from studies.output.remarks import Remark
from studies.output.tally import Tally
from studies.scenario import Scenario

ANCHORED = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.45
density = 1070.0
inertia = false
clamp = ["bottom"]
[tissue.mesh]
accuracy = 0.2
kind = "block"
generator = "structured"
size = [0.04, 0.03, 0.015]
h = 5.0e-3
[thread]
suture = "2-0 polypropylene"
control_points = 40
path = [[0, 0, -0.008], [0, 0, 0.03]]
end = { kind = "pulled", force = [0, 0, 0.05] }
[[piercing]]
name = "anchor"
at = [0, 0, 0]
kind = "anchored"
direction = "normal"
footprint = 2.0e-3
[solve]
kind = "static"
load_steps = 2
"""

CONTRACT = """
title = "two piercings, needle pulled"

[tissue]
youngs_modulus = 1.0e5
poisson_ratio  = 0.45
density        = 1070.0
element        = "P1"
inertia        = true
rayleigh       = [0.0, 0.0]
clamp          = ["bottom"]

[tissue.mesh]
accuracy = "given"
kind   = "block"
size   = [0.06, 0.04, 0.02]
h      = 4.0e-3
h_site = 0.5e-3

[[tissue.boundary]]
name = "bed"
box  = [[-0.1, -0.1, -0.1], [0.1, 0.1, -0.015]]

[thread]
suture         = "2-0 polypropylene"
control_points = 40
path           = [[-0.03, 0, 0.01], [-0.01, 0, 0], [0.01, 0, 0], [0.03, 0, 0.01]]
length         = 0.0483
damping        = 0.0
bending        = true
start = { kind = "free" }
end   = { kind = "driven", waypoints = [[0.0, 0.03, 0, 0.01], [1.0, 0.05, 0, 0.03]] }

[[piercing]]
name      = "entry"
at        = [-0.01, 0.0, 0.0]
kind      = "sliding"
direction = "normal"
footprint = 1.0e-3
weight    = "parabolic"
s         = 0.021
friction  = { static = 0.12, kinetic = 0.10, grip = 0.0 }
channel   = 2.0e-3
from      = 0.0
until     = 0.9

[[piercing]]
name = "exit"
at   = [0.01, 0.0, 0.0]

[solve]
kind      = "dynamic"
dt        = 1.0e-3
duration  = 1.0
scheme    = "newton"
coupling  = "monolithic"
friction  = "implicit"
epsilon   = 0.0
gravity   = [0.0, 0.0, 0.0]

[output]
every = 10
"""

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1], [1, 1, -1]]) * 0.01
TETRAHEDRA = np.array([[0, 2, 1, 3], [1, 2, 4, 3]])
LINEAR = OrganTopology(CORNERS, TETRAHEDRA)


def quadratic() -> OrganTopology:
    """The same tetrahedra with nodes on their edges."""
    edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    middles = np.array([[CORNERS[cell[[a, b]]].mean(axis=0) for a, b in edges] for cell in TETRAHEDRA])
    cells = np.hstack([TETRAHEDRA, 5 + np.arange(12).reshape(2, 6)])
    return OrganTopology(np.concatenate([CORNERS, middles.reshape(-1, 3)]), cells)


def organ(topology: OrganTopology, time: float) -> Record:
    nodes = len(topology.points)
    stress = np.arange(6.0 * nodes).reshape(nodes, 6)
    strain = np.linspace(0.0, time, len(topology.cells))
    return OrganRecord(
        displacement=time * topology.points,
        stress=stress,
        von_mises=np.arange(1.0, nodes + 1),
        principal_stress=stress[:, 2::-1],
        first_direction=np.ones((nodes, 3)),
        third_direction=-np.ones((nodes, 3)),
        strain=strain,
        rotation=0.5 * strain,
        energy_density=30.0 * strain,
        volume_ratio=1.0 + strain,
        nodal_volume_ratio=np.linspace(1.0, 1.0 + time, nodes),
        deformed=0.5 + time,
        strained=0.25,
        rotated=0.125,
    )


def piercing(name: str, time: float) -> PiercingObservation:
    return PiercingObservation(
        name=name,
        s=0.02 + time / 3,
        slip=time / 3,
        x=np.array([0.001, time / 7, 0.0]),
        displacement=np.array([0.0, time / 7, 0.0]),
        force=np.array([0.1, 0.2, 0.3]),
        normal_force=0.05,
        tangential_force=-0.01,
        couple=np.zeros(3),
        tension_before=float("nan"),
        tension_after=0.2,
        state="slip",
        cone_residual=0.0,
        mean_strain=time / 70,
        turn=time / 30,
        bearing_pressure=1e5 * time,
        tangent=np.array([0.0, 0.6, 0.8]),
        u=np.array([1.0, 0.0, 0.0]),
        v=np.array([0.0, 0.8, -0.6]),
    )


def frame(time: float, topology: OrganTopology | None = LINEAR) -> Snapshot:
    s = np.linspace(0, 0.05, 11)
    points = np.stack([s, 0.1 * s**2, 0.01 * np.cos(200 * s)], axis=1)
    thread = ThreadRecord(points, s, 0.1 + s, 3 * s, 1.6e-4)
    holes = (piercing("entry", time), piercing("exit", time))
    return Snapshot(time, thread, holes, None if topology is None else organ(topology, time))


def framing(time: float) -> Callable[[], Snapshot]:
    """A frame that is made when it is needed."""
    return lambda: frame(time)


def contact(pair: str, gap: float, force: float = 0.3, stitches: tuple[Record, ...] = ()) -> Record:
    """Two surfaces in contact; what is not given is zero."""
    given = {"pair": pair, "pairs": 6, "pressed": 2, "slipping": 0, "eversion": None, "stitches": stitches}
    numbers = {"smallest_gap": gap, "largest_pressure": 120.0, "area": 1e-6, "slide": 2e-4, "force": force}
    return ContactRecord(**dict.fromkeys(LIST["contact"], 0.0) | numbers | given | {"complementarity": 1e-22})


def step(number: int, dt: float = 0.1) -> StepRecord:
    time = number * dt
    return StepRecord(
        time=time,
        step=number,
        piercings=frame(time).piercings,
        energy=Energies(1 / 3, 0.2, 0.3, 0.4, 0.0, 0.0, 0.1, 1e-17, prestretch=0.05),
        newton_iterations=3 if number else 0,
        constraint_max=1e-6,
        start_reaction=np.zeros(3),
        end_reaction=np.array([0.0, 0.0, 0.1]),
        max_strain=0.01,
        slide_speed=1e-3,
        spans=lambda: 0.3,
        apart=lambda: 4.0,
        outside=lambda: None,
        stays=lambda: True,
        seconds=0.5,
    )


@dataclass(frozen=True)
class Stub:
    """Steps without physics; ``fail`` is raised, or called, after the third."""

    scenario: Scenario
    fail: Exception | Callable[[], None] | None = None
    steps: int = 7
    topology: OrganTopology | None = LINEAR
    held: np.ndarray = field(default_factory=lambda: CORNERS)
    tissue_dofs: int = 12
    balls: int = 0
    refinement: dict[str, Any] = field(default_factory=dict)
    methods: dict[str, str | None] = field(default_factory=dict)
    said: tuple[Remark, ...] = ()

    def remarks(self, ending: Ending | None = None) -> list[Remark]:
        return list(self.said)

    def tally(self, memory: Arrays | None = None) -> Tally:
        return Tally(self.scenario, self.tissue_dofs, self.remarks, memory, self.refinement)

    def advance(self, memory: object = None) -> Iterator[tuple[StepRecord, Callable[[], Snapshot]]]:
        for number in range(self.steps + 1):
            if number == 4 and isinstance(self.fail, Exception):
                raise self.fail
            if number == 4 and callable(self.fail):
                self.fail()
            yield step(number), framing(step(number).time)
