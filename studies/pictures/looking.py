"""``suture view``: a run in a window, or without a screen as a picture and an animation."""

import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from meshes.child import run_module
from studies.output import reading
from studies.output.columns import STATE_CODES
from studies.output.fields import ThreadRecord
from studies.pictures.picture import draw_scene, words_of
from studies.pictures.scene import FILM, Frame, Hole, Organ

MOST_PICTURES = 24  # largest number of pictures of an animation
LATEST = 1.0 + 1e-6  # of the time of the last frame: times are written with round-off
KINDS = (".png", FILM)
STATES = {code: word for word, code in STATE_CODES.items()}


def view(folder: Path, out: Path | None, time: float | None) -> list[str]:
    """Show a run; return the lines for a person.

    Raises `ResultsError` for a folder without a run or frames, and for a file of another kind.
    """
    run = reading.open_run(folder)
    if not run.frames:
        raise reading.ResultsError(f"{folder} is refused: it has no frames; run the scenario again")
    if out is not None:
        return [drawn_into(run, out, time)]
    reason = window(folder) if has_screen(os.environ, sys.platform) else "no screen"
    if not reason:
        return []
    return [f"window     none: {reason}", *(drawn_into(run, folder / f"view{kind}", time) for kind in KINDS)]


def has_screen(environment: Mapping[str, str], system: str) -> bool:
    """Return whether a window can be opened."""
    return system in ("win32", "darwin") or any(environment.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def window(folder: Path) -> str:
    """Open a window and wait until it is closed; return the reason if this failed.

    An empty text means that a window was opened.
    """
    with tempfile.TemporaryDirectory() as scratch:
        done = run_module("studies.pictures.window", Path(scratch), [folder.resolve()], patience=None)
    return words_of(done) if done.returncode else ""


def drawn_into(run: reading.OpenRun, out: Path, time: float | None) -> str:
    """Draw one frame, or at most `MOST_PICTURES` frames, into a file; return the line on the picture.

    One frame is the nearest to a time, or the last if the time is None.
    """
    if out.suffix.lower() not in KINDS:
        remedy = f"name it {out.stem}.png for a picture, {out.stem}.gif for all frames"
        raise reading.ResultsError(f"--out {out} is refused: {remedy}")
    is_film = out.suffix.lower() == FILM
    spaced = reading.evenly_spaced(len(run.frames), MOST_PICTURES).tolist()
    chosen = [run.frames[number] for number in spaced] if is_film else [nearest(run.frames, time)]
    scene = [read_frame(frame, run.piercings) for frame in chosen], reading.topology_of(chosen[0]), run.title
    line, failure = draw_scene(scene, out, patience=10.0 if is_film else 1.0)
    if failure:
        raise reading.ResultsError(line)
    return line


def nearest(frames: Sequence[reading.FrameFiles], time: float | None) -> reading.FrameFiles:
    """Return the frame nearest to a time [s], or the last frame if the time is None.

    Raises `ResultsError` for a time after the last frame.
    """
    end = frames[-1].time
    if time is not None and not 0.0 <= time <= end * LATEST:
        raise reading.ResultsError(f"--time {time:g} is refused: the run ends at {end:.6g} s; give 0 to {end:.6g}")
    return frames[-1] if time is None else min(frames, key=lambda frame: abs(frame.time - time))


def read_frame(files: reading.FrameFiles, names: Sequence[str]) -> Frame:
    """Return a recorded frame, which has single precision; `names` are its piercings.

    Raises `ResultsError` like `FrameFiles.read`.
    """
    with reading.refused_if_torn(f"the frame at {files.time:g} s"):
        organ = files.read("organ")
        nodes = None if organ is None else reading.arrays_of(organ.point_data)
        moved = None if nodes is None else Organ(nodes["displacement"], nodes["von_mises"])
        return Frame(files.time, read_thread(files), read_holes(files, names), moved)


def read_thread(files: reading.FrameFiles) -> ThreadRecord:
    """Return the recorded thread of a frame."""
    thread = files.read("thread")
    data, lengths = reading.arrays_of(thread.point_data), tuple(cell.n_points for cell in thread.cell)
    return ThreadRecord(
        np.asarray(thread.points, dtype=np.float64), data["s"], data["tension"], data["curvature"],
        float(data["radius"][0]), lengths if len(lengths) > 1 else (), data.get("torque"),
    )  # fmt: skip


def read_holes(files: reading.FrameFiles, names: Sequence[str]) -> tuple[Hole, ...]:
    """Return the recorded piercings of a frame, empty without piercings."""
    holes = files.read("piercings")
    at = {} if holes is None else reading.arrays_of(dict(holes.point_data.items()) | {"x": holes.points})
    return tuple(
        Hole(name, float(at["s"][k]), at["x"][k], at["force"][k], STATES[int(at["state"][k])])
        for k, name in enumerate(names if at else ())
    )
