"""Parallel calls of machine code on a pool of kept threads, as a call may take less time than starting a thread."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from typing import Any


def run_in_threads(call: Callable[[int], Any], starts: list[int], threads: int) -> None:
    """Call with each of the starts, the last first; this thread does its share, and all are done when it returns.

    Parameters
    ----------
    call
        Called with one start at a time.
    starts
        Numbers to call with; emptied.
    threads
        Most threads, this one included.
    """

    def share() -> None:
        while starts:
            try:
                start = starts.pop()  # which is atomic
            except IndexError:  # another thread has taken the last
                return
            call(start)

    helpers = [_thread_pool().submit(share) for _ in range(threads - 1)]
    try:
        share()
    finally:
        starts.clear()  # on Ctrl-C: what is at work still writes into arrays of the caller
        wait(helpers)
    for helper in helpers:
        helper.result()


@lru_cache(maxsize=1)
def _thread_pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(os.cpu_count() or 1, "perilune")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_thread_pool.cache_clear)  # threads do not go with a fork
