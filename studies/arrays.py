"""The kind of array that the studies pass on."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
