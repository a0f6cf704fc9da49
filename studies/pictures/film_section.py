"""An animation of frames as a GIF, in sections by matplotlib, without OpenGL."""

import pickle
import sys
from collections.abc import Sequence
from pathlib import Path

from studies.output.fields import OrganTopology
from studies.pictures.film import write_film
from studies.pictures.scene import Film, Frame
from studies.pictures.section import draw_scaled
from studies.pictures.view import scale_of


def draw_film(frames: Sequence[Frame], topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw frames into a GIF file, all at the same scale."""
    scale = scale_of(frames)
    write_film(frames, path, lambda frame, picture: draw_scaled(frame, topology, picture, title, scale))


if __name__ == "__main__":
    film: Film = pickle.loads(Path(sys.argv[1]).read_bytes())
    draw_film(film[0], film[1], Path(sys.argv[2]), film[2])
