"""Proofs while nothing is dragged, in a process of their own, so that they never hold up a frame."""

from __future__ import annotations

import asyncio
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from perilune.app.frames import proof
from perilune.problem.solution import Solution

LEVEL = 3


class Prover:
    """Proves one solution after the other."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    async def proved(self, solution: Solution) -> dict[str, Any]:
        """The proof of a solution: its checks, whether it is proved, and how long that took."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
        return await asyncio.get_running_loop().run_in_executor(self._pool, _proved, solution)

    def close(self) -> None:
        """End it."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)


def _proved(solution: Solution) -> dict[str, Any]:
    import time

    from perilune.solve import prove

    began = time.perf_counter()
    found = prove(solution, LEVEL)
    outcome, level = found.outcome.name, found.verification.level
    return {"outcome": outcome, "level": level, "proof": proof(found.verification), "took": time.perf_counter() - began}
