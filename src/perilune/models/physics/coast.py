"""Coast before ignition: the start is stated, and the place at which the engine lights is chosen.

Stating the longest fall (``longest_coast`` of a start) puts a phase without thrust before the burn. Its length
`coast_time` is a free parameter, so that it is chosen as every other: H = 0 along the fall as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

from perilune.core import Physics, quantity
from perilune.problem import Conditions, FreeParameter, Phase, Quantities, Variable, named_variables

SHORTEST = 1e-3  # s: a curve has a length; the landed mass does not feel it
LONGEST: Any = quantity(
    "s", "900 s", default=None, above=SHORTEST,
    about="longest free fall before ignition, whose length is then optimised; default: ignition at the start",
)  # fmt: skip
COAST_TIME = Variable(name="coast_time", unit="s", description="free fall before ignition")
FREE = FreeParameter(name="coast_time", unit="s")


def coast_range(longest: float) -> tuple[float, float, float]:
    """Bounds and order of magnitude of `coast_time`."""
    return SHORTEST, longest, 0.5 * longest


def with_coast(burn: Phase, path: Physics, kept: Mapping[str, tuple[str, ...]]) -> tuple[Phase, Phase]:
    """The fall and the burn.

    Parameters
    ----------
    burn
        The phase that begins at ignition; its functions are asked with every control 0.
    path
        Values of the path conditions that hold without thrust as well.
    kept
        Names of these (``path``), and of the outputs that mean something then (``outputs``).
    """

    def off(function: Physics) -> Physics:
        return partial(_engine_off, function=function, names=burn.control_names)

    conditions, outputs = (
        tuple(v for v in named_variables(getattr(burn, name)) if v.name in kept[name]) for name in ("path", "outputs")
    )
    places = [k for k, v in enumerate(burn.output_variables) if v in outputs]
    fall = replace(
        burn,
        name="coast",
        controls=(),
        dynamics=off(burn.dynamics),
        duration=FREE.name,
        end=None,
        path=Conditions.of(path, conditions),
        outputs=Quantities.of(
            burn.outputs and partial(_select_values, function=off(burn.outputs.function), places=places), outputs
        ),
        integrals=burn.integrals and burn.integrals.with_function(off(burn.integrals.function)),
        inertial=burn.inertial and off(burn.inertial),
        end_guess=None,
    )
    return fall, burn


def at_ignition(x: Any, p: Any, xp: Any) -> Sequence[Any]:
    """The burn begins where the fall ends.

    Parameters
    ----------
    x
        State at the end of the fall [SI].
    p, xp
        Parameters [SI] and maths namespace.

    Returns
    -------
    Sequence[Any]
        State with which the burn begins [SI].
    """
    return tuple(x)


def _engine_off(x: Any, u: Any, *rest: Any, function: Physics, names: Sequence[str]) -> Sequence[Any]:
    """A function of (x, u, p, xp) or (x, u, t, p, xp) with the engine off."""
    return function(x, SimpleNamespace(**{**dict.fromkeys(names, 0.0), "throttle": 0.0}), *rest)


def _select_values(x: Any, u: Any, p: Any, xp: Any, *, function: Any, places: Sequence[int]) -> Sequence[Any]:
    values = function(x, u, p, xp)
    return [values[k] for k in places]
