"""A window in which a run can be turned and played, by pyvista.

It runs in a process that can end without OpenGL.
"""

import os
import sys
from typing import Any

import pyvista as pv

from studies.output.reading import open_run, topology_of
from studies.pictures.looking import read_frame
from studies.pictures.picture import WINDOWS
from studies.pictures.space import add_frame, prepare, stage_of
from studies.pictures.view import SIZE


def show(folder: str) -> None:
    """Show the frames of a run, with a slider for the time."""
    run = open_run(folder)
    topology = topology_of(run.frames[0])
    last = read_frame(run.frames[-1], run.piercings)
    stage = stage_of([read_frame(run.frames[0], run.piercings), last], topology, run.title)
    plotter: Any = pv.Plotter(window_size=list(SIZE), title=f"suture view {run.name}")
    if plotter.render_window.GetClassName() in WINDOWS:
        display = os.environ.get("DISPLAY", "")
        sys.exit(f"VTK cannot open a window on the display {display!r}; correct DISPLAY, or give --out")
    prepare(plotter, stage)
    shown: list[str] = []

    def choose(number: float) -> None:
        """Show a frame instead of the frame before."""
        plotter.remove_actor(shown)
        plotter.scalar_bars.clear()
        others = set(plotter.actors)
        add_frame(plotter, read_frame(run.frames[round(number)], run.piercings), stage)
        shown[:] = set(plotter.actors) - others

    plotter.add_slider_widget(
        choose, [0, len(run.frames) - 1], value=len(run.frames) - 1, title="frame", fmt="%.0f", color="black",
        pointa=(0.62, 0.93), pointb=(0.95, 0.93),
    )  # fmt: skip
    plotter.show()


if __name__ == "__main__":
    show(sys.argv[1])
