"""Assembly some cells at a time: of all cells at once, the local matrices of a million unknowns take 12 GB."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem import Basis, BilinearForm

from tissue.material import PerCell

ENTRIES = 15_000_000  # of the local matrices that are made at once: half a gigabyte


def assembled(form: BilinearForm, basis: Basis, intorder: int, **fields: PerCell) -> csr_matrix:
    """The matrix of a form over the unknowns of `basis`, by a quadrature exact to `intorder`; `fields` are numbers, or
    one per cell.
    """
    count, matrix = basis.mesh.nelements, csr_matrix((basis.N, basis.N))
    for cells in np.array_split(np.arange(count), 1 + count * basis.Nbfun**2 // ENTRIES):
        part = Basis(basis.mesh, basis.elem, intorder=intorder, elements=cells, dofs=basis.dofs)
        matrix = matrix + csr_matrix(form.assemble(part, **{name: _of(value, cells) for name, value in fields.items()}))
    return matrix


def _of(value: PerCell, cells: NDArray[np.intp]) -> NDArray[np.float64]:
    """A column that broadcasts over cells and quadrature points."""
    values = np.asarray(value, float)
    return (values if values.ndim == 0 else values[cells]).reshape(-1, 1)
