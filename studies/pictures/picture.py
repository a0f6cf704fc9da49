"""A picture of a mesh, or of one frame: the deformed organ, the thread and its piercings.

It is three-dimensional by VTK if OpenGL works, else a section by matplotlib. Without OpenGL a
renderer can end its process by a segmentation fault, even if its library is installed. So each
picture is drawn in a child process, and its result is the test of OpenGL.
"""

import pickle
import re
import subprocess
import tempfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from meshes.child import last_words, run_module
from studies.extras import SYSTEM_LIBRARIES, installation
from studies.output.files import write_bytes
from studies.pictures.scene import FILM

WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")  # off screen: by the driver, by software
PATIENCE = 120.0  # s for the child, on a busy machine
Modules = tuple[str, str]  # that draw in space and in a section
MODULES = "studies.pictures.space", "studies.pictures.section"
VTK_PLACE = re.compile(r"^.*\b(?:WARN|ERR)\| ", re.MULTILINE)  # time and place at the start of a message


def draw_scene(scene: object, path: Path | str, by: Modules = MODULES, patience: float = 1.0) -> tuple[str, str]:
    """Draw a scene into a file by the first of two modules if OpenGL works, else by the second.

    Returns the line for a person, and the reason of a failure, empty if the picture was drawn.
    Each module runs with the pickled scene and the path of the picture. Its time limit is
    `patience` times the limit of one picture.
    """
    space, section = by
    causes = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "scene.pickle"
        source.write_bytes(pickle.dumps(scene))
        for window in WINDOWS if is_installed("pyvista") else ():
            # drawing is the test of OpenGL: pyvista's own test for a mesh opens one more window
            setting = {"VTK_DEFAULT_OPENGL_WINDOW": window, "ALLOW_PLOTTING": "true"}
            causes.append(draw_apart(space, source, Path(path), setting, patience))
            if not causes[-1]:
                return f"{path}: 3-D picture (VTK)", ""
        flat = "matplotlib is not installed"
        if is_installed("matplotlib"):
            flat = draw_apart(section, source, Path(path), {"MPLCONFIGDIR": folder}, patience)
    no_space = f"OpenGL does not work here ({causes[-1]})" if causes else "pyvista is not installed"
    install = f"apt-get install --no-install-recommends {SYSTEM_LIBRARIES}"
    remedy = install if causes else installation("pyvista")
    if not flat:
        return f"{path}: section (matplotlib); {no_space}, for the 3-D picture: {remedy}", ""
    failure = f"{no_space}; {flat}; {remedy}"
    return f"{path}: none, {failure}", failure


def is_installed(library: str) -> bool:
    """Return whether a library is installed, without importing it."""
    return find_spec(library) is not None


def draw_apart(module: str, source: Path, path: Path, setting: Mapping[str, str], patience: float = 1.0) -> str:
    """Draw by a module in a child process; return the child's reason for no picture.

    An empty text means that the picture was drawn.
    """
    target = source.with_name("film.gif" if path.suffix.lower() == FILM else "picture.png")
    target.unlink(missing_ok=True)
    try:
        done = run_module(module, source.parent, [source, target], patience * PATIENCE, setting)
        if not done.returncode and target.is_file():
            write_bytes(path, target.read_bytes())
            return ""
    except subprocess.TimeoutExpired:
        return f"it took more than {patience * PATIENCE:g} s"
    except OSError as error:
        return str(error)
    return words_of(done)


def words_of(done: "subprocess.CompletedProcess[bytes]") -> str:
    """Return the last message of a child process, without VTK's time and place."""
    return last_words(done.returncode, VTK_PLACE.sub("", done.stderr.decode(errors="replace")))
