"""The picture in three dimensions, by pyvista; in a child process, for a plotter without OpenGL ends it."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from studies.output.records import OrganTopology, Snapshot
from studies.pictures.view import (
    ARROW,
    KILO,
    MARKER,
    SIZE,
    THREAD,
    caption,
    colours,
    label,
    limits,
    read_scene,
    surface,
    view_box,
    view_width,
)

BLANK = 2.0  # standard deviation of the pixels' values below which nothing has been drawn


def draw_space(frame: Snapshot, topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw into a PNG file."""
    plotter: Any = pv.Plotter(off_screen=True, window_size=list(SIZE))
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    if topology is not None and frame.organ is not None:
        _add_organ(plotter, topology, frame)
    _add_thread(plotter, frame)
    _add_piercings(plotter, frame)
    plotter.add_text(caption(frame, title), position="upper_left", font_size=14, color="black")
    plotter.add_axes(color="black", line_width=3)
    plotter.camera_position = _camera(frame)
    image = np.asarray(plotter.screenshot(str(path), return_img=True))
    plotter.close()
    if image.std() < BLANK:
        raise RuntimeError("the renderer drew nothing")


def _add_organ(plotter: Any, topology: OrganTopology, frame: Snapshot) -> None:
    assert frame.organ is not None
    deformed = topology.points + frame.organ.displacement
    mesh: Any = pv.PolyData.from_regular_faces(deformed, surface(topology))
    mesh["von Mises stress [kPa]"] = frame.organ.von_mises / KILO
    mesh = mesh.clean()
    bar = {
        "color": "black",
        "vertical": False,
        "width": 0.4,
        "height": 0.09,
        "position_x": 0.3,
        "position_y": 0.02,
    }
    bar |= {"title_font_size": 24, "label_font_size": 20, "n_labels": 4, "fmt": "%.3g"}
    plotter.add_mesh(
        mesh, scalars="von Mises stress [kPa]", cmap=colours(), clim=limits(frame.organ.von_mises / KILO),
        smooth_shading=True, split_sharp_edges=True, feature_angle=50, opacity=0.75, culling="back",
        ambient=0.45, diffuse=0.65, specular=0.1, scalar_bar_args=bar,
    )  # fmt: skip
    edges = mesh.extract_feature_edges(feature_angle=50, boundary_edges=False, manifold_edges=False)
    if edges.n_cells:
        plotter.add_mesh(edges, color="#8a6d5c", line_width=2)


def _add_thread(plotter: Any, frame: Snapshot) -> None:
    """Add the thread as a tube, at least as thick as can be seen."""
    radius = max(frame.thread.radius, 0.004 * view_width(frame))
    for points in frame.thread.split():
        tube = pv.lines_from_points(points).tube(radius=radius, n_sides=24)
        plotter.add_mesh(tube, color=THREAD, smooth_shading=True, specular=0.4)


def _add_piercings(plotter: Any, frame: Snapshot) -> None:
    """Add the holes as balls, with the force of the organ's hole on the thread as arrows to one scale."""
    size = view_width(frame)
    largest = max((float(np.linalg.norm(hole.force)) for hole in frame.piercings), default=0.0)
    for hole in frame.piercings:
        plotter.add_mesh(pv.Sphere(radius=0.009 * size, center=hole.x), color=MARKER, smooth_shading=True)
        force = float(np.linalg.norm(hole.force))
        if force > 1e-3 * largest:
            arrow = pv.Arrow(
                start=hole.x, direction=hole.force, scale=0.22 * size * force / largest,
                shaft_radius=0.018, tip_radius=0.05, tip_length=0.2,
            )  # fmt: skip
            plotter.add_mesh(arrow, color=ARROW)
    if named := [hole for hole in frame.piercings if hole.state != "left"]:
        labels = [label(hole.name, float(np.linalg.norm(hole.force))) for hole in named]
        places = np.array([hole.x for hole in named]) + np.array([0.0, 0.0, 0.03 * size])
        plotter.add_point_labels(
            places, labels, font_size=20, text_color="black", shape_color="white", shape_opacity=0.75,
            show_points=False, always_visible=True, margin=4,
        )  # fmt: skip


def _camera(frame: Snapshot) -> list[tuple[float, float, float]]:
    """Place the camera: from the side and above, on the thread around the piercings."""
    low, high = view_box(frame)
    centre = 0.5 * (low + high)
    centre = centre - np.array([0.0, 0.0, 0.08 * view_width(frame)])
    eye = centre + 1.95 * view_width(frame) * np.array([0.25, -0.85, 0.46])
    return [tuple(map(float, eye)), tuple(map(float, centre)), (0.0, 0.0, 1.0)]  # type: ignore[list-item]


if __name__ == "__main__":
    frame, topology, title = read_scene(sys.argv[1])
    draw_space(frame, topology, Path(sys.argv[2]), title)
