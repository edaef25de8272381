"""Machine code in a process whose memory is scattered over more than 2 GB, where LLVM would abort."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from perilune.kernels.code import native

SCRIPT = """
import mmap, sys
import casadi as ca, numpy as np
from perilune.kernels import compile_map
from perilune.kernels.code import native
z = ca.SX.sym("z", 40)
e = z
for i in range(40):
    e = 0.5 * ca.sin(e) + 0.3 * ca.vertcat(e[1:], e[:1]) + 0.01 * i + e / (3.0 + ca.cos(e))
f = ca.Function("f", [z], [e])
small = [mmap.mmap(-1, 16384) for _ in range(400)]
big = [mmap.mmap(-1, 1 << 30) for _ in range(4)]  # never touched
for piece in small[::2]:
    piece.close()
x = np.linspace(0.0, 1.0, 40)[None]
found = compile_map(f, cache=False, backend="native")(x)[0]
print(native._allocates_nearby(), np.allclose(found, np.array(f(x[0])).ravel(), rtol=1e-9, atol=0.0))
"""


@pytest.mark.skipif(not native.is_available() or sys.platform != "linux", reason="machine code on Linux")
def test_code_is_loaded_where_small_pieces_lie_far_from_large_ones() -> None:
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False, timeout=120, env=dict(os.environ)
    )
    assert run.returncode == 0, run.stderr[-500:]
    assert run.stdout.split()[-1] == "True"
