"""Frames in a file: one as a picture, or all as an animation."""

from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image

from studies.pictures.scene import FILM, Frame

SIZE = (900, 600)  # pixels
PAUSE, LAST = 120, 1500  # ms of each picture, and of the last one


def write_frames(frames: Sequence[Frame], path: Path, draw: Callable[[Frame, Path], None]) -> None:
    """Write the first frame as a PNG file, or all frames as an endless GIF.

    `draw` draws one frame into a picture.
    """
    if path.suffix.lower() != FILM:
        draw(frames[0], path)
        return
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
