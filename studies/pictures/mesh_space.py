"""The picture of a mesh in three dimensions, by pyvista.

It is drawn in a child process, like `studies.pictures.space`.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from studies.pictures.mesh_report import MeshScene
from studies.pictures.space import write_picture
from studies.pictures.view import MARKER, SIZE, THREAD, read_scene

REGIONS = ("#f0d9c8", "#dc7356", "#8fb7c9", "#c9b458", "#8ea66f", "#9d7fb0")  # the first: no region
LIP = THREAD


def draw_space(scene: MeshScene, path: Path) -> None:
    """Draw the surface into a PNG file, next to a cut.

    The cut shows the cells behind a plane through the piercings.
    """
    plotter: Any = pv.Plotter(off_screen=True, window_size=list(SIZE), shape=(1, 2), border=False)
    plotter.set_background("white")
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: np.asarray(scene.cells)}, scene.points)
    grid.cell_data["region"] = scene.region
    centre = scene.sites.mean(axis=0) if len(scene.sites) else scene.points.mean(axis=0)
    hair = 1e-4 * float(np.ptp(scene.points[:, 1]))
    beyond = grid.clip(normal="-y", origin=centre + np.array([0.0, hair, 0.0]), crinkle=True)
    for column, part in enumerate((grid, beyond)):
        plotter.subplot(0, column)
        _add_cells(plotter, part)
        _add_marks(plotter, scene)
        plotter.view_vector((0.45, -0.8, 0.75) if column == 0 else (0.15, -0.9, 0.45), viewup=(0.0, 0.0, 1.0))
        plotter.enable_anti_aliasing("ssaa")
    plotter.subplot(0, 0)
    plotter.add_text(scene.title or "mesh", position="upper_left", font_size=14, color="black")
    write_picture(plotter, path)


def _add_cells(plotter: Any, part: Any) -> None:
    """Add the surface of a part, coloured by region."""
    skin = part.extract_surface(algorithm="dataset_surface")
    number = np.asarray(skin.cell_data["region"]) % len(REGIONS)
    skin.cell_data["colour"] = np.array([pv.Color(colour).int_rgb for colour in REGIONS], dtype=np.uint8)[number]
    plotter.add_mesh(
        skin, scalars="colour", rgb=True, show_edges=True, edge_color="#55453c", line_width=1, ambient=0.35, diffuse=0.6
    )


def _add_marks(plotter: Any, scene: MeshScene) -> None:
    """Add the wound's edge and the piercings."""
    if len(scene.lips):
        lips = pv.PolyData.from_regular_faces(scene.points, scene.lips)
        rim = lips.extract_feature_edges(
            boundary_edges=True, feature_edges=False, manifold_edges=False, non_manifold_edges=False
        )
        plotter.add_mesh(rim, color=LIP, line_width=5)
    size = float(np.linalg.norm(np.ptp(scene.points, axis=0)))
    for site in scene.sites:
        plotter.add_mesh(pv.Sphere(radius=0.008 * size, center=site), color=MARKER)


if __name__ == "__main__":
    draw_space(read_scene(sys.argv[1]), Path(sys.argv[2]))
