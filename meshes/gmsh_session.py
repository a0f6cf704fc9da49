"""The only module of this package that loads gmsh.

gmsh is loaded when first needed. It is silent, reproducible for the same input, and always
finalised.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np
import skfem
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError
from meshes.grading import Grading, Gradings, far_size, grading_at
from meshes.named import Named, named_mesh

Array = NDArray[np.float64]

TRIANGLE, TETRAHEDRON = 2, 4  # gmsh element types (gmsh manual, "MSH file format")
DIGITS = 12  # digits after the point of a length in a model: with more, round-off decides between equal choices of gmsh

SYSTEM_LIBRARIES = "libglu1-mesa libgl1 libegl1 libxrender1 libxcursor1 libxft2 libxinerama1 libgomp1"
WITHOUT_GMSH = "The structured block and mesh files in .vtk or .vtu format work without gmsh."

OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,  # parallel meshing is not reproducible
    "Mesh.RandomSeed": 1,
    "Mesh.Algorithm": 6,  # frontal Delaunay in the surfaces
    "Mesh.Algorithm3D": 1,  # Delaunay in the volume; HXT would be parallel
    "Mesh.Optimize": 1,
    "Mesh.OptimizeNetgen": 1,
    "Mesh.MeshSizeExtendFromBoundary": 0,  # only the size field decides
    "Mesh.MeshSizeFromPoints": 0,
    "Mesh.MeshSizeFromCurvature": 0,
}


def load_gmsh() -> Any:
    """Return the module gmsh.

    Raises `MeshError` with the missing library, how to install it, and what works without gmsh.
    """
    try:
        return import_module("gmsh")
    except ModuleNotFoundError as error:
        raise MeshError(
            f"gmsh is not installed: pip install 'suturefem[mesh]' (no wheel exists for Linux on ARM). {WITHOUT_GMSH}"
        ) from error
    except OSError as error:
        found = re.search(r"lib[\w+.-]+\.so[.\d]*", str(error))
        missing = f"the system library {found[0]} is missing" if found else f"a system library is missing ({error})"
        raise MeshError(
            f"gmsh cannot load: {missing}. On Debian and Ubuntu, as root: "
            f"`apt-get install --no-install-recommends {SYSTEM_LIBRARIES}`. {WITHOUT_GMSH}"
        ) from error


@contextmanager
def session() -> Iterator[Any]:
    """Yield a new gmsh, and finalise it at the end.

    gmsh is initialised without the user's settings or signal handlers. Raises `MeshError` if gmsh
    cannot load or is already in use by the calling program.
    """
    gmsh = load_gmsh()
    if gmsh.isInitialized():
        raise MeshError("gmsh is already initialised in this process: call gmsh.finalize() first")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        for option, value in OPTIONS.items():
            gmsh.option.setNumber(option, value)
        yield gmsh
    finally:
        gmsh.finalize()


def in_unit(lengths: ArrayLike, unit: float) -> Array:
    """Return lengths [m] in the `unit` of a model [m], with the same shape.

    Each model has its own unit of length. gmsh's absolute tolerances then give the same mesh for a
    shape of any size.
    """
    return np.round(np.asarray(lengths, dtype=float) / unit, DIGITS)


def generate(gmsh: Any, gradings: Gradings, sites: Array, unit: float) -> skfem.MeshTet:
    """Return a mesh of the current model, with the size graded toward sites `(p, 3)` [m].

    `gradings` has one grading for all sites, or one for each. The model is drawn in the `unit` [m].
    Raises `MeshError` if gmsh fails.
    """
    each, largest = grading_at(gradings, len(sites)), far_size(gradings)
    gmsh.option.setNumber("Mesh.MeshSizeMax", float(in_unit(largest, unit)))
    _set_size_field(gmsh, each, sites, unit)
    try:
        gmsh.model.mesh.generate(3)
    except Exception as error:  # gmsh raises no more specific error
        raise MeshError(
            f"gmsh cannot mesh this shape with sizes from {min((g.h_site for g in each), default=largest):.3g} to "
            f"{largest:.3g} m: {error}"
        ) from error
    return current_mesh(gmsh, unit)


def _set_size_field(gmsh: Any, gradings: Sequence[Grading], sites: Array, unit: float) -> None:
    """Set a size field of one ball per site (gmsh manual, Ball and Min).

    The size is linear in the shell of a ball. The smallest size of all balls is used.
    """
    field = gmsh.model.mesh.field
    balls = []
    names = ("XCenter", "YCenter", "ZCenter", "Radius", "Thickness", "VIn", "VOut")
    for site, grading in zip(sites, gradings, strict=True):
        shell = grading.flat, grading.reach - grading.flat, grading.h_site, grading.h
        ball = field.add("Ball")
        for key, value in zip(names, in_unit([*site, *shell], unit).tolist(), strict=True):
            field.setNumber(ball, key, value)
        balls.append(ball)
    smallest = field.add("Min")
    field.setNumbers(smallest, "FieldsList", balls)
    if balls:
        field.setAsBackgroundMesh(smallest)


def current_mesh(gmsh: Any, metres_per_unit: float) -> skfem.MeshTet:
    """Return the tetrahedra of the current model.

    Physical surfaces become boundaries, and physical volumes become subdomains. Points are in
    metres. Raises the `MeshError` of the checks in `named_mesh`.
    """
    points, tets, surfaces, volumes = current_arrays(gmsh)
    return named_mesh(points * metres_per_unit, tets, surfaces, volumes)


def current_arrays(gmsh: Any) -> tuple[Array, NDArray[np.int64], Named, Named]:
    """Return points, tets, the triangles of physical surfaces and the tets of physical volumes.

    Points have shape `(n, 3)`, and tets `(m, 4)`. A group without a name is named by its number.
    Groups with names that begin with `gmsh:` are internal to gmsh and are dropped.
    """
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    tags, first = np.unique(np.asarray(tags, dtype=np.int64), return_index=True)
    points = np.asarray(coordinates, dtype=float).reshape(-1, 3)[first]

    def elements(kind: int, entity: int) -> NDArray[np.int64]:
        nodes = np.asarray(gmsh.model.mesh.getElementsByType(kind, entity)[1], dtype=np.int64)
        return np.searchsorted(tags, nodes).astype(np.int64).reshape(-1, 3 if kind == TRIANGLE else 4)

    blocks = {entity: elements(TETRAHEDRON, entity) for _, entity in gmsh.model.getEntities(3)}
    tets = np.concatenate([np.empty((0, 4), dtype=np.int64), *blocks.values()])
    ends = np.cumsum([0, *(len(block) for block in blocks.values())])
    ranges = {entity: np.arange(ends[k], ends[k + 1]) for k, entity in enumerate(blocks)}
    surfaces = {
        name: np.concatenate([elements(TRIANGLE, e) for e in entities]) for name, entities in _groups(gmsh, 2).items()
    }
    volumes = {name: np.concatenate([ranges[e] for e in entities]) for name, entities in _groups(gmsh, 3).items()}
    return points, tets, surfaces, volumes


def _groups(gmsh: Any, dimension: int) -> dict[str, list[int]]:
    """Return the entities of the physical groups of a dimension by name."""
    groups: dict[str, list[int]] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dimension):
        name = gmsh.model.getPhysicalName(dimension, tag) or str(tag)
        if not name.startswith("gmsh:"):
            groups.setdefault(name, []).extend(gmsh.model.getEntitiesForPhysicalGroup(dimension, tag).tolist())
    return groups
