"""Macro for ParaView 5.11 or newer that draws a run.

It warps the organ by its displacement. It draws the thread as a tube coloured by its tension and
the holes' forces as arrows, and names the holes. In ParaView: Macros > Import new macro, open
results.pvd, select it, start the macro. Or pvpython FILE.py DIR.
"""

import csv
import sys
from pathlib import Path
from typing import Any

from paraview import simple

THICK = 0.003  # radius of the drawn thread over the size of the scene; the real radius would be invisible
LONGEST = 0.16  # length of the longest arrow over the size of the scene


def main() -> None:
    """Draw the selection, or the run in the folder of the first argument."""
    source = simple.GetActiveSource() or simple.PVDReader(FileName=str(Path(sys.argv[1]) / "results.pvd"))
    named = source.FileName
    folder = Path(named if isinstance(named, str) else named[0]).parent
    view = simple.GetActiveViewOrCreate("RenderView")
    simple.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()
    simple.GetAnimationScene().GoToLast()
    simple.Hide(source, view)
    thread = part_of(source, "thread", "tension")
    low_high = thread.GetDataInformation().GetBounds()
    size = max(low_high[2 * axis + 1] - low_high[2 * axis] for axis in range(3))
    draw_organ(part_of(source, "organ", "displacement"), view)
    draw_thread(thread, view, THICK * size)
    holes = part_of(source, "piercings", "force")
    draw_forces(holes, view, LONGEST * size)
    draw_names(holes, view, names_in(folder))
    view.UseColorPaletteForBackground, view.Background = 0, [1.0, 1.0, 1.0]
    view.CameraPosition, view.CameraFocalPoint, view.CameraViewUp = [0.25, -0.85, 0.46], [0.0] * 3, [0.0, 0.0, 1.0]
    view.ResetCamera()
    simple.Render(view)


def part_of(source: Any, name: str, array: str) -> Any:
    """Return a part of the run by its name, None if the run has no part with this array."""
    block = simple.ExtractBlock(registrationName=f"{name} block", Input=source, Selectors=[f"/Root/{name}"])
    part = simple.MergeBlocks(registrationName=name, Input=block)
    simple.UpdatePipeline(time=simple.GetAnimationScene().AnimationTime, proxy=part)
    return part if array in part.PointData.keys() else None  # noqa: SIM118  not a mapping


def draw_organ(organ: Any, view: Any) -> None:
    """Draw the organ warped by its displacement, coloured by stress and half transparent."""
    if organ is None:
        return
    warped = simple.WarpByVector(registrationName="organ warped", Input=organ)
    warped.Vectors = ["POINTS", "displacement"]
    shown = simple.Show(warped, view)
    shown.Opacity = 0.5
    colour(shown, view, "von_mises", "von Mises stress [Pa]")


def draw_thread(thread: Any, view: Any, radius: float) -> None:
    """Draw the thread as a tube coloured by its tension."""
    surface = simple.ExtractSurface(registrationName="thread line", Input=thread)
    tube = simple.Tube(registrationName="thread tube", Input=surface)
    tube.Radius, tube.NumberofSides = radius, 12
    colour(simple.Show(tube, view), view, "tension", "tension of the thread [N]")


def draw_forces(holes: Any, view: Any, length: float) -> None:
    """Draw the forces of the holes on the thread as arrows.

    `length` is the length of the longest arrow.
    """
    if holes is None:
        return
    largest = holes.PointData["force"].GetRange(-1)[1] or 1.0
    arrows = simple.Glyph(registrationName="forces of the holes on the thread", Input=holes, GlyphType="Arrow")
    arrows.OrientationArray, arrows.ScaleArray = ["POINTS", "force"], ["POINTS", "force"]
    arrows.VectorScaleMode, arrows.ScaleFactor = "Scale by Magnitude", length / largest
    arrows.GlyphMode = "All Points"
    shown = simple.Show(arrows, view)
    shown.ColorArrayName = ["POINTS", ""]
    shown.AmbientColor = shown.DiffuseColor = [0.13, 0.13, 0.13]


def draw_names(holes: Any, view: Any, names: list[str]) -> None:
    """Draw the name of each hole at its present place."""
    if holes is None:
        return
    points = simple.servermanager.Fetch(holes)
    for name, number in zip(names, range(points.GetNumberOfPoints()), strict=False):
        text = simple.Text(registrationName=name, Text=name)
        shown = simple.Show(text, view, "TextSourceRepresentation")
        shown.TextPropMode = "Billboard 3D Text"
        shown.BillboardPosition = list(points.GetPoint(number))
        shown.Color, shown.FontSize = [0.1, 0.1, 0.1], 18


def names_in(folder: Path) -> list[str]:
    """Return the names of the holes, in the order of the frames, from the run's table."""
    with (folder / "piercings.csv").open(encoding="utf-8", newline="") as file:
        return list(dict.fromkeys(row["piercing"] for row in csv.DictReader(file)))


def colour(shown: Any, view: Any, array: str, title: str) -> None:
    """Colour a representation by an array, with a labelled bar."""
    simple.ColorBy(shown, ("POINTS", array))
    shown.RescaleTransferFunctionToDataRange(True, False)
    shown.SetScalarBarVisibility(view, True)
    bar = simple.GetScalarBar(simple.GetColorTransferFunction(array), view)
    bar.Title, bar.ComponentTitle, bar.ScalarBarLength = title, "", 0.3
    bar.TitleColor = bar.LabelColor = [0.1, 0.1, 0.1]


if __name__ == "__main__":
    main()
