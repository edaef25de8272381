"""Worker process for long computations of the explorer, one after the other, and threads for answers.

Neither outlives the program.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import active_children, get_context
from threading import Thread
from typing import Any, TypeVar

from perilune import PeriluneError
from perilune.core import Iteration
from perilune.families import end_with_parent, ignore_interrupt_in_children

_GRACE = 2.0  # s that work for which nobody waits may go on when other work comes, before its process is ended
_TRIES = 2  # of work whose process is killed
_T = TypeVar("_T")


class SupersededWork(BaseException):
    """End of work for which nobody waits; no `Exception`, which a method would try to recover from."""


class WorkerKilled(PeriluneError):
    """Failure of work whose process was killed at each attempt."""


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


class WorkerProcess:
    """Process that does one piece of work after the other; a killed one is started again."""

    def __init__(self) -> None:
        self._context = get_context("spawn")
        self._wanted = self._context.RawValue("q", 0)  # the number of the work that somebody waits for
        self._pool: ProcessPoolExecutor | None = None
        self._one = asyncio.Lock()
        self._left: asyncio.Future[Any] | None = None
        self.killed = 0

    async def done(self, work: Callable[..., _T], *arguments: Any, begun: Callable[[], None] | None = None) -> _T:
        """``work(*arguments, watch)`` in the process. If it is cancelled, the watch ends it at its next line.

        `begun` is called when it begins, as work for others may go before it.

        Parameters
        ----------
        work
            Function that can be pickled; the watch is its last argument.
        *arguments
            Its other arguments.
        begun
            Called without arguments.

        Raises
        ------
        Killed
            If the process is killed each time; else what the work raises.
        """
        async with self._one:
            if self._left is not None:
                ended, _ = await asyncio.wait([self._left], timeout=_GRACE)
                if not ended:
                    self._end()
                self._left = None
            if begun is not None:
                begun()
            for _ in range(_TRIES):
                try:
                    return await self._tried(work, *arguments)
                except BrokenExecutor:
                    self.killed += 1
                    self._end()
            raise WorkerKilled("the process that compares and proves was killed each time it worked on this flight")

    async def _tried(self, work: Callable[..., _T], *arguments: Any) -> _T:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, self._context, _initialize_worker, (self._wanted,))
        self._wanted.value += 1
        with ignore_interrupt_in_children():  # the process begins with what is handed to it first
            number, loop = self._wanted.value, asyncio.get_running_loop()
            running = loop.run_in_executor(self._pool, _run_in_worker, number, work, *arguments)
        running.add_done_callback(lambda done: done.cancelled() or done.exception())  # also if nobody asks
        try:
            await asyncio.wait([running])
        except asyncio.CancelledError:
            self._wanted.value += 1
            self._left = running
            raise
        return running.result()

    def close(self) -> None:
        """End the process, even in the middle of its work."""
        self._end()

    def _end(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            for child in active_children():
                child.terminate()
            self._pool = None


_number: Any = None  # in the process: that of the work that somebody waits for


def _initialize_worker(wanted: Any) -> None:
    """Initialise the process: share the number of the wanted work, and end with a killed program."""
    global _number
    _number = wanted
    end_with_parent()


def _run_in_worker(number: int, work: Callable[..., _T], *arguments: Any) -> _T:
    def watch(event: Iteration | str) -> None:
        if _number.value != number:
            raise SupersededWork

    watch("")
    return work(*arguments, watch)
