"""The array type of the studies."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
