"""A frame as it is drawn, for a child process: to load the classes of a run would take it half a second."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from studies.arrays import Array
from studies.output.fields import OrganRecord, OrganTopology, ThreadRecord

if TYPE_CHECKING:
    from studies.output.records import Snapshot


@dataclass(frozen=True)
class Hole:
    """A piercing: its abscissa `s` [m] on the thread, `x` (3,) [m], the `force` (3,) of the hole on the thread [N], and
    its state in a word; the radius of its `footprint` [m] if it is drawn."""

    name: str
    s: float
    x: Array
    force: Array
    state: str
    footprint: float = 0.0


@dataclass(frozen=True)
class Frame:
    """Thread, holes and organ at a `time` [s]; None without an organ. Places of nodes `held` `(k, 3)` [m] are drawn."""

    time: float
    thread: ThreadRecord
    piercings: tuple[Hole, ...]
    organ: OrganRecord | None
    held: Array | None = None


Scene = tuple[Frame, OrganTopology | None, str]  # with a title
Film = tuple[list[Frame], OrganTopology | None, str]


def frame_of(snapshot: "Snapshot") -> Frame:
    """Return the frame of a snapshot."""
    holes = tuple(Hole(hole.name, hole.s, hole.x, hole.force, hole.state) for hole in snapshot.piercings)
    return Frame(snapshot.time, snapshot.thread, holes, snapshot.organ)
