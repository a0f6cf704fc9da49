"""Site variables at finite strain, y = y(z) with z = Z U.

z is linear in the organ's unknowns U, and y(z) is local and smooth. The point is linear in U. A
normal frame convects with the surface by u = ⟨F⟩ u₀ and is linear too. For both, z is y − y₀
itself. A fibre frame lies along the cut of the needle. It follows the material line d₀ by T ∥ ⟨F⟩
d₀. Its u and v are normal to T, u = ⟨F⟩⁻ᵀ u₀. In this case z holds the displacement of the point
and the nine numbers of ⟨∇U⟩. To first order in U, the result is the frame of the linear organ.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import block_diag, csc_matrix, csr_matrix, identity, vstack

from tissue.arrays import Array
from tissue.sites.site import Sites

NINE, TWELVE = 9, 12


@dataclass(frozen=True)
class SiteMap:
    """The function y(z) of `sites`, with its first and second derivatives.

    y has shape `(9p,)`. z has shape `(k,)`: 9 numbers per site, or 12 for a fibre frame.
    """

    sites: Sites

    @cached_property
    def cut(self) -> tuple[bool, ...]:
        """Whether each site has a fibre frame, along the cut of the needle."""
        slopes = self.sites.slopes or (None,) * len(self.sites.points)
        return tuple(rows is not None for rows in slopes)

    @cached_property
    def Z(self) -> csr_matrix:
        """Rows of z over the free unknowns, shape `(k, N)`."""
        if not any(self.cut):
            return self.sites.Y
        parts = []
        for site, rows in enumerate(self.sites.slopes):
            own = self.sites.Y[NINE * site : NINE * (site + 1)]
            parts.append(own if rows is None else vstack([own[:3], rows]))
        return csr_matrix(vstack(parts))

    @cached_property
    def Z_T(self) -> csc_matrix:
        """Zᵀ, shape `(N, k)`."""
        return csc_matrix(self.Z.T)

    @cached_property
    def _parts(self) -> list[slice]:
        """The slice of each site in z."""
        ends = np.cumsum([0, *(TWELVE if cut else NINE for cut in self.cut)]).tolist()
        return [slice(first, last) for first, last in pairwise(ends)]

    def y(self, z: Array) -> Array:
        """Return the site variables, shape `(9p,)`."""
        if not any(self.cut):
            return np.asarray(self.sites.y0 + z)
        out = np.empty(self.sites.y0.size)
        for y0, part, cut, y in zip(self._frames, self._parts, self.cut, out.reshape(-1, NINE), strict=True):
            H = _carried(z[part]) if cut else None
            y[:] = y0 + z[part] if H is None else np.concatenate([y0[:3] + z[part][:3], H @ y0[3:6], H @ y0[6:]])
        return out

    @cached_property
    def _frames(self) -> Array:
        """y0 by site, shape `(p, 9)`."""
        return self.sites.y0.reshape(-1, NINE)

    def slope(self, z: Array) -> csr_matrix:
        """Return J = ∂y/∂z, shape `(9p, k)`; ∂u_i/∂F_jk = −H_ik u_j with H = F⁻ᵀ."""
        if not any(self.cut):
            return identity(z.size, format="csr")
        blocks = []
        for frame, part, cut in zip(self._frames, self._parts, self.cut, strict=True):
            block = np.eye(NINE, TWELVE if cut else NINE)
            if cut:
                H = _carried(z[part])
                for rows in (slice(3, 6), slice(6, 9)):
                    block[rows, 3:] = -np.einsum("ik,j->ijk", H, H @ frame[rows]).reshape(3, 9)
            blocks.append(block)
        return csr_matrix(block_diag(blocks))

    def bend(self, z: Array, f_y: Array) -> csr_matrix:
        """Return S = Σ f_y ∂²y/∂z², symmetric, shape `(k, k)`.

        Its entries are H_lk a_m u_j + a_k H_jm u_l with a = F⁻¹ f_u.
        """
        if not any(self.cut):
            return csr_matrix((z.size, z.size))
        blocks = []
        for frame, f, part, cut in zip(self._frames, f_y.reshape(-1, NINE), self._parts, self.cut, strict=True):
            block = np.zeros((TWELVE, TWELVE) if cut else (NINE, NINE))
            if cut:
                H = _carried(z[part])
                for rows in (slice(3, 6), slice(6, 9)):
                    u, a = H @ frame[rows], H.T @ f[rows]
                    both = np.einsum("lk,m,j->jklm", H, a, u)
                    block[3:, 3:] += (both + np.einsum("jklm->lmjk", both)).reshape(9, 9)
            blocks.append(block)
        return csr_matrix(block_diag(blocks))


def _carried(z: Array) -> Array:
    """Return H = F⁻ᵀ from the numbers (12,) of a fibre frame."""
    return np.asarray(np.linalg.inv(np.eye(3) + z[3:].reshape(3, 3)).T)
