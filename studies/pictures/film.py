"""An animation of frames as a GIF, by pyvista; in a child process, like `studies.pictures.space`."""

import pickle
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image

from studies.output.fields import OrganTopology
from studies.pictures.scene import Film, Frame
from studies.pictures.space import draw_staged, stage_of

SIZE = (900, 600)  # pixels
PAUSE, LAST = 120, 1500  # ms of each picture, and of the last one


def draw_film(frames: Sequence[Frame], topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw frames into a GIF file, all at the same scale."""
    stage = stage_of(frames, topology, title)
    write_film(frames, path, lambda frame, picture: draw_staged(frame, stage, picture))


def write_film(frames: Sequence[Frame], path: Path, draw: Callable[[Frame, Path], None]) -> None:
    """Write an endless animation of frames; `draw` draws each of them into a picture."""
    scratch = path.with_name("frame.png")
    pictures = []
    for frame in frames:
        draw(frame, scratch)
        pictures.append(small(scratch))
    pauses = [PAUSE] * (len(pictures) - 1) + [LAST]
    pictures[0].save(path, format="GIF", save_all=True, append_images=pictures[1:], duration=pauses, loop=0)


def small(path: Path) -> Image.Image:
    """Return a picture in the size of an animation."""
    with Image.open(path) as picture:
        return picture.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS)


if __name__ == "__main__":
    film: Film = pickle.loads(Path(sys.argv[1]).read_bytes())
    draw_film(film[0], film[1], Path(sys.argv[2]), film[2])
