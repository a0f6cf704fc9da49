"""A store of parts that scenarios share, keyed by their inputs.

The parts are mesh, discrete organ, factor and compliance. An organ depends on all of a scenario
except the tables and keys listed here: the thread, its events in time, and the effect of a hole on
the thread only. An unlisted key, for example a new one, makes another organ.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any, TypeVar

from studies.scenario import Scenario, tables, with_mesh_copy

Made = TypeVar("Made")

NOT_OF_ORGAN = ("title", "thread", "cut", "tie", "output")
OF_STEPS = (
    "start", "dt", "duration", "load_steps", "scheme", "newton", "integrator", "coupling",
    "friction", "epsilon",
)  # fmt: skip
OF_THREAD = ("kind", "s", "friction", "from", "until", "draw", "pull", "channel")  # of a piercing
# keys of the organ that do not affect its mesh and stiffness
OF_MOTION = ("inertia", "rayleigh", "solver", "contact", "load")
OF_PULL = ("force", "ramp")  # of an end of the thread: the thread is laid before the loads act
OF_LENGTH = ("start", "dt", "duration", "load_steps")  # of a run: the thread is laid before the run
OF_MATERIAL = ("youngs_modulus", "poisson_ratio", "density", "dilatation")


class Shared:
    """A cache of the last expensive part of each kind: if cases are sorted by organ, each organ is made once."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[str, Any]] = {}
        self._lock = RLock()

    def take(self, kind: str, key: str, make: Callable[[], Made]) -> Made:
        """Return the last part of a kind if it has the key, else the result of `make`."""
        with self._lock:
            known = self._kept.get(kind)
            if known is None or known[0] != key:
                self._kept.pop(kind, None)  # first, because a large organ needs the memory of the last one
                known = self._kept[kind] = key, make()
            return known[1]


def organ_key(scenario: Scenario) -> str:
    """Return the digest of all inputs of the organ with its holes."""
    bears = scenario.thread.surface
    more = {"krylov": scenario.has_krylov, "bears": None if bears is None else bears.friction}
    return digest(organ_tables(scenario) | more, scenario)


def start_key(scenario: Scenario) -> str:
    """Return the digest of all inputs of the start.

    Loads are no inputs, because the thread is laid before they act.
    """
    plain = without(tables(scenario), ("title", "cut", "output"))
    solve = without(plain["solve"], OF_LENGTH)
    return digest(plain | {"thread": unpulled(plain["thread"]), "solve": solve}, scenario)


def thread_key(scenario: Scenario, length: float, s: Sequence[float]) -> str:
    """Return the digest of all inputs of the thread.

    These include its rest length and the abscissae of holes [m].
    """
    laid = [length, *(float(at) for at in s)]
    made = {"thread": unpulled(tables(scenario)["thread"]), "laid": laid, "scheme": scenario.solve.scheme}
    if scenario.thread.knots == "travelling":  # travelling knots depend on the holes and ties
        holes = [[hole.direction == "free", hole.from_ == 0.0] for hole in scenario.piercing]
        made |= {"knots": [holes, len(scenario.tie)]}
    return digest(made, scenario)


def unpulled(thread: dict[str, Any]) -> dict[str, Any]:
    """Return the table of a thread without the loads on its ends."""
    return thread | {end: without(thread[end], OF_PULL) for end in ("start", "end") if end in thread}


def body_key(scenario: Scenario) -> str:
    """Return the digest of all inputs of an organ's discrete elasticity."""
    return digest(body_tables(scenario), scenario)


def places_key(scenario: Scenario) -> str:
    """Return the digest of all inputs of the places of holes on the organ's surface."""
    lines = [[hole.near, hole.line] for hole in scenario.piercing]
    return digest(body_tables(scenario) | {"lines": lines}, scenario)


def mesh_key(scenario: Scenario) -> str:
    """Return the digest of all inputs of an organ's mesh."""
    plain = body_tables(scenario)
    organ = without(plain.get("tissue", {}), OF_MATERIAL)
    regions = [without(region, OF_MATERIAL) for region in organ.get("region", [])]
    return digest(plain | {"tissue": organ | {"region": regions}}, scenario)


def organ_tables(scenario: Scenario) -> dict[str, Any]:
    """Return the tables of a scenario that determine an organ with its holes."""
    plain = without(tables(scenario), NOT_OF_ORGAN)
    holes = [without(hole, OF_THREAD) for hole in plain.get("piercing", [])]
    thread, places = scenario.thread, [(hole.s, hole.from_ == 0.0) for hole in scenario.piercing]
    laid = {"laid": [thread.path, thread.length, places]} if scenario.tract else {}  # with balls along the path
    return plain | {"piercing": holes, "solve": without(plain["solve"], OF_STEPS)} | laid


def body_tables(scenario: Scenario) -> dict[str, Any]:
    """Return the tables of a scenario that determine its organ's discrete elasticity.

    They include the places of holes.
    """
    of_holes: tuple[str, ...] = ("name", "at", "footprint")
    plain = without(organ_tables(scenario), ("solve", "tract", "laid"))
    if scenario.tissue is not None and scenario.tissue.mesh.accuracy != "given":  # refined cells
        of_holes, plain = (*of_holes, "weight", "direction"), without(organ_tables(scenario), ("solve",))
    holes = [{key: hole[key] for key in of_holes if key in hole} for hole in plain["piercing"]]
    organ = {"tissue": without(plain["tissue"], OF_MOTION)} if "tissue" in plain else {}
    return plain | {"piercing": holes, "floats": scenario.floats} | organ  # bodies can be free


def without(table: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    """Return a table without some keys."""
    return {key: value for key, value in table.items() if key not in keys}


def digest(plain: dict[str, Any], scenario: Scenario) -> str:
    """Return the SHA-256 of tables, and of the mesh file that a scenario names."""
    _, mesh = with_mesh_copy(scenario)
    return hashlib.sha256(json.dumps([plain, mesh], sort_keys=True).encode()).hexdigest()
