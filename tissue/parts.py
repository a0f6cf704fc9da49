"""Assembly some cells at a time: of all cells at once, the local matrices of a million unknowns take 12 GB."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Basis, BilinearForm

ENTRIES = 15_000_000  # of the local matrices that are made at once: half a gigabyte


def assembled(form: BilinearForm, basis: Basis, intorder: int, **fields: NDArray[np.float64]) -> csr_matrix:
    """The matrix of a form over the unknowns of `basis`, by a quadrature exact to `intorder`; `fields` are `(1, 1)`, or
    `(cells, 1)` for a value per cell.
    """
    count, matrix = basis.mesh.nelements, csr_matrix((basis.N, basis.N))
    for cells in np.array_split(np.arange(count), 1 + count * basis.Nbfun**2 // ENTRIES):
        part = Basis(basis.mesh, basis.elem, intorder=intorder, elements=cells, dofs=basis.dofs)
        here = {name: value[cells] if len(value) > 1 else value for name, value in fields.items()}
        matrix = matrix + csr_matrix(form.assemble(part, **here))
    return matrix
