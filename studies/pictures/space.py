"""The picture of a frame or a mesh in three dimensions, by pyvista.

It is drawn in a child process, because a renderer without OpenGL ends its process.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkPolyDataMapper2D

from studies.arrays import KILO, Array
from studies.output.fields import OrganTopology
from studies.pictures import view
from studies.pictures.camera import Camera, along_arrows, camera_on, label_places, scale_bar
from studies.pictures.scene import Frame, MeshScene
from studies.pictures.view import write_frames

BLANK = 2.0  # standard deviation of the pixel values below which the picture is empty
SAMPLES = 8  # samples per pixel at edges, if available; a larger picture would take a third longer
MARGINS = (60.0, 60.0, 170.0, 110.0)  # pixels left, right, below for the colour bars, above for the title
TITLE, SMALL, NAMES = 28, 20, 20  # pixels of letters
BAR_TITLE, BAR_LABEL = 18, 16  # pixels of letters of a colour bar
LETTER = 0.56  # mean width of a letter over its height
SHARP = 50.0  # degrees between two faces above which their edge is drawn
ARROW = {"tip_length": 0.2, "tip_radius": 0.05, "shaft_radius": 0.018}  # over the length of the arrow
CORNER = (0.0, 0.0, 0.12, 0.18)  # place of the axes in the picture: left, below, right, above
BARS = (0.34, 0.04, 0.97, 0.165)  # place of the colour bars with their titles
REGIONS = ("#f0d9c8", "#dc7356", "#8fb7c9", "#c9b458", "#8ea66f", "#9d7fb0")  # the first: no region


@dataclass(frozen=True)
class Stage:
    """The constant parts of a run's pictures.

    They are the organ's mesh, a title, the scale and the camera.
    """

    topology: OrganTopology | None
    title: str
    scale: view.Scale
    camera: Camera


def stage_of(frames: Sequence[Frame], topology: OrganTopology | None, title: str) -> Stage:
    """Return the stage that shows the selected points, every arrow and the organ of all frames."""
    scale = view.scale_of(frames)
    parts = [(view.aimed_at(frame), scale.tips(frame), view.shown_organ(frame, topology, scale)) for frame in frames]
    points = np.concatenate([part for each in parts for part in each])
    return Stage(topology, title, scale, camera_on(points, view.SIZE, MARGINS))


def draw_space(frames: Sequence[Frame], topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw a frame into a PNG file, or frames on one stage into a GIF file."""
    write_frames(frames, path, partial(draw_staged, stage_of(frames, topology, title)))


def draw_staged(stage: Stage, frame: Frame, path: Path) -> None:
    """Draw a frame on a stage into a PNG file."""
    plotter: Any = pv.Plotter(off_screen=True, window_size=list(view.SIZE), lighting="light kit")
    prepare(plotter, stage)
    plotter.enable_anti_aliasing("msaa", multi_samples=SAMPLES)
    add_frame(plotter, frame, stage)
    plotter.reset_camera_clipping_range()
    write_picture(plotter, path)


def write_picture(plotter: Any, path: Path) -> None:
    """Write the picture of a plotter into a PNG file, and close the plotter.

    Raises `RuntimeError` if the renderer draws nothing.
    """
    image = np.asarray(plotter.screenshot(str(path), return_img=True))
    plotter.close()
    if image[::4, ::4].std() < BLANK:
        raise RuntimeError("the renderer drew nothing")


def prepare(plotter: Any, stage: Stage) -> None:
    """Give a plotter the camera of a stage, without perspective, and the directions of x, y and z in a corner."""
    camera = stage.camera
    plotter.set_background("white")
    plotter.add_axes(color="black", line_width=3, viewport=CORNER)
    plotter.camera.position = camera.focus + 2.0 * camera.half_height * camera.towards
    plotter.camera.focal_point, plotter.camera.up = camera.focus, camera.up
    plotter.camera.parallel_projection, plotter.camera.parallel_scale = True, camera.half_height
    plotter.renderer.camera_set = True  # otherwise pyvista moves the camera


def add_frame(plotter: Any, frame: Frame, stage: Stage) -> None:
    """Add the parts of a frame, with the texts and scales of its picture."""
    if stage.topology is not None and frame.organ is not None:
        _add_organ(plotter, stage.topology.points + frame.organ.displacement, frame, stage)
    _add_thread(plotter, frame, stage.scale)
    _add_piercings(plotter, frame, stage.scale)
    _add_names(plotter, frame, stage)
    _add_words(plotter, frame, stage)


def _add_organ(plotter: Any, points: Array, frame: Frame, stage: Stage) -> None:
    """Add the organ's surface coloured by its stress, its edges, and the colour bar."""
    assert stage.topology is not None and frame.organ is not None
    skin = pv.PolyData.from_regular_faces(points, view.surface(stage.topology))
    skin["stress"] = frame.organ.von_mises / KILO
    skin = skin.clean()
    table = _table(view.colours(), [value / KILO for value in stage.scale.stress])
    looks = {"opacity": 0.6, "culling": "back", "split_sharp_edges": True, "feature_angle": SHARP, "specular": 0.1}
    _add_coloured(plotter, skin, table, view.stress_words(frame), 0.34, ambient=0.45, **looks)
    edges = skin.extract_feature_edges(SHARP, boundary_edges=False, manifold_edges=False)
    if edges.n_points:  # a smooth organ has none, and pyvista refuses an empty mesh
        plotter.add_mesh(edges, color="#8a6d5c", line_width=1.5)


def _add_thread(plotter: Any, frame: Frame, scale: view.Scale) -> None:
    """Add the thread as a tube coloured by its tension, and the colour bar.

    The tube has a visible thickness.
    """
    table, thread = _table(view.tension_colours(scale), scale.tension), frame.thread
    tubes = pv.PolyData()
    for points, tension in zip(thread.split(thread.points), thread.split(thread.tension), strict=True):
        line = pv.lines_from_points(points)
        line["tension"] = tension
        tubes = tubes.append_polydata(line.tube(radius=max(thread.radius, 0.004 * scale.width), n_sides=24))
    _add_coloured(plotter, tubes, table, view.tension_words(frame), 0.68, ambient=0.35)


def _add_coloured(plotter: Any, mesh: Any, table: Any, title: str, left: float, **looks: Any) -> None:
    """Add a mesh coloured by its values, and a colour bar under its title.

    `left` is the left end of the bar as a share of the picture's width.
    """
    actor = plotter.add_mesh(mesh, cmap=table, smooth_shading=True, diffuse=0.65, show_scalar_bar=False, **looks)
    bar = plotter.add_scalar_bar(
        f"{title}\n", mapper=actor.mapper, n_colors=table.n_values, vertical=False, color="black", fmt="%.3g",
        position_x=left, position_y=BARS[1], width=0.29, height=BARS[3] - BARS[1], font_family="arial",
        title_font_size=BAR_TITLE, label_font_size=BAR_LABEL, unconstrained_font_size=True,
    )  # fmt: skip
    bar.SetCustomLabels(pv.convert_array(view.ticks(*table.scalar_range)))
    bar.UseCustomLabelsOn()
    bar.GetLabelTextProperty().SetJustificationToCentered()  # VTK also sets this, but only after the first drawing


def _add_piercings(plotter: Any, frame: Frame, scale: view.Scale) -> None:
    """Add the holes as balls, with the forces of the holes on the thread as arrows to one scale.

    Footprints are transparent balls, and held nodes dots.
    """
    for hole in frame.piercings:
        for radius, opacity in ((0.008 * scale.width, 1.0), (hole.footprint, 0.35)):
            if radius:
                plotter.add_mesh(pv.Sphere(radius=radius, center=hole.x), color=view.MARKER, opacity=opacity)
        force = float(np.linalg.norm(hole.force))
        if scale.shows(force):
            length = scale.reach / scale.force * force
            arrow = pv.Arrow(start=hole.x, direction=hole.force, scale=length, **ARROW)
            plotter.add_mesh(arrow, color=view.ARROW)
    if frame.held is not None and len(frame.held):
        plotter.add_points(frame.held, color=view.THREAD, point_size=7.0, render_points_as_spheres=True)


def _add_names(plotter: Any, frame: Frame, stage: Stage) -> None:
    """Add the name and force of each hole next to the scene, with a line to the hole."""
    named = [hole for hole in frame.piercings if hole.state != view.LEFT]
    if not named:
        return
    words = [view.label(hole.name, float(np.linalg.norm(hole.force))) for hole in named]
    anchors = stage.camera.pixels(np.array([hole.x for hole in named]))
    boxes = np.array([[LETTER * NAMES * len(text), 1.2 * NAMES] for text in words])
    corners = label_places(anchors, boxes, taken_pixels(frame, stage), view.SIZE)
    for text, corner, *ends in zip(words, corners, anchors, np.clip(anchors, corners, corners + boxes), strict=True):
        _add_text(plotter, text, corner, NAMES)
        _add_pixel_line(plotter, np.array(ends), 1.0)


def taken_pixels(frame: Frame, stage: Stage) -> Array:
    """Return the pixels of thread, holes, arrows and colour bars, shape `(k, 2)`.

    Names should not cover them.
    """
    holes, tips = (stage.camera.pixels(places) for places in (view.places_of(frame), stage.scale.tips(frame)))
    left, below, right, above = np.array(BARS) * (*view.SIZE, *view.SIZE)
    bars = np.stack(np.meshgrid(np.arange(left, right, NAMES), np.arange(below, above, NAMES)), axis=-1).reshape(-1, 2)
    return np.concatenate([stage.camera.pixels(frame.thread.points), along_arrows(holes, tips), bars])


def _add_words(plotter: Any, frame: Frame, stage: Stage) -> None:
    """Add the title, the legend of the arrows, and the scale bar."""
    height = view.SIZE[1]
    length, words = scale_bar(stage.camera.scale, 240.0)
    left, right, low = 200.0, 200.0 + stage.camera.scale * length, 60.0
    places = [[left, low + 8], [left, low - 8], [left, low], [right, low], [right, low + 8], [right, low - 8]]
    _add_text(plotter, view.caption(frame, stage.title), (24.0, height - 48.0), TITLE)
    _add_text(plotter, view.legend(stage.scale, frame), (24.0, height - 84.0), SMALL)
    _add_pixel_line(plotter, np.array(places), 2.0)
    _add_text(plotter, words, (left, low + 14.0), SMALL)


def _add_text(plotter: Any, words: str, corner: Iterable[float], size: int) -> None:
    """Add a text with its lower left corner at a pixel."""
    half = size // 2  # pyvista doubles the size
    plotter.add_text(words, position=tuple(corner), font_size=half, color="black", font="arial")


def _add_pixel_line(plotter: Any, places: Array, width: float) -> None:
    """Add a line through pixels `(n, 2)`."""
    line, mapper = vtkActor2D(), vtkPolyDataMapper2D()
    mapper.SetInputData(pv.lines_from_points(np.column_stack([places, np.zeros(len(places))])))
    line.SetMapper(mapper)
    line.GetProperty().SetColor(0.0, 0.0, 0.0)
    line.GetProperty().SetLineWidth(width)
    plotter.add_actor(line, pickable=False)


def _table(shades: Array, ends: Sequence[float]) -> Any:
    """Return the colour table `(n, 3)` between two values."""
    whole = np.rint(255.0 * np.column_stack([shades, np.ones(len(shades))])).astype(np.uint8)
    return pv.LookupTable(values=whole, scalar_range=tuple(ends))


# --- a mesh -----------------------------------------------------------------------------------------------


def draw_mesh(scene: MeshScene, path: Path) -> None:
    """Draw the surface into a PNG file, next to a cut.

    The cut shows the cells behind a plane through the piercings.
    """
    plotter: Any = pv.Plotter(off_screen=True, window_size=list(view.SIZE), shape=(1, 2), border=False)
    plotter.set_background("white")
    grid = pv.UnstructuredGrid({pv.CellType.TETRA: np.asarray(scene.cells)}, scene.points)
    grid.cell_data["region"] = scene.region
    centre = scene.sites.mean(axis=0) if len(scene.sites) else scene.points.mean(axis=0)
    hair = 1e-4 * float(np.ptp(scene.points[:, 1]))
    beyond = grid.clip(normal="-y", origin=centre + np.array([0.0, hair, 0.0]), crinkle=True)
    for column, part in enumerate((grid, beyond)):
        plotter.subplot(0, column)
        _add_mesh_cells(plotter, part)
        _add_mesh_marks(plotter, scene)
        plotter.view_vector((0.45, -0.8, 0.75) if column == 0 else (0.15, -0.9, 0.45), viewup=(0.0, 0.0, 1.0))
        plotter.enable_anti_aliasing("ssaa")
    plotter.subplot(0, 0)
    plotter.add_text(scene.title or "mesh", position="upper_left", font_size=14, color="black")
    write_picture(plotter, path)


def _add_mesh_cells(plotter: Any, part: Any) -> None:
    """Add the surface of a part, coloured by region."""
    skin = part.extract_surface(algorithm="dataset_surface")
    number = np.asarray(skin.cell_data["region"]) % len(REGIONS)
    skin.cell_data["colour"] = np.array([pv.Color(colour).int_rgb for colour in REGIONS], dtype=np.uint8)[number]
    edges = {"show_edges": True, "edge_color": "#55453c", "line_width": 1}
    plotter.add_mesh(skin, scalars="colour", rgb=True, ambient=0.35, diffuse=0.6, **edges)


def _add_mesh_marks(plotter: Any, scene: MeshScene) -> None:
    """Add the wound's edge and the piercings."""
    if len(scene.lips):
        lips = pv.PolyData.from_regular_faces(scene.points, scene.lips)
        others = dict.fromkeys(("feature_edges", "manifold_edges", "non_manifold_edges"), False)
        rim = lips.extract_feature_edges(boundary_edges=True, **others)
        plotter.add_mesh(rim, color=view.THREAD, line_width=5)
    size = float(np.linalg.norm(np.ptp(scene.points, axis=0)))
    for site in scene.sites:
        plotter.add_mesh(pv.Sphere(radius=0.008 * size, center=site), color=view.MARKER)


if __name__ == "__main__":
    view.draw_given(draw_space, draw_mesh)
