"""A picture of one frame: the deformed organ, the thread and its piercings.

In three dimensions by pyvista where that renders, else a section by matplotlib. Without OpenGL a plotter ends
its process by a segmentation fault, and that the library is there proves nothing; so pictures are drawn in a
child process, and whether one came out is the probe.
"""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from studies.output.files import write_bytes
from studies.output.records import OrganTopology, Snapshot

WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")  # off screen: by the driver, by software
PATIENCE = 120.0  # s for the child, on a busy machine
PACKAGES = "libglu1-mesa libgl1 libegl1 libxrender1 libxcursor1 libxft2 libxinerama1 libgomp1"


def draw_picture(frame: Snapshot, topology: OrganTopology | None, path: Path | str, title: str = "") -> str:
    """Draw a frame into a PNG file; returns one line that says how it was drawn."""
    return draw_scene((frame, topology, title), path, "studies.pictures.space", "studies.pictures.section")


def draw_scene(scene: object, path: Path | str, space: str, section: str) -> str:
    """Draw a scene into a PNG file by the module `space` where OpenGL renders, else by `section`; each is run with the
    pickled scene and the picture to make. Returns one line that says how it was drawn.
    """
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "scene.pickle"
        source.write_bytes(pickle.dumps(scene))
        for window in WINDOWS:
            if _draws(space, source, Path(path), {"VTK_DEFAULT_OPENGL_WINDOW": window}):
                return f"{path}: 3-D picture (pyvista)"
        done = _draws(section, source, Path(path), {"MPLCONFIGDIR": folder})
    how = "section (matplotlib)" if done else "none, for pyvista and matplotlib both failed"
    remedy = f"apt-get install --no-install-recommends {PACKAGES}"
    return f"{path}: {how}; no OpenGL renders here, for the 3-D picture: {remedy}"


def _draws(module: str, source: Path, path: Path, setting: Mapping[str, str]) -> bool:
    """Run a child process; tell whether it drew the picture."""
    root = str(Path(__file__).parents[2])
    search = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
    target = source.with_name("picture.png")
    command = [sys.executable, "-m", module, str(source), str(target)]
    surroundings = os.environ | setting | {"PYTHONPATH": search}
    try:
        done = subprocess.run(command, env=surroundings, capture_output=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        return False
    if done.returncode or not target.is_file():
        return False
    write_bytes(path, target.read_bytes())
    return True
