"""Types of arrays that every package shares."""

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]
"""Of any floating type; docstrings say which where it matters."""

IntArray = npt.NDArray[np.integer[Any]]
"""Of any integer type."""

BoolArray = npt.NDArray[np.bool_]
