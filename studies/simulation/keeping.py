"""Small bases of organs, stored in a folder: the name of each file is a digest of all its inputs.

The inputs are the matrices themselves: stiffness, mass, sites and loads. Any mesh, material and
holes with the same matrices, to the last bit, have the same basis. A program with another assembly
does not find the bases of an older one.
"""

import hashlib
import logging
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

import tissue
from studies.arrays import Array
from studies.output.checkpoint import read_arrays, write_arrays
from studies.scenario.table import refused

log = logging.getLogger(__name__)

FORMAT = 2  # of the files: a file with another meaning of its arrays has another number


def kept_reduction(organ: tissue.DynamicOrgan, blocks: int, modes: int, folder: Path) -> tissue.Reduction:
    """Return the reduction of an organ from a folder, else make and store it.

    A damaged file is replaced. Raises `TissueError` for an organ without a reduction, and
    `ScenarioError` if the folder cannot be written.
    """
    tissue.check_reducible(organ, blocks, modes)
    file = folder / f"{digest_of(organ, blocks, modes)}.npz"
    found = _read(file)
    if found is not None:
        log.info("basis of the organ: %d vectors from %s", found.size, file)
        return found
    basis = tissue.reduce_organ(organ, blocks, modes)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_arrays(file, asdict(basis))
    except OSError as error:
        raise refused("tissue.reduction.keep", str(folder), "basis-folder", error=error) from error
    return basis


def digest_of(organ: tissue.DynamicOrgan, blocks: int, modes: int) -> str:
    """Return the SHA-256 of all inputs of a basis, including its solver."""
    digest = hashlib.sha256(f"{FORMAT} {blocks} {modes} {organ.size} {organ.choice.name}".encode())
    for part in (organ.K, organ.M, organ.Y, organ.load, organ.surface_load):
        for numbers in _arrays(part):
            digest.update(f"{numbers.dtype.str} {numbers.shape}".encode())
            digest.update(np.ascontiguousarray(numbers).data)
    return digest.hexdigest()


def _arrays(part: csr_matrix | Array) -> tuple[Array, ...]:
    """Return the arrays of a matrix, the indices of a sparse matrix in 64 bits."""
    if isinstance(part, csr_matrix):
        return part.data, part.indices.astype(np.int64), part.indptr.astype(np.int64)
    return (part,)


def _read(file: Path) -> tissue.Reduction | None:
    """Return the reduction in a file, None if the file is missing or damaged."""
    try:
        found = read_arrays(file)
    except OSError:
        return None
    return None if found is None else tissue.Reduction(**found)
