"""Bodies at finite strain that are solved without an organ: by Newton on a sparse tangent."""

import numpy as np
from scipy.sparse.linalg import spsolve
from skfem import MeshTet

import tissue
from tissue.arrays import Array

CORRECTIONS = 25
SOLVED = 1e-11  # of the largest force of a cell on a node


def equilibrium(hyper: tissue.Hyperelasticity, guess: Array, load: Array | None = None, steps: int = 1) -> Array:
    """Displacement `(N,)` [m] under `load` `(N,)` [N], reached in `steps`, near a guess that is right at the clamped
    unknowns."""
    free, U = hyper.body.free, guess.copy()
    f = np.zeros(hyper.body.N) if load is None else load
    for step in range(1, steps + 1):
        for _ in range(CORRECTIONS):
            F = hyper.gradient(U)
            forces, scale = hyper.forces(F)
            r = (f * step / steps - forces)[free]
            if np.abs(r).max() <= SOLVED * scale:
                break
            U = U.copy()
            U[free] += spsolve(hyper.tangent(F).tocsc(), r)
        assert np.abs(r).max() <= SOLVED * scale
    return U


def box(counts: tuple[int, int, int], size: tuple[float, float, float], jitter: float = 0.0) -> MeshTet:
    """A box from the origin whose inner nodes are moved by that share of a cell; its sides are named."""
    lines = [np.linspace(0.0, s, n + 1) for n, s in zip(counts, size, strict=True)]
    mesh, top = MeshTet.init_tensor(*lines), np.array(size)[:, None]
    inner = np.all((mesh.p > 1e-9 * top) & (mesh.p < (1.0 - 1e-9) * top), axis=0)
    moves = np.random.default_rng(3).uniform(-1.0, 1.0, mesh.p.shape) * jitter * top / np.array(counts)[:, None]
    named = {f"{name}{k}": (k, at) for k in range(3) for name, at in (("low", 0.0), ("high", size[k]))}
    sides = {name: lambda x, k=k, at=at: np.abs(x[k] - at) < 1e-9 * size[k] for name, (k, at) in named.items()}
    return MeshTet(mesh.p + moves * inner, mesh.t).with_boundaries(sides | {"all": lambda x: x[0] < np.inf})
