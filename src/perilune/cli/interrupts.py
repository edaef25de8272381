"""Handling of Ctrl-C, so that none is lost; time limits are in `perilune.core.callbacks`."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, current_thread, main_thread
from typing import NoReturn

#: Set when the user stopped the program: who wraps foreign code may clear its exception with others.
STOPPED = Event()


def handle_interrupt(*_: object) -> NoReturn:
    """Raise KeyboardInterrupt, without warnings of what an interrupted import or file leaves open."""
    sys.unraisablehook = _raise_deferred_interrupt
    STOPPED.set()
    raise KeyboardInterrupt


def raise_pending_interrupt() -> None:
    """Raise a Ctrl-C that a computation may have lost, or taken for a fault, before an answer is made of it."""
    if STOPPED.is_set():
        raise KeyboardInterrupt


@contextmanager
def defer_interrupt() -> Iterator[None]:
    """Defer Ctrl-C until the block, which stores results, has ended."""
    if current_thread() is not main_thread():
        yield
        return
    pressed = Event()
    before = signal.signal(signal.SIGINT, lambda *_: pressed.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed.is_set():
        handle_interrupt()


@contextmanager
def advise_on_interrupt(advice: Callable[[], str]) -> Iterator[None]:
    """Add advice to Ctrl-C, or to an error that foreign code made of it; none if the advice is empty."""
    try:
        yield
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or STOPPED.is_set():
            raise KeyboardInterrupt(advice()) from None
        raise


def _raise_deferred_interrupt(ignored: sys.UnraisableHookArgs) -> None:
    """Raise Ctrl-C again if the first met a destructor, which lets no exception out."""
    if ignored.exc_type is KeyboardInterrupt:
        from _thread import interrupt_main
        from threading import Timer

        Timer(0.01, interrupt_main).start()
