"""A frame for a picture in a child process.

The process does not load the classes of a run, which would take half a second.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from studies.arrays import Array
from studies.output.fields import OrganRecord, OrganTopology, ThreadRecord

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


@dataclass(frozen=True)
class Frame:
    """Thread, holes and organ at a `time` [s]; `organ` is None without an organ.

    `held` are places of nodes `(k, 3)` [m] to be drawn, or None.
    """

    time: float
    thread: ThreadRecord
    piercings: tuple[Hole, ...]
    organ: OrganRecord | None
    held: Array | None = None


Scene = tuple[list[Frame], OrganTopology | None, str]  # frames for one file, and its title


def frame_of(snapshot: "Snapshot") -> Frame:
    """Return the frame of a snapshot."""
    holes = tuple(Hole(hole.name, hole.s, hole.x, hole.force, hole.state) for hole in snapshot.piercings)
    return Frame(snapshot.time, snapshot.thread, holes, snapshot.organ)
