"""Methods by their names on the command line, and the settings that it can change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from perilune import PeriluneError
from perilune.core import unknown_name

if TYPE_CHECKING:
    from perilune.methods import Method

# What each method can be told; of the hybrid the seed is the search's, the others are the direct method's.
SETTINGS: dict[str, tuple[str, ...]] = {
    "indirect": ("starts", "seed"),
    "direct": ("nodes", "tolerance", "polish"),
    "hybrid": ("seed", "nodes", "tolerance"),
}
_TYPED = {"polish": "no-polish"}  # what is typed where that is not the setting's name
NAMES = tuple(SETTINGS)


def method_of(name: str, settings: Mapping[str, Any] | None = None) -> Method:
    """Return the method of a name, with default settings for those that are None.

    Parameters
    ----------
    name
        One of `NAMES`.
    settings
        Values by the names of settings.

    Raises
    ------
    PeriluneError
        If the name, a setting or the value of one is unknown.
    """
    if name not in NAMES:
        raise unknown_name("method", name, list(NAMES))
    chosen = {key: value for key, value in (settings or {}).items() if value is not None}
    for key, value in chosen.items():
        if key not in SETTINGS[name]:
            having = " or ".join(f"--method {other}" for other in NAMES if key in SETTINGS[other])
            raise PeriluneError(
                f"the {name} method has no setting {key}",
                got=f"--{_TYPED.get(key) or f'{key} {value:g}'}",
                expected=", ".join(f"--{_TYPED.get(known, known)}" for known in SETTINGS[name]),
                advice=having,
            )
    if name == "indirect":
        from perilune import Indirect

        return Indirect(**chosen)
    from perilune import Pseudospectral

    if name == "direct":
        return Pseudospectral(**chosen)
    from perilune import Genetic, Hybrid

    seed = {key: chosen.pop(key) for key in ("seed",) if key in chosen}
    return Hybrid(Genetic(**seed), Pseudospectral(**chosen))
