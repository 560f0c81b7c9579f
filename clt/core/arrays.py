"""Names of the arrays and of the unit of time that every part of clt uses."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]
Stamps = NDArray[np.int64]
"""Nanoseconds."""

NS_PER_SECOND = 1_000_000_000
