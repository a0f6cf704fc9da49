"""The array type of the studies, and the prefixes of units."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MILLI, KILO, MEGA, GIGA = 1e-3, 1e3, 1e6, 1e9
UNITS = {"mm": 1e-3, "ms": 1e-3, "mN": 1e-3, "mm/N": 1e-3, "kPa": 1e3, "MPa": 1e6, "MB": 1e6, "%": 1e-2}  # in SI units
