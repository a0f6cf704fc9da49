"""What else a scenario of the campaign asks for: rest, ties, tracts, cuts, schedules, finite strain, lips in contact.

Each changes the tables of a case by draws of its own, so that the cases themselves stay what their seed makes them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from studies.arrays import Array
from studies.campaign.generator import Case, cases, demand_of

Tables = dict[str, Any]
Random = np.random.Generator
LOAD_STEPS = 10
BITE, PITCH = (4e-3, 7e-3), 8e-3  # m: half of the width of a stitch, and the distance of stitches
UP, DEEP = 4e-3, 5e-3  # m: above and below the skin


def at_rest(random: Random, tables: Tables) -> None:
    """Ask for the equilibrium under the loads of the case."""
    tables["solve"] = {"kind": "static", "load_steps": LOAD_STEPS, "duration": tables["solve"]["duration"]}


def scheduled(random: Random, tables: Tables) -> None:
    """Let a piercing begin late, or end early."""
    piercing = tables["piercing"][int(random.integers(len(tables["piercing"])))]
    duration = tables["solve"]["duration"]
    piercing["from" if random.random() < 0.5 else "until"] = float(random.uniform(0.2, 0.7) * duration)


def cut(random: Random, tables: Tables) -> None:
    """Cut the thread on its way."""
    length = length_of(tables["thread"]["path"])
    time = float(random.uniform(0.3, 0.7) * tables["solve"]["duration"])
    tables["cut"] = [{"s": float(random.uniform(0.15, 0.85) * length), "time": time}]


def length_of(path: Sequence[Any]) -> float:
    """Return the length of a polygon through points of three numbers [m]."""
    return float(np.linalg.norm(np.diff(np.array(path), axis=0), axis=1).sum())


def with_tracts(random: Random, tables: Tables) -> None:
    """Let the thread bear on the tissue between each hole down and the next one up."""
    holes = [hole["name"] for hole in tables["piercing"]]
    friction = tables["piercing"][0].get("friction")
    tables["tract"] = [
        {"between": [one, other]} | ({"friction": friction} if friction else {})
        for one, other in zip(holes[::2], holes[1::2], strict=False)
    ]


def stiffening(random: Random, tables: Tables) -> None:
    """Make the tissue one at finite strain."""
    if random.random() < 0.5:
        tables["tissue"] |= {"material": "neo-hookean"}
    else:
        tables["tissue"] |= {"material": "exponential", "stiffening": float(random.uniform(1.0, 8.0))}
    tables["tissue"] |= {"inertia": False, "rayleigh": [0.0, 0.0]}
    if random.random() < 0.6:
        at_rest(random, tables)


def over_a_wound(random: Random, tables: Tables, stitches: int) -> Array:
    """Put the holes on both sides of a wound, those of one stitch after the other, and return where, (stitches, 2, 3)
    [m]; the lips touch in half of the cases."""
    half, footprint = float(random.uniform(*BITE)), tables["piercing"][0]["footprint"]
    y = (np.arange(stitches) - 0.5 * (stitches - 1)) * PITCH
    at = np.array([[[-half, each, 0.0], [half, each, 0.0]] for each in y])
    slit = bool(random.random() < 0.4)
    tables["tissue"]["mesh"] = {
        "kind": "wound", "shape": "slit" if slit else "ellipse", "size": [0.05, 0.05, 0.02],
        "length": float(max(stitches * PITCH + 0.008, 0.02)), "depth": 0.008, "h": 5e-3, "h_site": 2.0 * footprint,
    } | ({} if slit else {"width": float(random.uniform(1e-3, 4e-3))})  # fmt: skip
    tables["tissue"]["contact"] = bool(slit or random.random() < 0.5)
    first = tables["piercing"][0]
    friction = {"friction": first["friction"]} if "friction" in first else {}
    tables["piercing"] = [
        {"name": f"hole{k + 1}", "at": place.tolist(), "footprint": footprint, "direction": "normal"} | friction
        for k, place in enumerate(at.reshape(-1, 3))
    ]
    return at


def running(random: Random, tables: Tables) -> float:
    """Draw a running stitch over a wound, and return the pull on it [N]."""
    stitches = int(random.integers(1, 4))
    at, up = over_a_wound(random, tables, stitches), np.array([0.0, 0.0, UP])
    deep = np.array([0.0, 0.0, -DEEP])
    path = [at[0, 0] + [-0.02, 0.0, 0.02]]
    for one, other in at:
        path += [one + up, one + deep, other + deep, other + up]
    path.append(at[-1, 1] + [0.02, 0.0, 0.02])
    duration, pull = tables["solve"]["duration"], float(random.uniform(0.05, 0.6))
    ends = {"start": {"kind": "fixed"}, "end": {"kind": "pulled", "force": [0.7 * pull, 0.0, 0.7 * pull]}}
    tables["thread"] |= {"path": np.array(path).tolist()} | ends
    if random.random() < 0.6:
        at_rest(random, tables)
    else:
        tables["thread"]["end"]["ramp"] = 0.5 * duration
    return pull


def tied(random: Random, tables: Tables) -> float:
    """Tie single stitches over a wound, cut from one another, and return the force of the hands [N]."""
    stitches = int(random.integers(1, 4))
    at = over_a_wound(random, tables, stitches)
    path: list[Array] = []
    cuts: list[float] = []
    for one, other in at:
        half = other[0]
        loop = one[1] * np.array([0, 1.0, 0]) + np.array(
            [[-half, -1.5e-3, 6e-3], [0, 0, 3e-3], [half, 0, 0], [half, 0, -DEEP], [-half, 0, -DEEP], [-half, 0, 0],
             [0, 0, 3e-3], [half, 1.5e-3, 6e-3]])  # fmt: skip
        if path:
            cuts.append(length_of([*path, 0.5 * (path[-1] + loop[0])]))
        path += list(loop)
    for k in range(stitches):
        tables["piercing"][2 * k : 2 * k + 2] = tables["piercing"][2 * k : 2 * k + 2][::-1]
    names = [hole["name"] for hole in tables["piercing"]]
    duration, force = tables["solve"]["duration"], float(random.uniform(0.05, 0.8))
    tables["thread"] |= {
        "path": np.array(path).tolist(),
        "cuts": cuts,
        "start": {"kind": "free"},
        "end": {"kind": "free"},
    }
    tables["tie"] = [
        {"name": f"knot{k + 1}", "between": names[2 * k : 2 * k + 2], "force": force, "until": 0.75 * duration,
         "ramp": 0.6 * duration} for k in range(stitches)]  # fmt: skip
    if random.random() < 0.6:
        at_rest(random, tables)
    return force


ASKS: dict[str, tuple[float, Callable[[Random, Tables], float | None]]] = {
    "motion": (0.3, lambda random, tables: None),
    "rest": (0.15, at_rest),
    "schedule": (0.08, scheduled),
    "cut": (0.07, cut),
    "tract": (0.1, with_tracts),
    "finite strain": (0.12, stiffening),
    "wound": (0.08, running),
    "ties": (0.1, tied),
}


def asked(seed: int, count: int, first: int = 0) -> Iterator[Case]:
    """Yield the cases of a seed, each with what else it asks for."""
    names, shares = list(ASKS), [share for share, _ in ASKS.values()]
    for case in cases(seed, count, first):
        random = np.random.default_rng([seed, case.number, 1])
        name = names[int(random.choice(len(names), p=shares))]
        force = ASKS[name][1](random, case.tables)
        demand = case.demand if force is None else demand_of(case.tables, force)
        kind = case.kind if force is None else "ramped"
        yield replace(case, kind=kind, ask=name, demand=demand)
