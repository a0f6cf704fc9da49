"""The array type of the studies, and the prefixes of units."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MILLI, KILO, MEGA, GIGA = 1e-3, 1e3, 1e6, 1e9
