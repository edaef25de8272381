"""Array aliases. The comment beside each gives the shape that the name promises."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]  # (n,)
Matrix = NDArray[np.float64]  # (m, n)
Batch = NDArray[np.float64]  # (lanes, ...)

# A user's physics: dynamics(x, u, p, m) and its like. The same text runs on floats, arrays and symbols, so its
# arguments are records of whatever the caller computes with.
Physics = Callable[..., Any]
