"""Volume meshes from files.

gmsh reads `.msh` of every version, and meshio reads the other formats. Names come from sets of
cells and from arrays of whole numbers on cells (`meshes.groups`). In gmsh files physical surfaces
become boundaries and physical volumes become subdomains. A group without a name is named by its
number; format 1 has only numbers. Every mesh also has the boundary "surface" with all its boundary
facets, unless a group of the file has this name. meshio could read `.msh` 2 and 4 without gmsh, but
it drops the node numbers and therefore the unused nodes. A file must not give two different meshes.
Therefore gmsh is the only reader of `.msh`, and an error says how to install gmsh.
"""

import io
import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from meshes.child import call_in_child
from meshes.errors import MeshError
from meshes.gmsh_session import current_arrays, session
from meshes.grading import require_positive
from meshes.groups import cells_of, named_groups
from meshes.named import Named, named_mesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

MESHIO = (".vtk", ".vtu", ".inp", ".xdmf", ".med")  # formats that meshio reads
ENDINGS = (".msh", *MESHIO)  # .msh is read by gmsh
LONGEST_REASON = 300  # characters of a reader's message, which can repeat the file
LINEAR_ONLY = "allowed are only linear tetrahedra (in gmsh: Mesh.ElementOrder = 1, no recombination)"


def read(path: str | Path, metres_per_unit: float = 1.0) -> skfem.MeshTet:
    """Return the mesh of a file in metres; `metres_per_unit` is the length of one file unit [m].

    The mesh can have several bodies that share no node. Raises `MeshError` with the name of the
    file if the file is missing, empty, unreadable or not a valid volume mesh
    (`meshes.checks.check`), and for `.msh` if gmsh cannot load.
    """
    path = Path(path)
    try:
        require_positive("metres_per_unit", metres_per_unit)
        _check_present(path)
        mesh = _reader(path)(path, metres_per_unit)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from error
    if "surface" in (mesh.boundaries or {}):
        return mesh
    return mesh.with_boundaries({"surface": mesh.boundary_facets()})


def _check_present(path: Path) -> None:
    if not path.exists():
        raise MeshError("there is no such file")
    if not path.is_file():
        raise MeshError("this is not a file")
    if path.stat().st_size == 0:
        raise MeshError("the file is empty")


def _reader(path: Path) -> Callable[[Path, float], skfem.MeshTet]:
    readers = {".msh": _read_msh} | dict.fromkeys(MESHIO, _read_meshio)
    try:
        return readers[path.suffix.lower()]
    except KeyError:
        raise MeshError(f"its ending {path.suffix!r} is not one of {', '.join(ENDINGS)}") from None


def _read_meshio(path: Path, metres_per_unit: float) -> skfem.MeshTet:
    """Return the tetrahedra of a file, read by meshio, with the file's named groups."""
    data = meshio_data(path)
    _check_kinds(list(data.cells_dict), {"tetra"}, {"vertex", "line", "triangle"})
    points = scaled(data.points, metres_per_unit)
    return named_mesh(points, cells_of(data, "tetra"), *named_groups(data), parts=None)


def meshio_data(path: Path) -> Any:
    """Return a file's data, read by meshio.

    Raises `MeshError` if meshio cannot read the file. In this case meshio prints a message and ends
    the interpreter (meshio 5.3); both are intercepted here.
    """
    import meshio

    said = io.StringIO()
    try:
        # meshio's test for binary STL multiplies text as if it were a count, and numpy warns of the
        # overflow.
        with redirect_stdout(said), redirect_stderr(said), np.errstate(over="ignore"):
            return meshio.read(path)
    except ModuleNotFoundError as error:
        raise MeshError(f"to read it meshio needs {error.name}: `pip install {error.name}`") from error
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{said.getvalue()} {'' if isinstance(error, SystemExit) else error}".split())
        why = reason[:LONGEST_REASON] or type(error).__name__
        raise MeshError(f"meshio cannot read it as a {path.suffix} mesh: {why}") from error


def _check_kinds(kinds: Sequence[str], volume: set[str], allowed: set[str]) -> None:
    """Raise `MeshError` for a file without linear tetrahedra.

    It is also raised for a file with volume elements of another kind.
    """
    others = sorted(set(kinds) - volume - allowed)
    if others:
        raise MeshError(f"it has elements of the kind {', '.join(others)}; {LINEAR_ONLY}")
    if not volume & set(kinds):
        held = f"only {', '.join(sorted(kinds))} elements" if kinds else "no elements"
        raise MeshError(f"it is not a volume mesh, it has {held} and no tetrahedra: mesh the volume")


def _read_msh(path: Path, metres_per_unit: float) -> skfem.MeshTet:
    """Return the mesh of a gmsh file of any version, text or binary.

    The mesh has the physical surfaces and volumes of the file.
    """
    _check_msh_header(path)
    points, tets, surfaces, volumes = call_in_child(msh_arrays, path)
    return named_mesh(scaled(points, metres_per_unit), tets, surfaces, volumes, parts=None)


def msh_arrays(path: Path) -> tuple[Array, Indices, Named, Named]:
    """Return points, tets, triangles of physical surfaces and tets of physical volumes.

    Points have shape `(n, 3)` [file units], and tets `(m, 4)`. The file is read by gmsh. Call this
    function in a separate process, because some files crash gmsh. Raises `MeshError` for an
    unreadable file.
    """
    declared = _old_node_count(path)
    with session() as gmsh:
        try:
            gmsh.open(str(path))
            types = gmsh.model.mesh.getElementTypes()
            kinds = [gmsh.model.mesh.getElementProperties(t)[0] for t in types]
            _check_kinds(kinds, {"Tetrahedron 4"}, {"Point", "Line 2", "Triangle 3"})
            if declared is not None:
                _check_all_nodes_kept(declared, len(gmsh.model.mesh.getNodes()[0]))
                _check_groups_apart(gmsh)
            return current_arrays(gmsh)
        except MeshError:
            raise
        except Exception as error:  # gmsh raises no more specific error
            raise MeshError(f"gmsh cannot read it: {error}") from error


def scaled(points: Array, metres_per_unit: float) -> Array:
    """Return points in metres.

    Too large numbers become infinite. Later checks refuse them.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(points, dtype=float) * metres_per_unit


def _check_msh_header(path: Path) -> None:
    """Raise `MeshError` for a file that does not begin like a gmsh mesh.

    gmsh runs a file of any other kind as a script in its own language, including shell commands.
    """
    with path.open("rb") as file:
        first = file.read(64).lstrip().split(maxsplit=1)[:1]
    if first not in ([b"$NOD"], [b"$MeshFormat"], [b"$Comments"], [b"$PhysicalNames"]):
        raise MeshError("it does not begin like a gmsh mesh, with $NOD or $MeshFormat")


def _old_node_count(path: Path) -> int | None:
    """Return the number of nodes that a file of format 1 or 2 declares; None for later formats.

    gmsh keeps every node of the later formats.
    """
    content = path.read_bytes()
    header = re.search(rb"\$MeshFormat\s+(\d)", content)
    if header and header[1] != b"2":
        return None
    declared = re.search(rb"\$(?:NOD|Nodes)\s+(\d+)", content)
    return int(declared[1]) if declared else None


def _check_all_nodes_kept(declared: int, kept: int) -> None:
    """Raise `MeshError` for a file with nodes that no element uses.

    In formats 1 and 2 gmsh drops these nodes without a message.
    """
    if declared != kept:
        raise MeshError(
            f"{declared - kept} of {declared} nodes belong to no element: delete them, "
            "or find the elements that are missing"
        )


def _check_groups_apart(gmsh: Any) -> None:
    """Raise `MeshError` for two groups in one entity.

    Formats 1 and 2 store groups by element, but gmsh stores them by entity. Two groups in one
    entity would therefore merge without a message.
    """
    for dimension, entity in [*gmsh.model.getEntities(2), *gmsh.model.getEntities(3)]:
        groups = gmsh.model.getPhysicalGroupsForEntity(dimension, entity).tolist()
        if len(groups) > 1:
            raise MeshError(
                f"its elementary entity {entity} of dimension {dimension} lies in the physical groups "
                f"{groups}, which gmsh cannot distinguish: give each group its own elementary number, "
                "or save as format 4.1"
            )
