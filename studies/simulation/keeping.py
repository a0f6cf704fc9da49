"""Small bases of organs, kept in a folder: each in a file that is named by a digest of all that it is made from.

That is the matrices themselves, stiffness, mass, sites and loads, not the scenario that they come from: whatever mesh,
material and holes give the same matrices, to the last bit, have the same basis, and a program that assembles them
otherwise finds none of an older one's.
"""

import hashlib
import io
import logging
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix

import tissue
from studies.arrays import Array
from studies.output.checkpoint import is_sealed, sealed
from studies.output.files import write_bytes
from studies.scenario import ScenarioError
from studies.scenario.refusal import refusal

log = logging.getLogger(__name__)

KEY = "tissue.reduction.keep"
FORMAT = 2  # of the files: one that means something else by its arrays is not taken for this


def kept_reduction(organ: tissue.DynamicOrgan, blocks: int, modes: int, folder: Path) -> tissue.Reduction:
    """Return the reduction of an organ from a folder, else make it and store it there; a damaged file is replaced.

    Raises `TissueError` for an organ that has none, `ScenarioError` where the folder cannot be written.
    """
    tissue.check_reducible(organ, blocks, modes)
    file = folder / f"{digest_of(organ, blocks, modes)}.npz"
    found = _read(file)
    if found is not None:
        log.info("basis of the organ: %d vectors from %s", found.size, file)
        return found
    made = tissue.reduce_organ(organ, blocks, modes)
    packed = io.BytesIO()
    np.savez(packed, **asdict(made))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(file, sealed(packed.getvalue()))
    except OSError as error:
        reason = f"the basis cannot be written there ({error}); name another folder"
        raise ScenarioError(refusal(KEY, str(folder), reason)) from error
    return made


def digest_of(organ: tissue.DynamicOrgan, blocks: int, modes: int) -> str:
    """Return the SHA-256 of all that a basis is made from, its solver included."""
    digest = hashlib.sha256(f"{FORMAT} {blocks} {modes} {organ.size} {organ.choice.name}".encode())
    for part in (organ.K, organ.M, organ.Y, organ.load, organ.surface_load):
        for numbers in _arrays(part):
            digest.update(f"{numbers.dtype.str} {numbers.shape}".encode())
            digest.update(np.ascontiguousarray(numbers).data)
    return digest.hexdigest()


def _arrays(part: csr_matrix | Array) -> tuple[Array, ...]:
    """Return the arrays that a matrix consists of, the indices of a sparse one in 64 bits."""
    if isinstance(part, csr_matrix):
        return part.data, part.indices.astype(np.int64), part.indptr.astype(np.int64)
    return (part,)


def _read(file: Path) -> tissue.Reduction | None:
    """Return what a file has, None if there is none or one that is not as it was written, to the last bit."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    if not is_sealed(data):
        return None
    with np.load(io.BytesIO(data), allow_pickle=False) as found:
        return tissue.Reduction(**found)
