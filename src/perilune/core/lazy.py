"""Lazy sequences, made on first access."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any


class Deferred(Sequence[Any]):
    """Sequence made on first access; the trajectories of most members of a table never are.

    Parameters
    ----------
    count
        Number of entries; None if it is not known before.
    make
        Makes them.
    """

    def __init__(self, count: int | None, make: Callable[[], tuple[Any, ...]]) -> None:
        self._count, self._make = count, make
        self._made: tuple[Any, ...] | None = None

    @property
    def made(self) -> bool:
        """Return True if it was made."""
        return self._made is not None

    def __len__(self) -> int:
        return len(self[:]) if self._count is None else self._count

    def __getitem__(self, index: Any) -> Any:
        if self._made is None:
            self._made = self._make()
        return self._made[index]

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, (tuple, Deferred)) and tuple(self) == tuple(other))

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return repr(tuple(self))

    def __iter__(self) -> Iterator[Any]:
        return iter(self[:])  # an IndexError while they are made is a fault, and not the end of a sequence
