"""Ctrl-C, which is not to be lost wherever it is met."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, current_thread, main_thread
from typing import NoReturn

#: Set when the user stopped the program: who wraps foreign code may clear its exception with others.
STOPPED = Event()


def stop(*_: object) -> NoReturn:
    """Ctrl-C: what an import or a file leaves open when it is cut short is no news for who asked for it."""
    sys.unraisablehook = _again
    STOPPED.set()
    raise KeyboardInterrupt


def heed() -> None:
    """Ctrl-C, where what was computed may have lost it, or taken it for a fault: before an answer is made of that."""
    if STOPPED.is_set():
        raise KeyboardInterrupt


@contextmanager
def put_off() -> Iterator[None]:
    """Ctrl-C waits until the block has ended, which puts what was computed where it is kept."""
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
        stop()


@contextmanager
def advised(advice: Callable[[], str]) -> Iterator[None]:
    """Ctrl-C, or what foreign code made of it, with words on what may be done then; none where these are empty."""
    try:
        yield
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or STOPPED.is_set():
            raise KeyboardInterrupt(advice()) from None
        raise


def _again(ignored: sys.UnraisableHookArgs) -> None:
    """Ctrl-C once more where the first met a destructor, which lets no exception out."""
    if ignored.exc_type is KeyboardInterrupt:
        from _thread import interrupt_main
        from threading import Timer

        Timer(0.01, interrupt_main).start()
