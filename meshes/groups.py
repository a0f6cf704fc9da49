"""The names of regions and boundaries in a mesh that meshio has read.

The names come from its sets of cells and from its cell arrays. An array of whole numbers marks
cells; zero and negative numbers mark no cells. An array of zeros and ones is one group with the
array's name. An array of several numbers is one group per number. Each group is named by its
number, or by the name that the file has for this number.
"""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.named import Named

Marks = NDArray[np.bool_]

MOST = 200  # distinct numbers in an array that marks groups: an array with more is a numbering of the cells
LABELS = re.compile(r"(.*[:_ ])?(physical|ref|tags?|\w*ids?|labels?|regions?|materials?)", re.IGNORECASE)
SKIPPED = ("gmsh:geometrical", "gmsh:dim_tags")  # gmsh's internal numbers of entities
PREFIXES = {"triangle": "boundary_", "tetra": "region_"}


def named_groups(data: Any) -> tuple[Named, Named]:
    """Return the triangles of named surfaces and the tetrahedra of named volumes.

    Triangles have shape `(k, 3)`. Tetrahedra are given by their numbers.
    """
    triangles = cells_of(data, "triangle")
    surfaces = {name: triangles[marks] for name, marks in groups_of(data, "triangle").items()}
    return surfaces, {name: np.flatnonzero(marks) for name, marks in groups_of(data, "tetra").items()}


def cells_of(data: Any, kind: str) -> NDArray[np.int64]:
    """Return the cells of a kind from all blocks in order."""
    corners = {"triangle": 3, "tetra": 4}[kind]
    return np.concatenate([np.empty((0, corners), np.int64), *(b.data for b in data.cells if b.type == kind)])


def groups_of(data: Any, kind: str) -> dict[str, Marks]:
    """Return which cells of a kind are in each group.

    Groups without cells of the kind are left out.
    """
    found: dict[str, Marks] = {}
    for name, marks in (*marked_by_sets(data, kind), *marked_by_arrays(data, kind)):
        found[name] = found.get(name, False) | marks
    return {name: marks for name, marks in found.items() if marks.any()}


def marked_by_sets(data: Any, kind: str) -> Iterator[tuple[str, Marks]]:
    """Yield the file's named sets of cells."""
    for name, parts in data.cell_sets.items():
        marks = [np.zeros(len(block.data), dtype=bool) for block in data.cells]
        for mark, part in zip(marks, parts, strict=True):
            if part is not None:
                mark[np.asarray(part, dtype=np.int64)] = True
        yield name, of_kind(data, marks, kind)


def marked_by_arrays(data: Any, kind: str) -> Iterator[tuple[str, Marks]]:
    """Yield the groups that arrays of whole numbers mark."""
    for name, parts in data.cell_data.items():
        values = of_kind(data, parts, kind)
        if name in SKIPPED or values.dtype.kind not in "biu" or values.ndim != 1:
            continue
        names, there = names_of_numbers(data, name, kind), np.unique(values).tolist()
        numbers = [n for n in there if n > 0 or n in names]
        if numbers == [1] and not names and not LABELS.fullmatch(name):
            yield name.removeprefix(PREFIXES[kind]), values == 1
        elif len(numbers) <= MOST and (len(there) < len(values) or len(there) == 1):  # else a numbering of the cells
            yield from ((each, values == n) for n in numbers for each in names.get(n, [str(n)]))


def names_of_numbers(data: Any, array: str, kind: str) -> dict[int, list[str]]:
    """Return the file's names for the numbers of an array.

    These are names of families in MED, or of physical groups in gmsh.
    """
    if array == "cell_tags":
        return dict(getattr(data, "cell_tags", {}))
    if array != "gmsh:physical":
        return {}
    dimension = 2 if kind == "triangle" else 3
    pairs = [(name, pair) for name, pair in data.field_data.items() if np.size(pair) == 2]
    return {int(pair[0]): [name] for name, pair in pairs if pair[1] == dimension}


def of_kind(data: Any, parts: Any, kind: str) -> NDArray[Any]:
    """Return the data of the blocks with cells of a kind; empty if a block has no data."""
    own = [part for block, part in zip(data.cells, parts, strict=True) if block.type == kind]
    return np.concatenate(own) if own and all(part is not None for part in own) else np.empty(0, dtype=bool)
