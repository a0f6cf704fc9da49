"""The picture in three dimensions, by pyvista; in a child process, for a plotter without OpenGL ends it."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

from studies.arrays import Array
from studies.output.fields import OrganTopology
from studies.pictures.camera import Camera, along_arrows, camera_on, label_places, scale_bar
from studies.pictures.scene import Frame
from studies.pictures.view import (
    ARROW,
    INTERVALS,
    KILO,
    LEFT,
    MARKER,
    SIZE,
    Scale,
    aimed_at,
    caption,
    colours,
    label,
    legend,
    places_of,
    read_scene,
    scale_of,
    stress_words,
    surface,
    tension_colours,
    tension_words,
)

BLANK = 2.0  # standard deviation of the pixels' values below which nothing has been drawn
MARGINS = (60.0, 60.0, 170.0, 110.0)  # pixels left, right, below for the bars of colours, above for the title
TITLE, SMALL, NAMES = 14, 10, 10  # sizes of letters, of two pixels each
LETTER = 0.56  # mean width of a letter over its height
BAR = {"color": "black", "vertical": False, "width": 0.29, "height": 0.125, "position_y": 0.04}
BAR |= {"title_font_size": 18, "label_font_size": 16, "n_labels": INTERVALS + 1, "fmt": "%.3g"}


@dataclass(frozen=True)
class Stage:
    """What stays the same in the pictures of a run: the organ's mesh, a title, the scale and the camera."""

    topology: OrganTopology | None
    title: str
    scale: Scale
    camera: Camera


def stage_of(frames: Sequence[Frame], topology: OrganTopology | None, title: str) -> Stage:
    """Return the stage on which what is aimed at and every arrow of all frames are seen."""
    scale = scale_of(frames)
    seen = np.concatenate([part for frame in frames for part in (aimed_at(frame), scale.tips(frame))])
    return Stage(topology, title, scale, camera_on(seen, SIZE, MARGINS))


def draw_space(frame: Frame, topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw a frame into a PNG file."""
    draw_staged(frame, stage_of([frame], topology, title), path)


def draw_staged(frame: Frame, stage: Stage, path: Path) -> None:
    """Draw a frame on a stage into a PNG file. Raises `RuntimeError` where the renderer draws nothing."""
    plotter: Any = pv.Plotter(off_screen=True, window_size=list(SIZE))
    plotter.enable_anti_aliasing("ssaa")
    add_scene(plotter, frame, stage)
    image = np.asarray(plotter.screenshot(str(path), return_img=True))
    plotter.close()
    if image[::4, ::4].std() < BLANK:
        raise RuntimeError("the renderer drew nothing")


def add_scene(plotter: Any, frame: Frame, stage: Stage) -> None:
    """Add a frame to a plotter, with what is written and measured in its picture."""
    plotter.set_background("white")
    place_camera(plotter, stage.camera)
    if stage.topology is not None and frame.organ is not None:
        _add_organ(plotter, stage.topology, frame, stage.scale)
    _add_thread(plotter, frame, stage.scale)
    _add_piercings(plotter, frame, stage.scale)
    _add_names(plotter, frame, stage)
    _add_words(plotter, frame, stage)
    plotter.add_axes(color="black", line_width=3, viewport=(0.0, 0.0, 0.12, 0.18))


def place_camera(plotter: Any, camera: Camera) -> None:
    """Look at a scene without perspective."""
    plotter.enable_parallel_projection()
    eye = camera.focus + 2.0 * camera.half_height * camera.towards
    plotter.camera_position = [tuple(map(float, place)) for place in (eye, camera.focus, camera.up)]
    plotter.camera.parallel_scale = camera.half_height


def _add_organ(plotter: Any, topology: OrganTopology, frame: Frame, scale: Scale) -> None:
    assert frame.organ is not None
    deformed = topology.points + frame.organ.displacement
    mesh: Any = pv.PolyData.from_regular_faces(deformed, surface(topology))
    mesh["von Mises stress [kPa]"] = frame.organ.von_mises / KILO
    mesh = mesh.clean()
    plotter.add_mesh(
        mesh, scalars="von Mises stress [kPa]", cmap=colours(), clim=[value / KILO for value in scale.stress],
        smooth_shading=True, split_sharp_edges=True, feature_angle=50, opacity=0.6, culling="back",
        ambient=0.45, diffuse=0.65, specular=0.1,
        scalar_bar_args=BAR | {"title": f"{stress_words(frame)}\n", "position_x": 0.34},
    )  # fmt: skip
    edges = mesh.extract_feature_edges(feature_angle=50, boundary_edges=False, manifold_edges=False)
    if edges.n_cells:
        plotter.add_mesh(edges, color="#8a6d5c", line_width=2)


def _add_thread(plotter: Any, frame: Frame, scale: Scale) -> None:
    """Add the thread as a tube coloured by its tension, at least as thick as can be seen."""
    radius = max(frame.thread.radius, 0.004 * scale.width)
    bar = BAR | {"title": f"{tension_words(frame)}\n", "position_x": 0.68}
    ends = np.cumsum(frame.thread.pieces[:-1], dtype=np.int64)
    for points, tension in zip(frame.thread.split(), np.split(frame.thread.tension, ends), strict=True):
        line = pv.lines_from_points(points)
        line["tension of the thread [N]"] = tension
        plotter.add_mesh(
            line.tube(radius=radius, n_sides=24), scalars="tension of the thread [N]", cmap=tension_colours(scale),
            clim=scale.tension, smooth_shading=True, ambient=0.35, diffuse=0.65, scalar_bar_args=bar,
        )  # fmt: skip


def _add_piercings(plotter: Any, frame: Frame, scale: Scale) -> None:
    """Add the holes as balls, with the force of the organ's hole on the thread as arrows to one scale."""
    for hole in frame.piercings:
        plotter.add_mesh(pv.Sphere(radius=0.008 * scale.width, center=hole.x), color=MARKER, smooth_shading=True)
        force = float(np.linalg.norm(hole.force))
        if scale.shows(force):
            arrow = pv.Arrow(
                start=hole.x, direction=hole.force, scale=scale.reach * force / scale.force,
                shaft_radius=0.018, tip_radius=0.05, tip_length=0.2,
            )  # fmt: skip
            plotter.add_mesh(arrow, color=ARROW)


def _add_names(plotter: Any, frame: Frame, stage: Stage) -> None:
    """Write what each hole is called and its force, beside what is drawn, with a line to the hole."""
    named = [hole for hole in frame.piercings if hole.state != LEFT]
    if not named:
        return
    words = [label(hole.name, float(np.linalg.norm(hole.force))) for hole in named]
    anchors = stage.camera.pixels(np.array([hole.x for hole in named]))
    boxes = np.array([[LETTER * 2 * NAMES * len(text), 2.4 * NAMES] for text in words])
    for text, anchor, box, corner in zip(
        words, anchors, boxes, label_places(anchors, boxes, taken_pixels(frame, stage), SIZE), strict=True
    ):
        plotter.add_text(text, position=tuple(map(float, corner)), font_size=NAMES, color="black")
        _add_lines(plotter, np.array([anchor, np.clip(anchor, corner, corner + box)]), 1.5)


def taken_pixels(frame: Frame, stage: Stage) -> Array:
    """Return the pixels of thread, holes and arrows `(k, 2)`, which names are not to cover."""
    holes, tips = (stage.camera.pixels(places) for places in (places_of(frame), stage.scale.tips(frame)))
    return np.concatenate([stage.camera.pixels(frame.thread.points), along_arrows(holes, tips)])


def _add_words(plotter: Any, frame: Frame, stage: Stage) -> None:
    """Write the title, what the arrows are, and how long a length is."""
    height = SIZE[1]
    plotter.add_text(caption(frame, stage.title), position=(24.0, height - 48.0), font_size=TITLE, color="black")
    plotter.add_text(legend(stage.scale), position=(24.0, height - 84.0), font_size=SMALL, color="black")
    length, words = scale_bar(stage.camera.scale, 240.0)
    left, right, low = 200.0, 200.0 + stage.camera.scale * length, 60.0
    places = [[left, low + 8], [left, low - 8], [left, low], [right, low], [right, low + 8], [right, low - 8]]
    _add_lines(plotter, np.array(places), 3.0)
    plotter.add_text(words, position=(left, low + 14.0), font_size=SMALL, color="black")


def _add_lines(plotter: Any, places: Array, width: float) -> None:
    """Add a line through pixels `(n, 2)`."""
    from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

    mapper, actor = vtkPolyDataMapper2D(), vtkActor2D()
    mapper.SetInputData(pv.lines_from_points(np.column_stack([places, np.zeros(len(places))])))
    actor.SetMapper(mapper)
    actor.GetProperty().SetColor(0.0, 0.0, 0.0)
    actor.GetProperty().SetLineWidth(width)
    plotter.add_actor(actor)


if __name__ == "__main__":
    frame, topology, title = read_scene(sys.argv[1])
    draw_space(frame, topology, Path(sys.argv[2]), title)
