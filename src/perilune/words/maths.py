"""The maths namespace `m` that is handed to a user's physics: one text for floats, arrays and symbols.

``dynamics(x, u, p, m)`` uses ``m.sin``, ``m.sqrt``, ... and never imports a maths library itself, so that the same
text flies in the verifier (numpy, real or complex) and is traced into symbols by `perilune.problem.symbolic`.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

# name in `m`: name in numpy. The symbolic twin takes the same keys.
NUMPY_NAMES = {
    "sqrt": "sqrt",
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "asin": "arcsin",
    "acos": "arccos",
    "atan": "arctan",
    "atan2": "arctan2",
    "sinh": "sinh",
    "cosh": "cosh",
    "tanh": "tanh",
    "exp": "exp",
    "log": "log",
    "fabs": "abs",
    "fmin": "minimum",
    "fmax": "maximum",
}

NUMERIC = SimpleNamespace(**{name: getattr(np, numpy_name) for name, numpy_name in NUMPY_NAMES.items()})
