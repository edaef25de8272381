"""Calls on the machines of a cluster, by Dask distributed, which the extra ``cluster`` installs.

A worker that dies is no loss: its calls go to others, and what they return is the same to the last bit. Only if the
scheduler is gone, or a call has cost several workers, there is an error.

Source: M. Rocklin, *Dask: parallel computation with blocked algorithms and task scheduling*, Proc. 14th Python in
Science Conference 2015, 126-132.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import contextmanager, suppress
from socket import create_connection
from typing import Any

from perilune.core import PeriluneError, ignore_events

_PATIENCE = 10  # seconds, for a scheduler that does not answer
_LOOK = 5.0  # seconds between looks whether there are workers
_ADDRESS = re.compile(r"((tcp|tls|ws|wss)://)?(?P<host>[\w.-]{1,253}|\[[0-9a-fA-F:]+\]):(?P<port>\d{1,5})", re.ASCII)


class Cluster:
    """Dask client as an executor that `perilune.families.executors.run_calls` takes.

    Parameters
    ----------
    client
        A ``distributed.Client``.
    tell
        Receives a line when there is no worker left that could compute.
    """

    def __init__(self, client: Any, tell: Callable[[str], None] = ignore_events) -> None:
        self.client, self._tell = client, tell
        self._look, self._there = time.monotonic() + _LOOK, True

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> _Future:
        """Begin a call, a new one even if another has the same arguments."""
        return _Future(self.client.submit(function, *arguments, pure=False))

    def waited(self) -> None:
        """Check now and then that there are workers; calls wait for them without limit."""
        if time.monotonic() < self._look:
            return
        before, self._look = self._there, time.monotonic() + _LOOK
        with suppress(OSError):  # a scheduler that is gone gives up its calls
            self._there = bool(self.client.nthreads())
        if before and not self._there:
            self._tell("no worker is available: waiting for a `dask worker`, or for Ctrl-C")


class _Future:
    """Call that was begun; the loss of the cluster raises the same error as that of a process pool."""

    def __init__(self, future: Any) -> None:
        self._future = future

    def result(self) -> Any:
        """Return the result of the call."""
        from distributed import KilledWorker

        try:
            return self._future.result()
        except (KilledWorker, CancelledError) as error:
            raise BrokenExecutor(str(error)[:200] or "the scheduler is no longer reachable") from error

    def cancel(self) -> Any:
        """Cancel the call."""
        return self._future.cancel()

    def add_done_callback(self, called: Callable[[Any], Any]) -> None:
        """Call something when it is done."""
        self._future.add_done_callback(called)


@contextmanager
def cluster(address: str, tell: Callable[[str], None] = ignore_events) -> Iterator[Cluster]:
    """Connect to the cluster of a scheduler for the block.

    Parameters
    ----------
    address
        Of its scheduler: ``tcp://10.0.0.1:8786``.
    tell
        As of `Cluster`.

    Raises
    ------
    PeriluneError
        If Dask is not installed, or nothing answers at the address.
    """
    try:
        from distributed import Client
    except ImportError:
        raise PeriluneError(
            "a scheduler needs Dask distributed, which is not installed", advice="pip install 'perilune[cluster]'"
        ) from None
    _refuse_unreachable_scheduler(address)
    try:
        client = Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise _no_scheduler_error(address, str(error)) from error
    with _reword_connection_errors(), client:
        yield Cluster(client, tell)


@contextmanager
def _reword_connection_errors() -> Iterator[None]:
    """Silence Dask's own log of broken connections for the block; errors here report them."""
    levels = [(log := logging.getLogger(name), log.level) for name in ("distributed", "distributed.client")]
    for log, _ in levels:
        log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for log, level in levels:
            log.setLevel(level)


def _refuse_unreachable_scheduler(address: str) -> None:
    """Refuse an address at which nobody listens, before a client waits for it and reports its own error."""
    found = _ADDRESS.fullmatch(address)
    if found is None:
        raise _no_scheduler_error(address, "no such address")
    try:
        create_connection((found["host"].strip("[]"), int(found["port"])), timeout=_PATIENCE).close()
    except (OSError, OverflowError) as error:
        raise _no_scheduler_error(address, str(error)) from error


def _no_scheduler_error(address: str, why: str) -> PeriluneError:
    return PeriluneError(
        "no scheduler answers", got=f"{address[:80]}: {why[:120]}",
        expected="the address of a running scheduler: tcp://HOST:PORT",
        advice="start one with `dask scheduler`, and `dask worker ADDRESS --nthreads 1` on each machine",
    )  # fmt: skip
