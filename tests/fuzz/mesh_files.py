"""Mutated mesh files of every kind: each is refused, or read; a surface that is read is filled."""

import re
from pathlib import Path
from random import Random

import meshio
import numpy as np

from meshes.block import block
from meshes.errors import MeshError
from meshes.file import read
from meshes.gmsh_session import load_gmsh, session
from meshes.grading import Grading
from meshes.skin import FORMATS, fill, read_surface
from tests.fuzz.mutations import mutated_bytes
from tests.fuzz.trial import Tally

MADE = re.compile(rb"(comment|#) *Created by .*\n")  # with the time of day, and a seed is to make one file
CUBE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
SIDES = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6],
         [3, 0, 4], [3, 4, 7]]  # fmt: skip


def sources(folder: Path) -> dict[str, bytes]:
    """Return small sound files by name, those of gmsh where it loads."""
    made = block((1, 1, 1), 0.5)
    solid, skin = meshio.Mesh(made.p.T, {"tetra": made.t.T}), meshio.Mesh(CUBE, {"triangle": np.array(SIDES)})
    for name, mesh, more in [
        ("text.vtk", solid, {"binary": False}),
        ("binary.vtk", solid, {"binary": True}),
        ("text.vtu", solid, {"binary": False}),
        ("binary.vtu", solid, {"binary": True}),
        ("text.stl", skin, {"binary": False}),
        ("binary.stl", skin, {"binary": True}),
        ("text.obj", skin, {}),
        ("text.ply", skin, {"binary": False}),
        ("binary.ply", skin, {"binary": True}),
    ]:
        mesh.write(folder / name, **more)
    if has_gmsh():
        for version, binary in [(1.0, 0), (2.2, 0), (2.2, 1), (4.0, 0), (4.1, 0), (4.1, 1)]:
            _write_msh(folder / f"{version}-{binary}.msh", version, binary)
    return {path.name: MADE.sub(b"", path.read_bytes()) for path in sorted(folder.iterdir())}


def has_gmsh() -> bool:
    """Tell whether gmsh loads here."""
    try:
        load_gmsh()
    except MeshError:
        return False
    return True


def _write_msh(path: Path, version: float, binary: int) -> None:
    with session() as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], 1, name="organ")
        gmsh.model.addPhysicalGroup(2, [1], 2, name="bed")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)
        gmsh.model.mesh.generate(3)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path))


def run(count: int, seed: int, folder: Path, kinds: tuple[str, ...] = ("",)) -> Tally:
    """Try so many mutated files, of the kinds whose name ends so."""
    tally, whole = Tally(), folder / "whole"
    whole.mkdir()
    files = {name: data for name, data in sources(whole).items() if name.endswith(kinds)}
    for number in range(seed, seed + count):
        random = Random(number)
        name = random.choice(list(files))
        path = folder / f"mutated{Path(name).suffix}"
        path.write_bytes(mutated_bytes(files[name], random))
        tally.trial(f"mesh {number} ({name})", lambda path=path: _attempt(path), (MeshError, MemoryError))
    return tally


def _attempt(path: Path) -> str:
    if path.suffix not in FORMATS:
        read(path)
        return "read"
    skin = read_surface(path, 1.0)
    span = float(np.ptp(skin.points, axis=0).max())
    if not has_gmsh() or skin.volume < 1e-3 * span**3:
        return "read"
    fill(skin, Grading(span / 2, span / 2))
    return "filled"
