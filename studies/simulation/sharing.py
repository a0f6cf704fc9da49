"""A store of parts that scenarios share: mesh, discrete organ, factor and compliance, keyed by their inputs.

An organ is made from all of a scenario but what is listed here: the thread, what is done to it in time, and what a hole
does to the thread alone. A key that is not listed, such as one that is added later, makes another organ.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import RLock
from typing import Any, Protocol, TypeVar

from studies.scenario import Scenario
from studies.scenario.toml import mesh_file, tables

Made = TypeVar("Made")

NOT_OF_ORGAN = ("title", "thread", "cut", "tie", "output")
OF_STEPS = (
    "start",
    "dt",
    "duration",
    "load_steps",
    "scheme",
    "newton",
    "integrator",
    "coupling",
    "friction",
    "epsilon",
)
OF_THREAD = ("kind", "s", "friction", "from", "until", "draw", "pull", "channel")  # of a piercing
# of the organ, beside its mesh and stiffness
OF_MOTION = ("inertia", "rayleigh", "solver", "contact", "load", "reduction")
OF_PULL = ("force", "ramp")  # of an end of the thread: it is laid before anything pulls
OF_LENGTH = ("start", "dt", "duration", "load_steps")  # of a run, before which the thread is laid
OF_MATERIAL = ("youngs_modulus", "poisson_ratio", "density", "dilatation")


class Store(Protocol):
    """A cache of expensive parts."""

    def take(self, kind: str, key: str, make: Callable[[], Made]) -> Made:
        """Return the cached part of a key, else the result of `make`."""


class Unshared:
    """A cache that keeps nothing."""

    def take(self, kind: str, key: str, make: Callable[[], Made]) -> Made:
        """Return the result of `make`."""
        return make()


class Shared:
    """Keeps the last of each kind: cases in the order of their organs make each organ once."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[str, Any]] = {}
        self._lock = RLock()

    def take(self, kind: str, key: str, make: Callable[[], Made]) -> Made:
        """Return the last part of a kind if it has the key, else the result of `make`."""
        with self._lock:
            known = self._kept.get(kind)
            if known is None or known[0] != key:
                self._kept.pop(kind, None)  # before the next is made: a large organ needs the memory of the last
                known = self._kept[kind] = key, make()
            made: Made = known[1]
            return made


def organ_key(scenario: Scenario) -> str:
    """Return the digest of all that the organ with its holes is made from."""
    return digest(organ_tables(scenario) | {"krylov": scenario.has_krylov}, scenario)


def reduction_key(scenario: Scenario) -> str:
    """Return the digest of all that the basis of an organ is made from: it is the same whatever damps."""
    plain = organ_tables(scenario)
    return digest(plain | {"tissue": without(plain.get("tissue", {}), ("rayleigh",))}, scenario)


def start_key(scenario: Scenario) -> str:
    """Return the digest of all that the start is made from: the thread is laid on the organ before anything pulls."""
    plain = without(tables(scenario), ("title", "cut", "output"))
    solve = without(plain["solve"], OF_LENGTH)
    return digest(plain | {"thread": unpulled(plain["thread"]), "solve": solve}, scenario)


def thread_key(scenario: Scenario, length: float, s: Sequence[float]) -> str:
    """Return the digest of all that the thread is made from, with its rest length and the abscissae of holes [m]."""
    laid = [length, *(float(at) for at in s)]
    made = {"thread": unpulled(tables(scenario)["thread"]), "laid": laid, "scheme": scenario.solve.scheme}
    if scenario.thread.knots == "travelling":  # whose knots are those of the holes that it is laid in, and of ties
        holes = [[hole.direction == "free", hole.from_ == 0.0] for hole in scenario.piercing]
        made |= {"knots": [holes, len(scenario.tie)]}
    return digest(made, scenario)


def unpulled(thread: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a thread without the loads on its ends."""
    return thread | {end: without(thread[end], OF_PULL) for end in ("start", "end") if end in thread}


def body_key(scenario: Scenario) -> str:
    """Return the digest of all that the discrete elasticity of an organ is made from."""
    return digest(body_tables(scenario), scenario)


def places_key(scenario: Scenario) -> str:
    """Return the digest of all that the places of holes on the organ's surface are made from."""
    lines = [[hole.near, hole.line] for hole in scenario.piercing]
    return digest(body_tables(scenario) | {"lines": lines}, scenario)


def mesh_key(scenario: Scenario) -> str:
    """Return the digest of all that an organ's mesh is made from."""
    plain = body_tables(scenario)
    organ = without(plain.get("tissue", {}), OF_MATERIAL)
    regions = [without(region, OF_MATERIAL) for region in organ.get("region", [])]
    return digest(plain | {"tissue": organ | {"region": regions}}, scenario)


def organ_tables(scenario: Scenario) -> dict[str, Any]:
    """Return the tables of a scenario that an organ with its holes is made from."""
    plain = without(tables(scenario), NOT_OF_ORGAN)
    holes = [without(hole, OF_THREAD) for hole in plain.get("piercing", [])]
    thread, places = scenario.thread, [hole.s for hole in scenario.piercing]
    laid = {"laid": [thread.path, thread.length, places]} if scenario.tract else {}  # the balls of tracts lie along it
    return plain | {"piercing": holes, "solve": without(plain["solve"], OF_STEPS)} | laid


def body_tables(scenario: Scenario) -> dict[str, Any]:
    """Return the tables of a scenario that its organ's discrete elasticity is made from: holes by their places."""
    of_holes: tuple[str, ...] = ("name", "at", "footprint")
    plain = without(organ_tables(scenario), ("solve", "tract", "laid"))
    if scenario.tissue is not None and scenario.tissue.mesh.accuracy != "given":  # cells that fit the holes and balls
        of_holes, plain = (*of_holes, "weight", "direction"), without(organ_tables(scenario), ("solve",))
    holes = [{key: hole[key] for key in of_holes if key in hole} for hole in plain["piercing"]]
    organ = {"tissue": without(plain["tissue"], OF_MOTION)} if "tissue" in plain else {}
    return plain | {"piercing": holes, "floats": scenario.floats} | organ  # where bodies may float none need be held


def without(table: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    """Return a table without some keys."""
    return {key: value for key, value in table.items() if key not in keys}


def digest(plain: dict[str, Any], scenario: Scenario) -> str:
    """Return the SHA-256 of tables, and of the mesh file that a scenario names."""
    file = mesh_file(scenario)
    contents = hashlib.sha256(Path(file).read_bytes()).hexdigest() if file is not None else ""
    return hashlib.sha256(json.dumps([plain, contents], sort_keys=True).encode()).hexdigest()
