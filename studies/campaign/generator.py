"""Realistic scenarios drawn at random from a seed, with all defaults.

A suture of the catalogue, 2-0 to 8-0, pierces a block of tissue, 2 kPa to 2 MPa, from above. It
goes down and up through one to six holes in turn. One end is held, loaded or free, and the other is
driven or pulled. The `demand` of a scenario is the displacement of its holes by a linear estimate,
0.6 F/(E a), in footprints a. Many scenarios have an additional request: rest, ties, tracts, cuts,
schedules, finite strain, contact of lips. Each request changes the tables of a case by its own
random numbers, so the case itself depends only on its seed.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from studies.arrays import Array
from studies.scenario.stitch import unit

Tables = dict[str, Any]
Random = np.random.Generator
SUTURES = tuple(f"{size}-0 {material}" for size in range(2, 9) for material in ("polypropylene", "nylon", "silk"))
KINDS = ("driven", "ramped", "dead", "sudden")
ESTIMATE = 0.6  # times F/(E a): displacement of a footprint under a force F
GENTLE = 3.0  # footprints
UP = np.array([0.0, 0.0, 1.0])
SETTLING = 0.1  # [s] of a run after the growth of its load
BITE, PITCH, DEEP = (4e-3, 7e-3), 8e-3, 5e-3  # m: half of a stitch's width, distance of stitches, depth of a bite
# A tied stitch, from hand to hand: across the wound in half widths, along the wound, up [m].
LOOP = np.array([[-1, -1.5e-3, 6e-3], [0, 0, 3e-3], [1, 0, 0], [1, 0, -DEEP], [-1, 0, -DEEP], [-1, 0, 0], [0, 0, 3e-3],
                 [1, 1.5e-3, 6e-3]])  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One scenario as tables.

    It has its `number`, its `kind`, its `demand` [-] and its additional request `ask`.
    """

    number: int
    kind: str
    demand: float
    tables: Tables
    ask: str = "motion"

    @property
    def gentle(self) -> bool:
        """Whether its holes move by less than GENTLE footprints and its loads grow."""
        return self.kind != "sudden" and self.demand < GENTLE


def cases(seed: int, count: int, first: int = 0) -> Iterator[Case]:
    """Yield the cases of a seed; each depends only on its number."""
    for number in range(first, first + count):
        yield case(np.random.default_rng([seed, number]), number)


def log_uniform(random: Random, low: float, high: float) -> float:
    """Return a random number whose logarithm is uniform."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def case(random: Random, number: int) -> Case:
    """Return one random case."""
    holes = int(random.integers(1, 7))
    footprint = float(random.choice([0.5e-3, 1e-3, 1.5e-3]))
    modulus = log_uniform(random, 2e3, 2e6)
    x = np.concatenate([[0.0], np.cumsum(random.uniform(5.0, 10.0, holes - 1) * 1e-3)])
    at = np.column_stack([x - x.mean(), random.uniform(-2e-3, 2e-3, holes), np.zeros(holes)])
    path = path_through(random, at)
    kind = str(random.choice(KINDS, p=(0.4, 0.25, 0.2, 0.15)))
    start, end, force, duration = ends_of(random, kind, path, modulus * footprint * holes)
    mu = 0.0 if random.random() < 0.6 else float(random.uniform(0.05, 0.3))
    hole = {"footprint": footprint} | ({"friction": {"static": mu * 1.2, "kinetic": mu}} if mu else {})
    tables = {
        "piercing": [
            {"name": f"hole{k + 1}", "at": at[k].tolist(), "direction": direction_of(random, k)} | hole
            for k in range(holes)
        ],
        "tissue": {
            "youngs_modulus": modulus, "poisson_ratio": float(random.choice([0.3, 0.45])), "density": 1060.0,
            "rayleigh": [10.0, 1e-4], "clamp": ["bottom"], "inertia": bool(random.random() < 0.5),
            "mesh": {
                "kind": "block", "generator": "structured",
                "size": [float(np.ptp(at[:, 0]) + 0.03), 0.03, float(random.uniform(0.01, 0.02))],
                "h": 6e-3, "h_site": 2.0 * footprint, "accuracy": "given",  # wide enough, with coarse cells
            },
        },
        "thread": {"suture": str(random.choice(SUTURES)), "path": path.tolist(), "start": start, "end": end}
        | ({"damping": 20.0} if random.random() < 0.5 else {}),
        "solve": {"dt": 1e-3, "duration": duration}, "output": {"every": 1000},
    }  # fmt: skip
    return Case(number, kind, demand_of(tables, force), tables)


def demand_of(tables: Tables, force: float) -> float:
    """Return the displacement of a hole under a force [N] by the linear estimate, in footprints."""
    return ESTIMATE * force / (tables["tissue"]["youngs_modulus"] * tables["piercing"][0]["footprint"] ** 2)


def path_through(random: Random, at: Array) -> Array:
    """Return the corners of a path through the holes, shape `(k, 3)` [m].

    The path comes from the left above the block, goes down and up through the holes, and leaves to
    the right. For an odd number of holes it ends below the block.
    """
    tail, head = random.uniform(15e-3, 40e-3, 2)
    rise = random.uniform(4e-3, 10e-3)
    rows = [at[0] + [-tail, random.uniform(-5e-3, 5e-3), random.uniform(5e-3, 25e-3)], at[0] + [0, 0, rise]]
    for k in range(len(at)):
        height = random.uniform(4e-3, 7e-3)
        rows += list(at[k : k + 2] + (rise if k % 2 else -height) * UP)
    up = 1.0 if len(at) % 2 == 0 else -1.0
    return np.array([*rows, rows[-1] + [head, random.uniform(-10e-3, 10e-3), up * random.uniform(2e-3, 25e-3)]])


def ends_of(random: Random, kind: str, path: Array, stiffness: float) -> tuple[Tables, Tables, float, float]:
    """Return random tables of both ends, the force on the holes [N], and the duration [s].

    `stiffness` [N/m] is the sum of E a over all holes.
    """
    away, turned = unit(path[0] - path[1]), unit(unit(path[-1] - path[-2]) + 0.5 * random.standard_normal(3))
    pull = log_uniform(random, 0.05, 3.0)
    hold = str(random.choice(["free", "fixed", "clamped", "pulled"], p=(0.2, 0.3, 0.1, 0.4)))
    tail = float(min(pull, log_uniform(random, 0.01, 0.3)))
    time = float(random.uniform(0.1, 0.3))
    if kind == "driven" or (kind == "ramped" and random.random() < 0.3):
        way = random.uniform(5e-3, 40e-3) * (0.3 if hold in ("fixed", "clamped") else 1.0)
        force = {"free": 0.0, "pulled": tail}.get(hold, way * stiffness / ESTIMATE)
        start = {"kind": hold} | ({"force": (tail * away).tolist(), "ramp": 0.05} if hold == "pulled" else {})
        return start, driven(path[-1], way * turned, time), float(force), time + 0.05
    load = {"kind": "pulled"} | {"ramped": {"ramp": time}, "sudden": {"ramp": 0.0}}.get(kind, {})
    if kind in ("dead", "sudden") and random.random() < 0.5:
        return load | {"force": (pull * away).tolist()}, driven(path[-1], 5e-3 * turned, time), pull, time
    start = {"kind": hold if hold == "clamped" else "fixed"}
    return start, load | {"force": (pull * turned).tolist()}, pull, time + SETTLING


def driven(place: Array, way: Array, time: float) -> Tables:
    """Return the table of an end that is moved along its `way` [m] within a `time` [s].

    The motion starts at `place`.
    """
    return {"kind": "driven", "waypoints": [[0.0, *place], [time, *(place + way)]]}


def direction_of(random: Random, k: int) -> Any:
    """Return a random direction of a hole, mostly the surface's normal."""
    kind = random.choice(["normal", "free", "needle"], p=(0.6, 0.25, 0.15))
    if kind != "needle":
        return str(kind)
    lean = random.uniform(-0.6, 0.6, 2)
    return [float(lean[0]), float(lean[1]), -1.0 if k % 2 == 0 else 1.0]


# --- additional requests ------------------------------------------------------------------------------------


def at_rest(random: Random, tables: Tables) -> None:
    """Change the case to an equilibrium under its loads."""
    tables["solve"] = {"kind": "static", "load_steps": 10, "duration": tables["solve"]["duration"]}


def scheduled(random: Random, tables: Tables) -> None:
    """Begin a piercing late, or end it early."""
    piercing = tables["piercing"][int(random.integers(len(tables["piercing"])))]
    time = float(random.uniform(0.2, 0.7) * tables["solve"]["duration"])
    piercing["from" if random.random() < 0.5 else "until"] = time


def cut(random: Random, tables: Tables) -> None:
    """Cut the thread during the run."""
    length = length_of(tables["thread"]["path"])
    time = float(random.uniform(0.3, 0.7) * tables["solve"]["duration"])
    tables["cut"] = [{"s": float(random.uniform(0.15, 0.85) * length), "time": time}]


def length_of(path: Any) -> float:
    """Return the length of a polygon through points of three numbers [m]."""
    return float(np.linalg.norm(np.diff(np.array(path), axis=0), axis=1).sum())


def with_tracts(random: Random, tables: Tables) -> None:
    """Add tracts between each hole down and the next hole up."""
    holes = [hole["name"] for hole in tables["piercing"]]
    shared = {key: value for key, value in tables["piercing"][0].items() if key == "friction"}
    tables["tract"] = [{"between": list(pair)} | shared for pair in zip(holes[::2], holes[1::2], strict=False)]


def stiffening(random: Random, tables: Tables) -> None:
    """Change the tissue to finite strain."""
    law: Tables = {"material": "neo-hookean"} if random.random() < 0.5 else {"material": "exponential"}
    law |= {"stiffening": float(random.uniform(1.0, 8.0))} if law["material"] == "exponential" else {}
    tables["tissue"] |= law | {"inertia": False, "rayleigh": [0.0, 0.0]}
    if random.random() < 0.6:
        at_rest(random, tables)


def over_a_wound(random: Random, tables: Tables, stitches: int) -> Array:
    """Place the holes on both sides of a wound; return the places, (stitches, 2, 3) [m].

    The lips touch in about half of the cases.
    """
    half, hole = float(random.uniform(*BITE)), tables["piercing"][0] | {"direction": "normal"}
    y = (np.arange(stitches) - 0.5 * (stitches - 1)) * PITCH
    at, slit = np.array([[[-half, each, 0.0], [half, each, 0.0]] for each in y]), bool(random.random() < 0.4)
    tables["tissue"]["mesh"] = {
        "kind": "wound", "shape": "slit" if slit else "ellipse", "size": [0.05, 0.05, 0.02], "depth": 0.008, "h": 5e-3,
        "length": float(max(stitches * PITCH + 0.008, 0.02)), "h_site": 2.0 * hole["footprint"],
    } | ({} if slit else {"width": float(random.uniform(1e-3, 4e-3))})  # fmt: skip
    tables["tissue"]["contact"] = bool(slit or random.random() < 0.5)
    tables["piercing"] = [hole | {"name": f"hole{k}", "at": x} for k, x in enumerate(at.reshape(-1, 3).tolist(), 1)]
    return at


def running(random: Random, tables: Tables) -> float:
    """Change the case to a running stitch over a wound, and return the pull on it [N]."""
    at, bite = over_a_wound(random, tables, int(random.integers(1, 4))), [4e-3, -DEEP]
    path = [pair[k] + height * UP for pair in at for k, way in ((0, bite), (1, bite[::-1])) for height in way]
    path = [at[0, 0] + [-0.02, 0.0, 0.02], *path, at[-1, 1] + [0.02, 0.0, 0.02]]
    pull = float(random.uniform(0.05, 0.6))
    end: Tables = {"kind": "pulled", "force": [0.7 * pull, 0.0, 0.7 * pull]}
    tables["thread"] |= {"path": np.array(path).tolist(), "start": {"kind": "fixed"}, "end": end}
    if random.random() < 0.6:
        at_rest(random, tables)
    else:
        end["ramp"] = 0.5 * tables["solve"]["duration"]
    return pull


def tied(random: Random, tables: Tables) -> float:
    """Change the case to tied single stitches over a wound; return the force of the hands [N].

    The thread is cut between the stitches.
    """
    at = over_a_wound(random, tables, int(random.integers(1, 4)))
    loops = np.array([LOOP * [right[0], 1.0, 1.0] + [0.0, right[1], 0.0] for _, right in at])
    ends = [[*loops[:k].reshape(-1, 3), 0.5 * (loops[k - 1, -1] + loops[k, 0])] for k in range(1, len(loops))]
    holes = tables["piercing"]
    tables["piercing"] = [hole for pair in zip(holes[1::2], holes[::2], strict=True) for hole in pair]
    names, free = [hole["name"] for hole in tables["piercing"]], {"kind": "free"}
    force, duration = float(random.uniform(0.05, 0.8)), tables["solve"]["duration"]
    path = {"path": loops.reshape(-1, 3).tolist(), "cuts": [length_of(end) for end in ends]}
    tables["thread"] |= path | {"start": free, "end": free}
    tie = {"force": force, "until": 0.75 * duration, "ramp": 0.6 * duration}
    pairs = zip(names[::2], names[1::2], strict=True)
    tables["tie"] = [{"name": f"knot{k}", "between": list(pair)} | tie for k, pair in enumerate(pairs, 1)]
    if random.random() < 0.6:
        at_rest(random, tables)
    return force


ASKS: dict[str, tuple[float, Callable[[Random, Tables], float | None]]] = {
    "motion": (0.3, lambda random, tables: None), "rest": (0.15, at_rest), "schedule": (0.08, scheduled),
    "cut": (0.07, cut), "tract": (0.1, with_tracts), "finite strain": (0.12, stiffening), "wound": (0.08, running),
    "ties": (0.1, tied),
}  # fmt: skip


def asked(seed: int, count: int, first: int = 0) -> Iterator[Case]:
    """Yield the cases of a seed with their additional requests."""
    names, shares = list(ASKS), [share for share, _ in ASKS.values()]
    for drawn in cases(seed, count, first):
        random = np.random.default_rng([seed, drawn.number, 1])
        case = replace(drawn, ask=names[int(random.choice(len(names), p=shares))])
        force = ASKS[case.ask][1](random, case.tables)
        yield case if force is None else replace(case, kind="ramped", demand=demand_of(case.tables, force))
