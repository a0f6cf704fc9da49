"""A soft block, held at its bottom and pulled at two holes of its top."""

import numpy as np

import tissue
from coupling.integrators import BDF2, BackwardEuler, Scheme
from meshes.block import block

SOFT = tissue.Material(4.0e4, 0.45, 1070.0)
SITES = [tissue.Site((x, 0.0, 0.0), 2.0e-3, direction="normal") for x in (-0.005, 0.005)]
PULL = np.zeros(18)
PULL[[0, 2, 11]] = 0.02, 0.05, 0.03  # N
DT = 2.0e-4


def organ_of(h: float = 3.5e-3, **keys: object) -> tissue.DynamicOrgan:
    body = tissue.elasticity(block((0.03, 0.02, 0.015), h), SOFT, "P1", ("bottom",))
    return tissue.DynamicOrgan(body, tissue.build_sites(body, SITES), **keys)  # type: ignore[arg-type]


def schemes(kind: type[Scheme], steps: int, dt: float = DT) -> list[Scheme]:
    """BDF2 begins by a step of backward Euler."""
    return [BDF2(dt, dt) if kind is BDF2 and n else BackwardEuler(dt) for n in range(steps)]
