"""Volume meshes from files: gmsh `.msh` of every version through gmsh, the other formats through meshio.

Names: sets of cells and arrays of whole numbers on cells (`meshes.groups`). Of gmsh physical surfaces become boundaries
and physical volumes subdomains (a group without a name goes by its number; format 1 has numbers only). Every mesh also
has the boundary "surface", all its boundary facets, unless a group of the file bears that name. meshio could read
`.msh` 2 and 4 without gmsh, but it drops the node numbers and with them the unused nodes; rather than two answers for
one file there is one reader and an error that says what to install.
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
FORMATS = f".msh (gmsh), {', '.join(MESHIO)}"
LONGEST_REASON = 300  # characters of what a reader says, which may repeat the file
LINEAR_ONLY = "only linear tetrahedra are taken (in gmsh: Mesh.ElementOrder = 1, no recombination)"


def read(path: str | Path, metres_per_unit: float = 1.0) -> skfem.MeshTet:
    """Read the mesh of a file into metres, `metres_per_unit` being the length of one file unit [m].

    It may hold several bodies, which share no node. Raises `MeshError`, with the file named, for a file that is
    missing, empty, unreadable or no sound volume mesh (`meshes.checks.check`), and for `.msh` where gmsh cannot load.
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
        raise MeshError("this is no file")
    if path.stat().st_size == 0:
        raise MeshError("the file is empty")


def _reader(path: Path) -> Callable[[Path, float], skfem.MeshTet]:
    readers = {".msh": _read_msh} | dict.fromkeys(MESHIO, _read_meshio)
    try:
        return readers[path.suffix.lower()]
    except KeyError:
        raise MeshError(f"its ending {path.suffix!r} is none of the formats {FORMATS}") from None


def _read_meshio(path: Path, metres_per_unit: float) -> skfem.MeshTet:
    """Read the tetrahedra of a file by meshio, with the groups that it names."""
    data = meshio_data(path)
    _check_kinds(list(data.cells_dict), {"tetra"}, {"vertex", "line", "triangle"})
    points = scaled(data.points, metres_per_unit)
    return named_mesh(points, cells_of(data, "tetra"), *named_groups(data), parts=None)


def meshio_data(path: Path) -> Any:
    """Read a file by meshio; raise `MeshError` where meshio cannot.

    On a file it cannot read, meshio prints and ends the interpreter (meshio 5.3): both are contained here.
    """
    import meshio

    said = io.StringIO()
    try:
        # Its test for binary STL multiplies text as if it were a count: numpy warns of the overflow.
        with redirect_stdout(said), redirect_stderr(said), np.errstate(over="ignore"):
            return meshio.read(path)
    except ModuleNotFoundError as error:
        raise MeshError(f"to read it meshio needs {error.name}: `pip install {error.name}`") from error
    except (Exception, SystemExit) as error:
        reason = " ".join(f"{said.getvalue()} {'' if isinstance(error, SystemExit) else error}".split())
        why = reason[:LONGEST_REASON] or type(error).__name__
        raise MeshError(f"meshio cannot read it as a {path.suffix} mesh: {why}") from error


def _check_kinds(kinds: Sequence[str], volume: set[str], allowed: set[str]) -> None:
    """Refuse a file without linear tetrahedra, or with volume elements of another kind."""
    others = sorted(set(kinds) - volume - allowed)
    if others:
        raise MeshError(f"it holds elements of the kind {', '.join(others)}; {LINEAR_ONLY}")
    if not volume & set(kinds):
        held = f"only {', '.join(sorted(kinds))} elements" if kinds else "no elements"
        raise MeshError(f"it is not a volume mesh, it holds {held} and no tetrahedra: mesh the volume")


def _read_msh(path: Path, metres_per_unit: float) -> skfem.MeshTet:
    """Read tetrahedra, physical surfaces and physical volumes of a gmsh file of any version, text or binary."""
    _check_msh_header(path)
    points, tets, surfaces, volumes = call_in_child(msh_arrays, path)
    return named_mesh(scaled(points, metres_per_unit), tets, surfaces, volumes, parts=None)


def msh_arrays(path: Path) -> tuple[Array, Indices, Named, Named]:
    """Read points `(n, 3)` [file units], tets `(m, 4)`, the triangles of physical surfaces and the tets of physical
    volumes by gmsh, which some files bring down: call it in a process of its own. Raises `MeshError`.
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
        except Exception as error:  # gmsh raises nothing more specific
            raise MeshError(f"gmsh cannot read it: {error}") from error


def scaled(points: Array, metres_per_unit: float) -> Array:
    """Return points in metres; what is too large for that is refused with what is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(points, dtype=float) * metres_per_unit


def _check_msh_header(path: Path) -> None:
    """Refuse a file that does not begin like a gmsh mesh.

    gmsh runs a file of any other kind as a script in its own language, shell commands included.
    """
    with path.open("rb") as file:
        first = file.read(64).lstrip().split(maxsplit=1)[:1]
    if first not in ([b"$NOD"], [b"$MeshFormat"], [b"$Comments"], [b"$PhysicalNames"]):
        raise MeshError("it does not begin like a gmsh mesh, with $NOD or $MeshFormat")


def _old_node_count(path: Path) -> int | None:
    """Return the number of nodes that a file of format 1 or 2 declares; None in later formats, where gmsh keeps
    every node.
    """
    content = path.read_bytes()
    header = re.search(rb"\$MeshFormat\s+(\d)", content)
    if header and header[1] != b"2":
        return None
    declared = re.search(rb"\$(?:NOD|Nodes)\s+(\d+)", content)
    return int(declared[1]) if declared else None


def _check_all_nodes_kept(declared: int, kept: int) -> None:
    """Refuse a file with nodes that no element uses.

    In formats 1 and 2 gmsh drops such nodes without a word.
    """
    if declared != kept:
        raise MeshError(
            f"{declared - kept} of {declared} nodes belong to no element: delete them, "
            "or find the elements that are missing"
        )


def _check_groups_apart(gmsh: Any) -> None:
    """Refuse two groups in one entity.

    Formats 1 and 2 give groups by element, gmsh keeps them by entity: two groups in one
    entity would silently merge.
    """
    for dimension, entity in [*gmsh.model.getEntities(2), *gmsh.model.getEntities(3)]:
        groups = gmsh.model.getPhysicalGroupsForEntity(dimension, entity).tolist()
        if len(groups) > 1:
            raise MeshError(
                f"its elementary entity {entity} of dimension {dimension} lies in the physical groups "
                f"{groups}, which gmsh cannot tell apart: give each group an elementary number of its own, "
                "or save as format 4.1"
            )
