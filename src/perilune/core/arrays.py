"""Array aliases. The comment next to each gives the shape that the name promises."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray

# Floats throughout; `Any`, because NumPy types the results of its linear algebra more loosely than float64.
Vector = NDArray[Any]  # (n,)
Matrix = NDArray[Any]  # (m, n)
Stack = NDArray[Any]  # (lanes, ...)

# A user's physics: dynamics(x, u, p, xp) and its like. The same text runs on floats, arrays and symbols, so its
# arguments are records of whatever the caller computes with.
Physics = Callable[..., Any]
