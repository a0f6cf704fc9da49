"""Realistic scenarios drawn at random from a seed, with all defaults.

A block of tissue, 2 kPa to 2 MPa, is pierced from above at one to six holes by a suture of the catalogue, 2-0 to 8-0,
which goes down and up through them in turn. One end is held, loaded or free, the other is driven or pulled. The
`demand` of a scenario is how far a linear estimate, 0.6 F/(E a), moves its holes, in footprints a.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.arrays import Array

SUTURES = tuple(
    f"{size} {material}"
    for size in ("2-0", "3-0", "4-0", "5-0", "6-0", "7-0", "8-0")
    for material in ("polypropylene", "nylon", "silk")
)
KINDS = ("driven", "ramped", "dead", "sudden")
ESTIMATE = 0.6  # of F/(E a): displacement of a footprint under a force F
GENTLE = 3.0  # footprints
UP = np.array([0.0, 0.0, 1.0])
SETTLING = 0.1  # [s] of a run after its load has grown


@dataclass(frozen=True)
class Case:
    """One scenario as tables, with its `number`, its `kind`, its `demand` [-] and what else it asks for, `ask`."""

    number: int
    kind: str
    demand: float
    tables: dict[str, Any]
    ask: str = "motion"

    @property
    def gentle(self) -> bool:
        """Whether its holes move by less than GENTLE footprints and its loads grow."""
        return self.kind != "sudden" and self.demand < GENTLE


def cases(seed: int, count: int, first: int = 0) -> Iterator[Case]:
    """Yield the cases of a seed, each of which depends on its number alone."""
    for number in range(first, first + count):
        yield case(np.random.default_rng([seed, number]), number)


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def case(random: np.random.Generator, number: int) -> Case:
    """Draw one case."""
    holes = int(random.integers(1, 7))
    footprint = float(random.choice([0.5e-3, 1e-3, 1.5e-3]))
    modulus = log_uniform(random, 2e3, 2e6)
    spacing = random.uniform(5.0, 10.0, holes - 1) * 1e-3
    x = np.concatenate([[0.0], np.cumsum(spacing)])
    x -= x.mean()
    at = np.column_stack([x, random.uniform(-2e-3, 2e-3, holes), np.zeros(holes)])
    path = path_through(random, at)
    kind = str(random.choice(KINDS, p=(0.4, 0.25, 0.2, 0.15)))
    start, end, force, duration = ends_of(random, kind, path, modulus * footprint * holes)
    sliding = random.random() < 0.6
    friction = {} if sliding else {"friction": friction_of(random)}
    piercings = [
        {"name": f"hole{k + 1}", "at": at[k].tolist(), "footprint": footprint, "direction": direction_of(random, k)}
        | friction
        for k in range(holes)
    ]
    tables = {
        "title": f"case {number}: {kind}",
        "tissue": {
            "youngs_modulus": modulus,
            "poisson_ratio": float(random.choice([0.3, 0.45])),
            "density": 1060.0,
            "rayleigh": [10.0, 1e-4],
            "clamp": ["bottom"],
            "inertia": bool(random.random() < 0.5),
            "mesh": mesh_of(random, at, footprint),
        },
        "thread": {"suture": str(random.choice(SUTURES)), "path": path.tolist(), "start": start, "end": end}
        | ({"damping": 20.0} if random.random() < 0.5 else {}),
        "piercing": piercings,
        "solve": {"dt": 1e-3, "duration": duration},
        "output": {"every": 1000},
    }
    return Case(number, kind, demand_of(tables, force), tables)


def demand_of(tables: dict[str, Any], force: float) -> float:
    """Return how far a force [N] would move a hole by the linear estimate, in footprints."""
    return ESTIMATE * force / (tables["tissue"]["youngs_modulus"] * tables["piercing"][0]["footprint"] ** 2)


def path_through(random: np.random.Generator, at: Array) -> Array:
    """Return the corners of a path that comes from the left above the block, goes down and up through the holes, and
    leaves to the right; below the block where the number of holes is odd. Shape `(k, 3)` [m]."""
    tail, head = random.uniform(15e-3, 40e-3, 2)
    rise = random.uniform(4e-3, 10e-3)
    rows = [at[0] + [-tail, random.uniform(-5e-3, 5e-3), random.uniform(5e-3, 25e-3)], at[0] + [0, 0, rise]]
    for k, place in enumerate(at):
        down = k % 2 == 0
        depth = random.uniform(4e-3, 7e-3)
        if down:
            rows.append(place - depth * UP)
            if k + 1 < len(at):
                rows.append(at[k + 1] - depth * UP)
        else:
            rows.append(place + rise * UP)
            if k + 1 < len(at):
                rows.append(at[k + 1] + rise * UP)
    last = rows[-1]
    up = 1.0 if len(at) % 2 == 0 else -1.0
    way = head, random.uniform(-10e-3, 10e-3), up * random.uniform(2e-3, 25e-3)
    rows.append(last + np.array(way))
    return np.array(rows)


def ends_of(
    random: np.random.Generator, kind: str, path: Array, stiffness: float
) -> tuple[dict[str, Any], dict[str, Any], float, float]:
    """Draw the two ends of the thread: the tables of start and end, the force [N] that the holes will feel, and the
    duration of the run [s]. `stiffness` [N/m] is that of all holes together, of E a."""
    away = path[0] - path[1]
    away /= np.linalg.norm(away)
    out = path[-1] - path[-2]
    out /= np.linalg.norm(out)
    turned = out + 0.5 * random.standard_normal(3)
    turned /= np.linalg.norm(turned)
    pull = log_uniform(random, 0.05, 3.0)
    hold = str(random.choice(["free", "fixed", "clamped", "pulled"], p=(0.2, 0.3, 0.1, 0.4)))
    tail = float(min(pull, log_uniform(random, 0.01, 0.3)))
    starts = {
        "free": {"kind": "free"},
        "fixed": {"kind": "fixed"},
        "clamped": {"kind": "clamped"},
        "pulled": {"kind": "pulled", "force": (tail * away).tolist(), "ramp": 0.05},
    }
    time = float(random.uniform(0.1, 0.3))
    if kind == "driven" or (kind == "ramped" and random.random() < 0.3):
        way = random.uniform(5e-3, 40e-3)
        if hold in ("fixed", "clamped"):
            way *= 0.3
        place = path[-1] + way * turned
        end = {"kind": "driven", "waypoints": [[0.0, *path[-1]], [time, *place]]}
        force = {"free": 0.0, "pulled": tail}.get(hold, way * stiffness / ESTIMATE)
        return starts[hold], end, float(force), time + 0.05
    if hold in ("free", "pulled"):
        hold = "fixed"
    if kind in ("dead", "sudden") and random.random() < 0.5:
        end = {"kind": "driven", "waypoints": [[0.0, *path[-1]], [time, *(path[-1] + 5e-3 * turned)]]}
        load = {"kind": "pulled", "force": (pull * away).tolist()} | ({"ramp": 0.0} if kind == "sudden" else {})
        return load, end, pull, time
    ramp = {"ramp": time} if kind == "ramped" else ({"ramp": 0.0} if kind == "sudden" else {})
    return starts[hold], {"kind": "pulled", "force": (pull * turned).tolist()} | ramp, pull, time + SETTLING


def friction_of(random: np.random.Generator) -> dict[str, float]:
    """Draw the friction of all holes."""
    mu = float(random.uniform(0.05, 0.3))
    return {"static": mu * 1.2, "kinetic": mu}


def direction_of(random: np.random.Generator, k: int) -> Any:
    """Draw the direction of a hole: mostly the surface's normal."""
    kind = random.choice(["normal", "free", "needle"], p=(0.6, 0.25, 0.15))
    if kind != "needle":
        return str(kind)
    lean = random.uniform(-0.6, 0.6, 2)
    return [float(lean[0]), float(lean[1]), -1.0 if k % 2 == 0 else 1.0]


def mesh_of(random: np.random.Generator, at: Array, footprint: float) -> dict[str, Any]:
    """Draw the block: wide enough for its holes, with coarse cells."""
    return {
        "kind": "block",
        "generator": "structured",
        "size": [float(np.ptp(at[:, 0]) + 0.03), 0.03, float(random.uniform(0.01, 0.02))],
        "h": 6e-3,
        "h_site": 2.0 * footprint,
        "accuracy": "given",  # many quick runs
    }
