"""What takes long beside the server: proofs in a process, answers in threads; neither outlives the program."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.connection import wait
from threading import Thread
from typing import Any, TypeVar

from perilune.app.frames import proof
from perilune.problem.solution import Solution

LEVEL = 3
_T = TypeVar("_T")


async def in_thread(work: Callable[..., _T], *arguments: Any) -> _T:
    """As `asyncio.to_thread`, but nobody waits for it at the end of the program."""
    loop = asyncio.get_running_loop()
    answer = loop.create_future()

    def told(settle: Callable[[Any], None], value: Any) -> None:
        if not answer.done():  # nor for who has gone
            settle(value)

    def run() -> None:
        try:
            done = answer.set_result, work(*arguments)
        except Exception as error:
            done = answer.set_exception, error
        with suppress(RuntimeError):  # the program has ended
            loop.call_soon_threadsafe(told, *done)

    Thread(target=run, daemon=True).start()
    return await answer


class Prover:
    """Proves one solution after the other."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    async def proved(self, solution: Solution) -> dict[str, Any]:
        """The proof of a solution: its checks, whether it is proved, and how long that took."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_end_with_the_program)
        with _deaf():  # the process begins with what is handed to it first
            proving = asyncio.get_running_loop().run_in_executor(self._pool, _proved, solution)
        return await proving

    def close(self) -> None:
        """End it, in the middle of a proof too."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():
                child.terminate()


@contextmanager
def _deaf() -> Iterator[None]:
    """A process that begins in it does not hear Ctrl-C, which the terminal sends to all: it ends with the program."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_the_program() -> None:
    """Leave nothing behind a program that was killed."""
    parent = parent_process()
    assert parent is not None, "of a process of a pool"

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _proved(solution: Solution) -> dict[str, Any]:
    import time

    from perilune.solve import prove

    began = time.perf_counter()
    found = prove(solution, LEVEL)
    outcome, level = found.outcome.name, found.verification.level
    return {"outcome": outcome, "level": level, "proof": proof(found.verification), "took": time.perf_counter() - began}
