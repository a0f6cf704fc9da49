"""A frame or a mesh for a picture in a child process.

The process does not load the classes of a run, which would take half a second.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.arrays import Array
from studies.output.fields import ThreadRecord

if TYPE_CHECKING:
    from studies.output.records import Snapshot

FILM = ".gif"  # suffix of an animation


@dataclass(frozen=True)
class Hole:
    """A piercing in a picture.

    `s` [m] is its abscissa on the thread and `x` (3,) [m] its place. `force` (3,) [N] is the force
    of the hole on the thread, and `state` a word. `footprint` [m] is a radius, zero if no footprint
    is drawn.
    """

    name: str
    s: float
    x: Array
    force: Array
    state: str
    footprint: float = 0.0


class Organ(NamedTuple):
    """The nodes of an organ in a picture.

    They have a displacement `(nodes, 3)` [m] and a von Mises stress `(nodes,)` [Pa].
    """

    displacement: Array
    von_mises: Array


@dataclass(frozen=True)
class Frame:
    """Thread, holes and organ at a `time` [s]; `organ` is None without an organ.

    `held` are places of nodes `(k, 3)` [m] to be drawn, or None.
    """

    time: float
    thread: ThreadRecord
    piercings: tuple[Hole, ...]
    organ: Organ | None
    held: Array | None = None


@dataclass(frozen=True)
class MeshScene:
    """A mesh for a picture.

    It has points `(n, 3)` [m], and cells `(m, 4)` with the number of their region. `lips` are the
    facets `(k, 3)` of the wound's lips, and `sites` the places of the piercings `(p, 3)` [m].
    """

    points: Array
    cells: NDArray[np.integer]
    region: NDArray[np.integer]
    lips: NDArray[np.integer]
    sites: Array
    title: str


def frame_of(snapshot: "Snapshot", held: Array | None = None, footprints: Sequence[float] = ()) -> Frame:
    """Return the frame of a snapshot.

    If given, the places of `held` nodes `(k, 3)` [m] and the radii of the holes' `footprints` [m]
    are also drawn.
    """
    sized = zip(snapshot.piercings, footprints or [0.0] * len(snapshot.piercings), strict=True)
    holes = tuple(Hole(hole.name, hole.s, hole.x, hole.force, hole.state, size) for hole, size in sized)
    organ = None if snapshot.organ is None else Organ(snapshot.organ.displacement, snapshot.organ.von_mises)
    return Frame(snapshot.time, snapshot.thread, holes, organ, held)
