"""The methods by the names that the command line gives them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.words.outcome import unknown_name

if TYPE_CHECKING:
    from perilune.methods.method import Method

NAMES = ("indirect", "direct", "hybrid")


def method_of(name: str) -> Method:
    """The method of a name, with its default settings.

    Raises
    ------
    PeriluneError
        If there is none.
    """
    if name not in NAMES:
        raise unknown_name("method", name, list(NAMES))
    if name == "indirect":
        from perilune.methods.indirect import Indirect

        return Indirect()
    from perilune.methods.pseudospectral import Pseudospectral

    if name == "direct":
        return Pseudospectral()
    from perilune.methods.genetic import Genetic
    from perilune.methods.hybrid import Hybrid

    return Hybrid(Genetic(), Pseudospectral())
