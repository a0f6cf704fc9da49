"""The kinds of arrays that the organ is made of."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Single = NDArray[np.float32]
