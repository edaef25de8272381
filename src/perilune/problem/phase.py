"""One phase of a flight: states, controls and the functions that hold along it and at its end."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, get_args

import numpy as np

from perilune.core.arrays import Physics, Vector
from perilune.core.deprecation import RenamedAttribute, renamed_keywords
from perilune.core.maths import NUMERIC
from perilune.core.validation import check_call, require_row
from perilune.problem.controls import Control
from perilune.problem.display.reprs import ShownPhase
from perilune.problem.variables import Variable

_ROWS = (
    "states", "end_conditions", "path_conditions", "held_conditions",
    "output_variables", "integral_variables", "end_output_variables",
)  # fmt: skip


@renamed_keywords(marks="end_outputs", mark_variables="end_output_variables", typical_end="end_guess")
@check_call
@dataclass(frozen=True, kw_only=True, repr=False)
class Phase(ShownPhase):
    """One arc with smooth dynamics.

    Parameters
    ----------
    name
        Name of the phase.
    states, controls
        Components of x and u in order.
    dynamics
        ``dynamics(x, u, p, xp)`` returns the rates of all states.
    duration
        Name of the parameter (given or free) that is the length of the phase in seconds.
    end, end_conditions
        ``end(x, p, xp)`` returns residuals that vanish at the end of the phase, one for each named condition; one whose
        condition has bounds has to lie between them instead.
    path, path_conditions
        ``path(x, u, p, xp)`` returns values that must not be negative on the phase.
    held, held_conditions
        ``held(x, u, p, xp)`` returns values that vanish all along the phase: they say what the control does there, such
        as to follow a glide slope. As many components of the control as there are values have to act in them.
    outputs, output_variables
        ``outputs(x, u, p, xp)`` returns further quantities of interest (altitude, steering angle) for tables.
    integrals, integral_variables
        ``integrals(x, u, p, xp)`` returns rates; their integrals along the flight are results, named with the unit of
        the integral (delta-v spent, gravity loss). Phases that name the same one add to it.
    end_outputs, end_output_variables
        ``end_outputs(x, p, xp)`` of the end state of the phase returns further results (speed where the air begins).
    inertial
        ``inertial(x, u, t, p, xp)`` returns nine values in inertial axes with the body at their origin, t seconds after
        the begin of the flight: position [m], velocity [m/s], acceleration by thrust [m/s^2]. `Views.frame` says which.
    track
        ``track(x, p, xp)`` returns how far the flight has come along its way, how far to the left of it, how high, and
        where `Views.floor` names one, the least height there [m].
    end_guess
        ``end_guess(p, xp)`` returns a rough end state; only its order matters (a direct method starts there).
    """

    name: str
    states: tuple[Variable, ...]
    controls: tuple[Control, ...] = ()
    dynamics: Physics
    duration: str
    end: Physics | None = None
    end_conditions: tuple[Variable, ...] = ()
    path: Physics | None = None
    path_conditions: tuple[Variable, ...] = ()
    held: Physics | None = None
    held_conditions: tuple[Variable, ...] = ()
    outputs: Physics | None = None
    output_variables: tuple[Variable, ...] = ()
    integrals: Physics | None = None
    integral_variables: tuple[Variable, ...] = ()
    end_outputs: Physics | None = None
    end_output_variables: tuple[Variable, ...] = ()
    inertial: Physics | None = None
    track: Physics | None = None
    end_guess: Physics | None = None
    marks = RenamedAttribute("end_outputs")
    mark_variables = RenamedAttribute("end_output_variables")
    typical_end = RenamedAttribute("end_guess")

    def __post_init__(self) -> None:
        require_row(self.controls, "controls", *get_args(Control))
        for row in _ROWS:
            require_row(getattr(self, row), row.replace("_", " "), Variable)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(s.name for s in self.states)

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the control components, in order."""
        return tuple(name for control in self.controls for name in control.names)

    @property
    def sized(self) -> tuple[Variable, ...]:
        """Return the variables that methods compute with in canonical units: states and conditions."""
        return (*self.states, *self.end_conditions, *self.path_conditions, *self.held_conditions)

    @cached_property
    def state_record(self) -> Callable[..., Any]:
        """Record type of x."""
        return namedtuple("State", self.state_names)

    @cached_property
    def control_record(self) -> Callable[..., Any]:
        """Record type of u."""
        return namedtuple("Control", self.control_names)

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}  # record types are created again on arrival

    def rates(self, x: Any, u: Any, p: Any, xp: Any = NUMERIC) -> Sequence[Any]:
        """Return the rates of the states for plain sequences x and u (each component may itself be an array).

        Parameters
        ----------
        x, u
            State, (states, ...), and control, (components, ...), SI or canonical.
        p, xp
            Parameters in the same units, and maths namespace.
        """
        return self.dynamics(self.state_record(*x), self.control_record(*u), p, xp)

    def evaluate(self, function: str, x: Any, u: Any, p: Any, xp: Any = NUMERIC) -> Sequence[Any]:
        """Evaluate ``path``, ``held``, ``outputs``, ``integrals``; without control ``end``, ``end_outputs``, ``track``.

        Empty where the phase has none.

        Parameters
        ----------
        function
            Name of the field.
        x, u
            State, (states, ...), and control, (components, ...), SI or canonical.
        p, xp
            Parameters in the same units, and maths namespace.
        """
        physics = getattr(self, function)
        if physics is None:
            return ()
        control = () if function in ("end", "end_outputs", "track") else (self.control_record(*u),)
        return physics(self.state_record(*x), *control, p, xp)

    def path_along(self, x: Any, u: Any, p: Any) -> Iterator[tuple[Variable, Vector]]:
        """Yield each condition of the path with its values [SI] along x, (states, n), and u, (components, n).

        Parameters
        ----------
        x, u
            State and control [SI].
        p
            Parameters [SI].
        """
        values = self.evaluate("path", list(x), list(u), p)
        for condition, along in zip(self.path_conditions, values, strict=True):
            yield condition, np.broadcast_to(np.asarray(along, dtype=float), np.shape(x)[1:])

    def seen_inertially(self, x: Any, u: Any, t: Any, p: Any, xp: Any = NUMERIC) -> Sequence[Any]:
        """Return the values of ``inertial``; empty where the phase has none.

        Parameters
        ----------
        x, u
            State, (states, ...), and control, (components, ...), SI or canonical.
        t
            Time from the begin of the flight, in the same units.
        p, xp
            Parameters in the same units, and maths namespace.
        """
        if self.inertial is None:
            return ()
        return self.inertial(self.state_record(*x), self.control_record(*u), t, p, xp)
