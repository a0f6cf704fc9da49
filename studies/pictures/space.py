"""The picture in three dimensions, by VTK.

It is drawn in a child process, because a renderer without OpenGL ends its process. VTK's modules
are loaded one by one. pyvista is not used, because its loading takes twice the time of drawing.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import vtkmodules.vtkRenderingFreeType  # letters
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  # what draws
from numpy.typing import NDArray
from PIL import Image
from vtkmodules import vtkRenderingCore
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkLookupTable, vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkFiltersCore import vtkCleanPolyData, vtkFeatureEdges, vtkPolyDataNormals, vtkTubeFilter
from vtkmodules.vtkFiltersGeneral import vtkVertexGlyphFilter
from vtkmodules.vtkFiltersSources import vtkArrowSource, vtkSphereSource
from vtkmodules.vtkRenderingAnnotation import vtkAxesActor, vtkScalarBarActor

from studies.arrays import KILO, Array
from studies.output.fields import OrganTopology
from studies.pictures import view
from studies.pictures.camera import Camera, along_arrows, camera_on, label_places, scale_bar
from studies.pictures.scene import Frame
from studies.pictures.view import write_frames

BLANK = 2.0  # standard deviation of the pixel values below which the picture is empty
SAMPLES = 8  # samples per pixel at edges, if available; a larger picture would take a third longer
MARGINS = (60.0, 60.0, 170.0, 110.0)  # pixels left, right, below for the colour bars, above for the title
TITLE, SMALL, NAMES = 28, 20, 20  # pixels of letters
BAR_TITLE, BAR_LABEL = 18, 16  # pixels of letters of a colour bar
LETTER = 0.56  # mean width of a letter over its height
SHARP = 50.0  # degrees between two faces above which their edge is drawn
BLACK = (0.0, 0.0, 0.0)
AXES = ("#ff6347", "#3cb371", "#0000ff")  # of x, y and z
CORNER = (0.0, 0.0, 0.12, 0.18)  # place of the axes in the picture: left, below, right, above
BARS = (0.34, 0.04, 0.97, 0.165)  # place of the colour bars with their titles


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
    return Stage(
        topology, title, scale, camera_on(np.concatenate([part for each in parts for part in each]), view.SIZE, MARGINS)
    )


def draw_space(frames: Sequence[Frame], topology: OrganTopology | None, path: Path, title: str = "") -> None:
    """Draw a frame into a PNG file, or frames on one stage into a GIF file."""
    write_frames(frames, path, partial(draw_staged, stage_of(frames, topology, title)))


def draw_staged(stage: Stage, frame: Frame, path: Path) -> None:
    """Draw a frame on a stage into a PNG file.

    Raises `RuntimeError` if the renderer draws nothing.
    """
    window = make(
        vtkRenderingCore.vtkRenderWindow,
        OffScreenRendering=True,
        Size=view.SIZE,
        MultiSamples=SAMPLES,
        NumberOfLayers=2,
    )
    renderer = make(vtkRenderingCore.vtkRenderer, Background=(1.0, 1.0, 1.0))
    vtkRenderingCore.vtkLightKit().AddLightsToRenderer(renderer)
    for prop in props_of(frame, stage):
        renderer.AddViewProp(prop)
    place_camera(renderer, stage.camera)
    window.AddRenderer(renderer)
    window.AddRenderer(_axes(stage.camera))
    window.Render()
    image = _pixels(window)
    window.Finalize()
    if image[::4, ::4].std() < BLANK:
        raise RuntimeError("the renderer drew nothing")
    Image.fromarray(image).save(path)


def _pixels(window: Any) -> NDArray[np.uint8]:
    """Return the picture in a window, shape `(height, width, 3)`, from the top."""
    width, height = window.GetSize()
    values = vtkUnsignedCharArray()
    window.GetPixelData(0, 0, width - 1, height - 1, 0, values, 0)
    return np.asarray(vtk_to_numpy(values).reshape(height, width, 3)[::-1])


def put(thing: Any, **settings: Any) -> Any:
    """Set properties of an object of VTK, each by its name there, and return it."""
    for name, value in settings.items():
        getattr(thing, f"Set{name}")(value)
    return thing


def make(kind: Callable[[], Any], **settings: Any) -> Any:
    """Make an object of VTK with some properties."""
    return put(kind(), **settings)


def place_camera(renderer: Any, camera: Camera) -> None:
    """Place the camera of a renderer, without perspective."""
    eye, lens = camera.focus + 2.0 * camera.half_height * camera.towards, renderer.GetActiveCamera()
    put(lens, ParallelProjection=True, Position=eye, FocalPoint=camera.focus, ViewUp=camera.up)
    lens.SetParallelScale(camera.half_height)
    renderer.ResetCameraClippingRange()


def _axes(camera: Camera) -> Any:
    """Return the renderer of the directions of x, y and z in a corner, as the camera sees them."""
    axes, renderer = vtkAxesActor(), make(vtkRenderingCore.vtkRenderer, Viewport=CORNER, Layer=1)
    for axis, colour in zip("XYZ", AXES, strict=True):
        for part in ("Shaft", "Tip"):
            put(getattr(axes, f"Get{axis}Axis{part}Property")(), Color=view.rgb(colour), LineWidth=3.0)
        letter = getattr(axes, f"Get{axis}AxisCaptionActor2D")().GetCaptionTextProperty()
        put(letter, Color=BLACK, Shadow=False)
    renderer.AddViewProp(axes)
    lens = put(renderer.GetActiveCamera(), ParallelProjection=True, Position=camera.towards)
    put(lens, FocalPoint=(0.0, 0.0, 0.0), ViewUp=camera.up)
    renderer.ResetCamera()
    return renderer


def props_of(frame: Frame, stage: Stage) -> list[Any]:
    """Return the props of a frame, with the texts and scales of its picture."""
    organ = [] if stage.topology is None else _organ(stage.topology, frame, stage.scale)
    return [*organ, *_thread(frame, stage.scale), *_piercings(frame, stage.scale), *_held(frame), *_names(frame, stage),
            *_words(frame, stage)]  # fmt: skip


def _organ(topology: OrganTopology, frame: Frame, scale: view.Scale) -> list[Any]:
    """Return the organ's surface coloured by its stress, its edges, and the colour bar."""
    if frame.organ is None:
        return []
    points = _points(topology.points + frame.organ.displacement)
    skin = make(vtkPolyData, Points=points, Polys=_cells(view.surface(topology)))
    skin.GetPointData().SetScalars(_array(frame.organ.von_mises / KILO))
    clean = make(vtkCleanPolyData, InputData=skin)
    smooth = make(vtkPolyDataNormals, InputConnection=clean.GetOutputPort(), FeatureAngle=SHARP, Splitting=True)
    table = _table(view.colours(), [value / KILO for value in scale.stress])
    actor = _coloured(smooth, table, ambient=0.45)
    put(actor.GetProperty(), Opacity=0.6, BackfaceCulling=True, Specular=0.1)
    edges = make(vtkFeatureEdges, InputConnection=clean.GetOutputPort(), FeatureAngle=SHARP)
    put(edges, BoundaryEdges=False, Coloring=False)
    return [actor, _plain(edges, "#8a6d5c", line_width=1.5), _bar(table, view.stress_words(frame), 0.34)]


def _thread(frame: Frame, scale: view.Scale) -> list[Any]:
    """Return the thread as a tube coloured by its tension, and the colour bar.

    The tube has a visible thickness.
    """
    table, thread = _table(view.tension_colours(scale), scale.tension), frame.thread
    pieces = zip(thread.split(thread.points), thread.split(thread.tension), strict=True)
    tubes = [_tube(points, tension, max(thread.radius, 0.004 * scale.width)) for points, tension in pieces]
    return [*(_coloured(tube, table, ambient=0.35) for tube in tubes), _bar(table, view.tension_words(frame), 0.68)]


def _tube(points: Array, values: Array, radius: float) -> Any:
    """Return the source of a tube along points `(k, 3)` [m] with their values `(k,)`."""
    line = _line(points)
    line.GetPointData().SetScalars(_array(values))
    return make(vtkTubeFilter, InputData=line, Radius=radius, NumberOfSides=24, Capping=True)


def _piercings(frame: Frame, scale: view.Scale) -> list[Any]:
    """Return the holes as balls, with the forces of the holes on the thread as arrows to one scale.

    Footprints are transparent balls.
    """
    props = []
    for hole in frame.piercings:
        props.append(_plain(_ball(hole.x, 0.008 * scale.width), view.MARKER))
        if hole.footprint:
            props.append(_plain(_ball(hole.x, hole.footprint), view.MARKER))
            props[-1].GetProperty().SetOpacity(0.35)
        force = float(np.linalg.norm(hole.force))
        if scale.shows(force):
            props.append(_arrow(hole.x, scale.reach / scale.force * hole.force))
    return props


def _ball(place: Array, radius: float) -> Any:
    """Return the source of a ball around a place (3,) [m]."""
    return make(vtkSphereSource, Radius=radius, Center=place, ThetaResolution=30, PhiResolution=30)


def _held(frame: Frame) -> list[Any]:
    """Return the held nodes as dots."""
    if frame.held is None:
        return []
    places = make(vtkPolyData, Points=_points(frame.held))
    actor = _plain(make(vtkVertexGlyphFilter, InputData=places), view.THREAD)
    put(actor.GetProperty(), PointSize=7.0, RenderPointsAsSpheres=True)
    return [actor]


def _arrow(start: Array, way: Array) -> Any:
    """Return an arrow from the place `start` along `way`, `(3,)` each [m]."""
    source = make(vtkArrowSource, ShaftRadius=0.018, TipRadius=0.05, TipLength=0.2)
    put(source, ShaftResolution=20, TipResolution=20)
    placed = np.eye(4)
    length = float(np.linalg.norm(way))
    across = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
    across *= length / np.linalg.norm(across)
    placed[:3] = np.column_stack([way, across, np.cross(way, across) / length, start])
    actor, matrix = _plain(source, view.ARROW), vtkMatrix4x4()
    matrix.DeepCopy(placed.ravel().tolist())
    actor.SetUserMatrix(matrix)
    return actor


def _names(frame: Frame, stage: Stage) -> list[Any]:
    """Return the name and force of each hole next to the scene, with a line to the hole."""
    named = [hole for hole in frame.piercings if hole.state != view.LEFT]
    if not named:
        return []
    words = [view.label(hole.name, float(np.linalg.norm(hole.force))) for hole in named]
    anchors = stage.camera.pixels(np.array([hole.x for hole in named]))
    boxes = np.array([[LETTER * NAMES * len(text), 1.2 * NAMES] for text in words])
    corners = label_places(anchors, boxes, taken_pixels(frame, stage), view.SIZE)
    nearest = np.clip(anchors, corners, corners + boxes)
    lines = [_pixel_line(np.array(ends), 1.0) for ends in zip(anchors, nearest, strict=True)]
    return [*(_text(text, corner, NAMES) for text, corner in zip(words, corners, strict=True)), *lines]


def taken_pixels(frame: Frame, stage: Stage) -> Array:
    """Return the pixels of thread, holes, arrows and colour bars, shape `(k, 2)`.

    Names should not cover them.
    """
    holes, tips = (stage.camera.pixels(places) for places in (view.places_of(frame), stage.scale.tips(frame)))
    left, below, right, above = np.array(BARS) * (*view.SIZE, *view.SIZE)
    bars = np.stack(np.meshgrid(np.arange(left, right, NAMES), np.arange(below, above, NAMES)), axis=-1).reshape(-1, 2)
    return np.concatenate([stage.camera.pixels(frame.thread.points), along_arrows(holes, tips), bars])


def _words(frame: Frame, stage: Stage) -> list[Any]:
    """Return the title, the legend of the arrows, and the scale bar."""
    height = view.SIZE[1]
    length, words = scale_bar(stage.camera.scale, 240.0)
    left, right, low = 200.0, 200.0 + stage.camera.scale * length, 60.0
    places = [[left, low + 8], [left, low - 8], [left, low], [right, low], [right, low + 8], [right, low - 8]]
    return [
        _text(view.caption(frame, stage.title), (24.0, height - 48.0), TITLE),
        _text(view.legend(stage.scale, frame), (24.0, height - 84.0), SMALL),
        _pixel_line(np.array(places), 2.0),
        _text(words, (left, low + 14.0), SMALL),
    ]


def _coloured(source: Any, table: Any, ambient: float) -> Any:
    """Return the actor of a source, coloured by its values."""
    actor, mapper = _actor(source)
    put(mapper, LookupTable=table, UseLookupTableScalarRange=True, InterpolateScalarsBeforeMapping=True)
    actor.GetProperty().SetInterpolationToPhong()
    put(actor.GetProperty(), Ambient=ambient, Diffuse=0.65)
    return actor


def _plain(source: Any, colour: str, line_width: float = 1.0) -> Any:
    """Return the actor of a source in one colour."""
    actor, mapper = _actor(source)
    mapper.ScalarVisibilityOff()
    put(actor.GetProperty(), Color=view.rgb(colour), LineWidth=line_width)
    return actor


def _actor(source: Any) -> tuple[Any, Any]:
    mapper = make(vtkRenderingCore.vtkPolyDataMapper, InputConnection=source.GetOutputPort())
    return make(vtkRenderingCore.vtkActor, Mapper=mapper), mapper


def _bar(table: Any, title: str, left: float) -> Any:
    """Return a colour bar under its title.

    `left` is its left end as a share of the picture's width.
    """
    bar = make(vtkScalarBarActor, LookupTable=table, MaximumNumberOfColors=table.GetNumberOfTableValues())
    bar.SetOrientationToHorizontal()
    put(bar, Position=(left, BARS[1]), Width=0.29, Height=BARS[3] - BARS[1], Title=f"{title}\n")
    put(bar, CustomLabels=_array(view.ticks(*table.GetRange())), UseCustomLabels=True, LabelFormat="%.3g")
    bar.UnconstrainedFontSizeOn()
    _write_in_black(bar.GetTitleTextProperty(), BAR_TITLE)
    _write_in_black(bar.GetLabelTextProperty(), BAR_LABEL)
    bar.GetLabelTextProperty().SetJustificationToCentered()  # VTK also sets this, but only after the first drawing
    return bar


def _text(words: str, corner: Iterable[float], size: int) -> Any:
    """Return a text with its lower left corner at a pixel."""
    text = make(vtkRenderingCore.vtkTextActor, Input=words, Position=tuple(corner))
    _write_in_black(text.GetTextProperty(), size)
    return text


def _write_in_black(letters: Any, size: int) -> None:
    letters.SetFontFamilyToArial()
    put(letters, FontSize=size, Color=BLACK, Bold=False, Italic=False, Shadow=False)


def _pixel_line(places: Array, width: float) -> Any:
    """Return a line through pixels `(n, 2)`."""
    line = _line(np.column_stack([places, np.zeros(len(places))]))
    actor = make(vtkRenderingCore.vtkActor2D, Mapper=make(vtkRenderingCore.vtkPolyDataMapper2D, InputData=line))
    put(actor.GetProperty(), Color=BLACK, LineWidth=width)
    return actor


def _line(points: Array) -> Any:
    """Return a line through points `(n, 3)`."""
    return make(vtkPolyData, Points=_points(points), Lines=_cells(np.arange(len(points))[None]))


def _points(places: Array) -> Any:
    return make(vtkPoints, Data=_array(places))


def _cells(corners: view.Indices) -> Any:
    cells = vtkCellArray()
    cells.SetData(corners.shape[1], numpy_to_vtkIdTypeArray(corners.ravel().astype(np.int64), deep=True))
    return cells


def _array(values: Array) -> Any:
    return numpy_to_vtk(np.ascontiguousarray(values, dtype=np.float64), deep=True)


def _table(shades: Array, ends: Sequence[float]) -> Any:
    """Return the colour table `(n, 3)` between two values."""
    whole = np.rint(255.0 * np.column_stack([shades, np.ones(len(shades))])).astype(np.uint8)
    return make(vtkLookupTable, Table=numpy_to_vtk(whole, deep=True), Range=tuple(ends))


if __name__ == "__main__":
    frames, topology, title = view.read_scene(sys.argv[1])
    draw_space(frames, topology, Path(sys.argv[2]), title)
