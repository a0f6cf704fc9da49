"""Mutated scenarios: each is refused or read, and of the small ones that are read a share is prepared."""

import tomllib
from pathlib import Path
from random import Random
from typing import Any

from studies.command.command import ALL_REFUSALS
from studies.scenario import SCENES, FileMesh, GivenMesh, Scenario, load, schema
from studies.scenario.refusal import as_key, as_toml
from studies.simulation import prepare
from tests.fuzz.mutations import mutated_bytes, mutated_tables
from tests.fuzz.trial import Tally
from tests.studies.samples import CONTRACT
from tissue.errors import FactorError

SMALL = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.45
density = 1070.0
clamp = ["bottom"]
mesh = { kind = "block", size = [0.03, 0.02, 0.01], h = 5.0e-3, accuracy = "given" }
region = [{ name = "skin", depth = [0.0, 2.0e-3], youngs_modulus = 2.0e5 }]
[thread]
suture = "2-0 polypropylene"
control_points = 24
path = [[-0.015, 0, 0.015], [-0.005, 0, 0.006], [-0.005, 0, -0.005], [0.005, 0, -0.005], [0.005, 0, 0.015]]
start = { kind = "pulled", force = [-0.02, 0, 0.02], ramp = 0.01 }
end = { kind = "driven", waypoints = [[0, 0.005, 0, 0.015], [0.06, 0.01, 0, 0.018]] }
[[piercing]]
name = "entry"
at = [-0.005, 0, 0]
direction = "normal"
footprint = 2.0e-3
friction = { static = 0.12, kinetic = 0.1 }
[[piercing]]
name = "exit"
at = [0.005, 0, 0]
direction = [0, 0, 1]
[solve]
dt = 1.0e-3
duration = 0.02
gravity = [0, 0, -9.81]
"""
# The keys that none of the others names.
SPRUNG = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.45
density = 1070.0
clamp = ["left"]
roller = ["bottom"]
solver = "superlu"
dilatation = "nodal"
mesh = { kind = "block", size = [0.03, 0.02, 0.01], h = 5.0e-3, growth = 1.4, accuracy = "given", bound = false }
load = [{ boundary = "right", traction = [10.0, 0, 0], ramp = 0.01 }]
[thread]
diameter = 3.0e-4
youngs_modulus = 1.0e9
density = 1000.0
bending_factor = 0.5
control_points = 24
energy = "springs"
springs = 30
path = [[-0.015, 0, 0.015], [-0.005, 0, 0.006], [-0.005, 0, -0.005], [0.005, 0, -0.005], [0.005, 0, 0.015]]
start = { kind = "free", mass = 1.0e-4 }
end = { kind = "fixed", mass = 1.0e-4 }
[[piercing]]
name = "entry"
at = [-0.005, 0, 0]
[[piercing]]
name = "exit"
at = [0.005, 0, 0]
[solve]
duration = 0.02
newton = "numpy"
organ = "whole"
integrator = "euler"
tolerance = 1.0e-4
"""
FINITE = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.45
density = 1070.0
clamp = ["bottom"]
material = "exponential"
stiffening = 2.0
fibres = [{ direction = [1, 0, 0], k1 = 1.0e4, k2 = 1.0 }]
prestretch = [1.02, 1.0, 0.98]
strength = 2.0e6
relaxation = [[0.3, 0.01], [0.2, 1.0]]
region = [{ name = "layer", depth = [0.0, 2.0e-3], relaxation = [] }]
mesh = { kind = "block", size = [0.03, 0.02, 0.01], h = 5.0e-3, accuracy = 0.5 }
[thread]
suture = "2-0 polypropylene"
control_points = 24
knots = "fixed"
relaxation = [[0.2, 0.01]]
contact = { friction = 0.1 }
path = [[6e-3, -1e-3, 4e-3], [-5e-3, 0, 2e-3], [-5e-3, 0, -5e-3], [5e-3, 0, -5e-3], [5e-3, 0, 2e-3], [-6e-3, 0, 4e-3]]
[[piercing]]
name = "entry"
at = [-0.005, 0, 0]
[[piercing]]
name = "exit"
at = [0.005, 0, 0]
[[tie]]
name = "knot"
between = ["entry", "exit"]
force = 0.1
until = 0.01
speed = 0.5
hold = 1.0
held = true
[[cut]]
s = 0.03
time = 0.015
[solve]
kind = "static"
duration = 0.02
"""
GIVEN = """
[tissue]
youngs_modulus = 1.0e5
poisson_ratio = 0.45
density = 1070.0
mesh = { kind = "given", sha256 = "0" }
[thread]
suture = "2-0 polypropylene"
path = [[0, 0, 0], [0.01, 0, 0]]
"""
STITCHED = """
solve = { kind = "static", load_steps = 2 }
thread.suture = "4-0 polypropylene"
thread.end = { kind = "pulled", force = [0, 0, 1e-3], from = 0.2, until = 0.8 }

[tissue]
youngs_modulus = 1.0e6
poisson_ratio = 0.4
density = 1070.0
clamp = ["bottom"]
mesh = { kind = "wound", size = [0.03, 0.03, 0.012], length = 0.01, depth = 0.006, h = 6.0e-3, accuracy = "given" }

[[tissue.load]]
boundary = "left"
pressure = 10.0
course = { kind = "cycle", period = 4.0, low = 0.2 }

[[tissue.load]]
boundary = "right"
pressure = 10.0
course = { kind = "hold", rise = 0.1, hold = 0.3, fall = 0.2 }

[[tissue.load]]
boundary = "right"
pressure = 10.0
course = { kind = "ramp", over = 0.5 }

[[tissue.load]]
boundary = "left"
pressure = 10.0
course = { kind = "cough", at = 0.3, duration = 4.0 }

[[stitch]]
name = "run"
kind = "running"
at = [0, -0.003, 0]
along = [0, 1, 0]
normal = [0, 0, 1]
bite = [4.0e-3, 5.0e-3]
depth = 4.0e-3
pitch = 5.0e-3
count = 2
force = 0.1
from = 0.1
until = 0.6
footprint = 1.0e-3
tract = false
friction = { static = 0.1, kinetic = 0.1, grip = [0.01, 0.05] }
"""
POINTS, CELLS = 60, 4000  # control points and elements up to which a scenario is prepared
LEAST = 0.02  # accuracy of cells at the holes from which it is: to refine them further takes minutes


def sources() -> list[str]:
    """List the scenarios that are mutated."""
    shipped = [path.read_text(encoding="utf-8") for path in sorted(SCENES.glob("*.toml"))]
    return [SMALL, SMALL, SMALL, CONTRACT, *shipped, SPRUNG, FINITE, GIVEN, STITCHED]


def every_key() -> list[str]:
    """List the keys that any table of a scenario may have."""
    tables = [schema(), *schema()["$defs"].values()]
    return sorted({key for table in tables for key in table.get("properties", {})})


def is_small(scenario: Scenario) -> bool:
    """Tell whether a scenario is prepared within a second or so."""
    if scenario.thread.control_points > POINTS or (scenario.thread.springs or 0) > POINTS:
        return False
    if scenario.tissue is None:
        return True
    mesh: Any = scenario.tissue.mesh
    if isinstance(mesh, FileMesh | GivenMesh) or getattr(mesh, "generator", "gmsh") == "gmsh":
        return False
    if mesh.accuracy != "given" and mesh.accuracy < LEAST:
        return False
    cells = 1.0
    for length in mesh.size:
        cells *= max(2.0, length / mesh.h, length / mesh.h_site if mesh.h_site else 0.0)
    return cells < CELLS / 5 or cells > 1e12  # many are to be refused


def text_of(data: dict[str, Any]) -> str:
    """Write tables in TOML, a line for each at the top."""
    return "".join(f"{as_key(key)} = {as_toml(value)}\n" for key, value in data.items())


def run(count: int, seed: int, folder: Path, share: float = 0.25) -> Tally:
    """Try so many mutated scenarios; to prepare one takes fifty times as long as to read it."""
    tally, texts, file = Tally(), sources(), folder / "mutated.toml"
    tables, keys = [tomllib.loads(text) for text in texts], every_key()
    for number in range(seed, seed + count):
        random = Random(number)
        which = random.randrange(len(texts))
        if random.random() < 0.3:
            file.write_bytes(mutated_bytes(texts[which].encode(), random))
        else:
            file.write_text(text_of(mutated_tables(tables[which], random, keys)), encoding="utf-8")
        drawn = random.random() < share
        tally.trial(
            f"scenario {number}", lambda drawn=drawn: _attempt(file, drawn), (*ALL_REFUSALS, FactorError, MemoryError)
        )
    return tally


def _attempt(file: Path, drawn: bool) -> str:
    scenario = load(file)
    if not drawn or not is_small(scenario):
        return "read"
    prepare(scenario)
    return "prepared"
