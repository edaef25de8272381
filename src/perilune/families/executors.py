"""Calls on any executor, in any order: those of a process pool, or of a Dask client."""

from __future__ import annotations

import os
import signal
from collections.abc import Hashable, Iterator
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import parent_process
from multiprocessing.connection import wait
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Protocol, TypeVar, runtime_checkable

from perilune.core import PeriluneError, wrong_type_error

Name = TypeVar("Name", bound=Hashable)
Call = tuple[Any, ...]  # a function and its arguments
_AHEAD = 1000  # calls handed to an executor before the first of them is back
_PATIENCE = 0.2  # seconds between looks whether the user pressed Ctrl-C


class Submits(Protocol):
    """Common protocol of a `concurrent.futures.Executor` and a Dask client."""

    def submit(self, function: Any, /, *arguments: Any) -> Any:
        """Begin a call; what is returned has ``result``, ``cancel`` and ``add_done_callback``."""


def require_executor(executor: Submits | None) -> None:
    """Refuse what cannot take calls.

    Raises
    ------
    PeriluneError
        If it has no method `submit`.
    """
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise wrong_type_error(
            executor, "a concurrent.futures.Executor, a Dask client or None", "an executor for the members"
        )


@runtime_checkable
class Waits(Protocol):
    """Executor that knows why no result may come back."""

    def waited(self) -> None:
        """Called again and again while nothing comes back."""


def run_calls(
    executor: Submits | None, calls: Iterator[tuple[Name, Call]], ahead: int = _AHEAD
) -> Iterator[tuple[Name, Any]]:
    """Yield the name and result of each call: here one after the other without an executor, else as completed.

    Parameters
    ----------
    executor
        Makes the calls, if any does.
    calls
        Name of each call, and its function with arguments.
    ahead
        Number of calls in progress at once.

    Raises
    ------
    PeriluneError
        If a worker was lost.
    """
    if executor is None:
        for name, (function, *arguments) in calls:
            yield name, function(*arguments)
        return
    try:
        yield from _run_on_executor(executor, calls, ahead)
    except BrokenExecutor as error:
        raise PeriluneError(
            "a worker, or the connection to it, was lost",
            got=f"{type(error).__name__}: {error}",
            advice="finished members are kept if they were stored (--out DIR): run again with --resume",
        ) from error


def _run_on_executor(executor: Submits, calls: Iterator[tuple[Name, Call]], ahead: int) -> Iterator[tuple[Name, Any]]:
    begun: dict[Name, Any] = {}
    back: SimpleQueue[Name] = SimpleQueue()
    try:
        while True:
            while len(begun) < ahead and (call := next(calls, None)) is not None:
                name, (function, *arguments) = call
                begun[name] = executor.submit(function, *arguments)
                begun[name].add_done_callback(lambda _, name=name: back.put(name))
            if not begun:
                return
            try:
                name = back.get(timeout=_PATIENCE)
            except Empty:
                if isinstance(executor, Waits):
                    executor.waited()
                continue
            yield name, begun.pop(name).result()
    finally:
        for future in begun.values():
            future.cancel()


def begin_processes(executor: Submits | None, call: Call) -> None:
    """Start the processes of a pool ahead of the work, each with a call that prepares it.

    Parameters
    ----------
    executor
        Pool whose processes are started; nothing is done for any other.
    call
        Function and its arguments.
    """
    if isinstance(executor, ProcessPoolExecutor):  # threads are there, and a cluster's workers as well
        with suppress(BrokenExecutor):  # who wants an answer is told
            for _ in range(os.cpu_count() or 1):
                executor.submit(*call)


@contextmanager
def ignore_interrupt_in_children() -> Iterator[None]:
    """Let processes that begin in the block ignore Ctrl-C, which the terminal sends to all; the program ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent() -> None:
    """End this process of a pool when its program is killed; holding both ends of its queue it would wait forever."""
    parent = parent_process()
    assert parent is not None, "of a process of a pool"

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    Thread(target=watch, daemon=True).start()
