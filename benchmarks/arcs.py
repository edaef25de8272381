"""Arcs per second against heyoka, with and without what decouples, and the share of the FMA peak.

Arc: planar landing extremal, 440 N, 310 s, 300 kg, mu 4902.8 km^3/s^2, R 1738 km, 700 s from perilune (15
km), six columns (lam_r, lam_u, lam_v, lam_m, u0, m0), tolerance 1e-12, a batch of dispersed lanes. Run it on
a quiet machine:

    python benchmarks/arcs.py [--lanes 16384] [--without-heyoka]
"""

from __future__ import annotations

import argparse
import ctypes
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "kernels"))

from lander import DURATION, PARAMETERS, landing_rhs, landing_seeds, start  # pyright: ignore[reportMissingImports]

from perilune.kernels import compile_arcs
from perilune.kernels.algebra.program import hoist
from perilune.kernels.algebra.prune import prune
from perilune.kernels.code import native
from perilune.kernels.code.ir import Ptr, Writer
from perilune.kernels.flight import tableau


def best(action: Callable[[], Any], repeats: int = 5) -> tuple[float, float, Any]:
    """Return the shortest of several runs by the clock and in processor time, and the last result.

    Processor time is what the code takes; the clock also shows what else the machine was doing.
    """
    clock, processor, result = np.inf, np.inf, None
    for _ in range(repeats):
        begun, used = time.perf_counter(), time.process_time()
        result = action()
        clock = min(clock, time.perf_counter() - begun)
        processor = min(processor, time.process_time() - used)
    return clock, processor, result


def fma_peak() -> float:
    """Return flops per second of one core on independent fused multiply-adds in registers."""
    w, chains, rounds = Writer(4), 12, 20_000_000
    data = Ptr("%data", w.vector)
    variables = [w.buffer(1) for _ in range(chains)]
    for number, variable in enumerate(variables):
        w.store(w.const(1.0 + number), variable)
    factor, term = w.load(data, 0), w.load(data, 1)
    with w.loop(0, rounds):
        for variable in variables:
            w.store(w.fma(w.load(variable), factor, term), variable)
    for number, variable in enumerate(variables):
        w.store(w.load(variable), data, number)
    text = f"define void @peak(ptr align 64 %data) nounwind {{\n{w.body()}\n  ret void\n}}\n"
    code = native.MachineCode(native.compile_ir(text))
    raw = np.ones(4 * chains + 8)
    values = raw[(-raw.ctypes.data // 8) % 8 :]
    values[:4], values[4:8] = 0.999, 0.001
    _, seconds, _ = best(lambda: code.function("peak", ctypes.c_void_p)(values.ctypes.data), 3)
    return 2 * 4 * chains * rounds / seconds


def flops_per_step(system: Any) -> float:
    """Count the additions and products of one lane's step; a division or a square root counts as one."""
    _, field = hoist(system.field_program(0), 1)
    each = sum(field.operations.values())
    weights = sum(len(tableau.A[stage]) for stage in range(1, tableau.STAGES)) + len(tableau.B)
    combinations = system.size * 2 * (weights + tableau.STAGES)
    errors = system.nz * (2 * (len(tableau.E3) + len(tableau.E5)) + 8)
    return tableau.STAGES * each + combinations + errors


def heyoka_batch(lanes: int, starts: np.ndarray, seeds: np.ndarray) -> Callable[[int], tuple[float, np.ndarray]]:
    """Return (batch size) -> arcs per core second of heyoka with the same columns, and its final states."""
    import heyoka as hy

    from perilune.kernels.algebra.program import trace_function

    names = hy.make_vars(*[f"z{i}" for i in range(10)])
    values: list[Any] = []
    apply = {
        "add": lambda a, b: a + b,
        "sub": lambda a, b: a - b,
        "mul": lambda a, b: a * b,
        "div": lambda a, b: a / b,
        "neg": lambda a: -a,
        "sqrt": hy.sqrt,
    }
    program = trace_function(landing_rhs())
    for op, *operands in program.instructions:
        if op == "input":
            values.append(names[operands[1]] if operands[0] == 0 else float(PARAMETERS[operands[1]]))
        elif op == "const":
            values.append(float.fromhex(operands[0]))
        else:
            values.append(apply[op](*(values[i] for i in operands)))
    rates = [hy.expression(values[i]) if isinstance(values[i], float) else values[i] for i in program.outputs]
    # Only the six directions wanted, as variables of their own: the cheapest way to have them.
    columns = [[hy.make_vars(f"s{i}_{j}") for i in range(10)] for j in range(seeds.shape[2])]
    system = list(zip(names, rates, strict=True))
    slopes = hy.diff_tensors(rates, diff_args=names, diff_order=1).jacobian
    for column in columns:
        for i in range(10):
            system.append((column[i], sum((slopes[i][j] * column[j] for j in range(10)), hy.expression(0.0))))

    def run(batch: int) -> tuple[float, np.ndarray]:
        state = np.concatenate([starts, seeds.transpose(0, 2, 1).reshape(lanes, -1)], axis=1)
        integrator = hy.taylor_adaptive_batch(system, state[:batch].T.copy(), tol=1e-12, compact_mode=True)
        ends = np.empty_like(starts)

        def fly() -> None:
            for first in range(0, lanes, batch):
                integrator.set_time(0.0)
                integrator.state[:] = state[first : first + batch].T
                integrator.propagate_until(DURATION)
                ends[first : first + batch] = integrator.state[:10].T

        _, seconds, _ = best(fly, 3)
        return lanes / seconds, ends

    return run


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=16384)
    parser.add_argument("--without-heyoka", action="store_true")
    asked = parser.parse_args()
    starts, seeds, cores = start(asked.lanes), landing_seeds(asked.lanes), os.cpu_count() or 1
    engine = compile_arcs(landing_rhs(), columns=6)
    pruned = prune(landing_rhs(), [0, 2, 3], fixed={6: 0.0})
    few = np.zeros((len(pruned.kept), 3))
    few[[pruned.kept.index(i) for i in (5, 7, 8)], range(3)] = 1.0
    small = compile_arcs(pruned.rhs, columns=few != 0)
    peak = fma_peak()
    print(f"{native.host_processor()[1]}, {cores} cores, measured FMA peak of one core {peak / 1e9:.1f} Gflop/s")
    for name, e, args in (
        ("six columns", engine, (starts, PARAMETERS, DURATION, seeds)),
        ("pruned, three columns", small, (starts[:, pruned.kept], PARAMETERS, DURATION, few)),
    ):
        e.propagate(*args)
        for tolerance in (1e-12, 1e-15):

            def fly(e: Any = e, args: Any = args, tolerance: float = tolerance) -> Any:
                return e.propagate(*args, rtol=tolerance, atol=tolerance)

            clock, processor, arcs = best(fly)
            share = asked.lanes / processor * arcs.steps.mean() * flops_per_step(e.system) / peak
            print(
                f"{name:22s} {tolerance:.0e}: {asked.lanes / clock:8.0f} arcs/s by the clock, "
                f"{asked.lanes / processor:8.0f} per core second, {arcs.steps.mean():.2f} steps, "
                f"{share:.0%} of the FMA peak, all reached: {bool(arcs.succeeded.all())}"
            )
    fine = engine.propagate(starts[:64], PARAMETERS, DURATION, rtol=1e-15, atol=1e-15)
    coarse = engine.propagate(starts[:64], PARAMETERS, DURATION)
    print(f"achieved error at 1e-12 against 1e-15: {np.abs(fine.z - coarse.z).max():.1e}")
    if not asked.without_heyoka:
        lanes = min(asked.lanes, 512)
        run = heyoka_batch(lanes, starts[:lanes], seeds[:lanes])
        for batch in (4, 8):
            rate, ends = run(batch)
            print(
                f"heyoka, batch {batch}, 1e-12: {rate:8.0f} arcs per core second; "
                f"its error {np.abs(ends[:64] - fine.z[: len(ends[:64])]).max():.1e}"
            )


if __name__ == "__main__":
    main()
