"""The picture of a mesh in a section, by matplotlib, without OpenGL."""

import sys
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from studies.arrays import MILLI
from studies.figure import literal
from studies.output.reading import nodal
from studies.pictures.mesh_report import MeshScene
from studies.pictures.section import ASIDE, DPI, cut
from studies.pictures.view import MARKER, SIZE, colours, read_scene


def draw_section(scene: MeshScene, path: Path) -> None:
    """Draw the cut y = const through the piercings [mm].

    It is coloured by the mean edge length at each node.
    """
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), layout="constrained")
    axes = figure.add_subplot()
    low, high = scene.points[:, 1].min(), scene.points[:, 1].max()
    middle = scene.sites[:, 1].mean() if len(scene.sites) else (low + high) / 2
    y = float(np.clip(middle, low, high - 2 * ASIDE * (high - low)) + ASIDE * (high - low))
    points, triangles, size = cut(scene.points, np.asarray(scene.cells), _sizes(scene) / MILLI, y)
    x, z = (points / MILLI).T
    filled = axes.tripcolor(x, z, size, triangles=triangles, shading="gouraud", cmap=ListedColormap(colours()))
    axes.triplot(x, z, triangles, color="#55453c", linewidth=0.4)
    axes.plot(*(scene.sites[:, [0, 2]] / MILLI).T, "o", color=MARKER, markersize=8)
    figure.colorbar(filled, ax=axes, label="edge length [mm]", shrink=0.8)
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="z [mm]")
    axes.set_title(f"{literal(scene.title) or 'mesh'}, y = {y / MILLI:.3g} mm", fontsize=11)
    figure.savefig(path, dpi=DPI)


def _sizes(scene: MeshScene) -> np.ndarray:
    """Return the mean length of the edges at each node [m].

    Each edge is weighted by the number of its cells.
    """
    pairs = np.asarray(scene.cells, dtype=np.int64)[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    length = np.linalg.norm(scene.points[pairs[:, 0]] - scene.points[pairs[:, 1]], axis=1)
    return nodal(length, pairs, len(scene.points))


if __name__ == "__main__":
    draw_section(read_scene(sys.argv[1]), Path(sys.argv[2]))
