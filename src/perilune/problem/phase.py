"""One phase of a flight: states, controls and the functions that hold along it and at its end."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar, get_args

import numpy as np

from perilune.core import NUMERIC, Physics, RenamedAttribute, Vector, check_call, renamed_keywords, require_row
from perilune.problem.controls import Control
from perilune.problem.display.reprs import ShownPhase
from perilune.problem.named_values import PAIRS, Conditions, Quantities, accept_pairs, named_variables, require_named
from perilune.problem.variables import Variable

_NAMED = ("end", "path", "held", "outputs", "integrals", "end_outputs")


@renamed_keywords(marks="end_outputs", typical_end="end_guess")
@accept_pairs(*_NAMED)
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
    end
        `Conditions` of ``end(x, p, xp)``, residuals that vanish at the end of the phase; one whose condition has bounds
        has to lie between them instead.
    path
        `Conditions` of ``path(x, u, p, xp)``, values that must not be negative on the phase.
    held
        `Conditions` of ``held(x, u, p, xp)``, values that vanish all along the phase: they say what the control does
        there, such as to follow a glide slope. As many components of the control as there are values have to act in
        them.
    outputs
        `Quantities` of ``outputs(x, u, p, xp)``, further values of interest (altitude, steering angle) for tables.
    integrals
        `Quantities` of ``integrals(x, u, p, xp)``, rates; their integrals along the flight are results, named with the
        unit of the integral (delta-v spent, gravity loss). Phases that name the same one add to it.
    end_outputs
        `Quantities` of ``end_outputs(x, p, xp)`` of the end state, further results (speed where the air begins).
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
    end: Conditions | None = None
    path: Conditions | None = None
    held: Conditions | None = None
    outputs: Quantities | None = None
    integrals: Quantities | None = None
    end_outputs: Quantities | None = None
    inertial: Physics | None = None
    track: Physics | None = None
    end_guess: Physics | None = None
    marks: ClassVar[RenamedAttribute] = RenamedAttribute("end_outputs")
    mark_variables: ClassVar[RenamedAttribute] = RenamedAttribute("end_output_variables")
    typical_end: ClassVar[RenamedAttribute] = RenamedAttribute("end_guess")

    def __post_init__(self) -> None:
        require_row(self.controls, "controls", *get_args(Control))
        require_row(self.states, "states", Variable)
        for name in _NAMED:
            require_named(getattr(self, name), PAIRS[name][1], f"a valid value of `{name}` of a phase")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states, in order."""
        return tuple(s.name for s in self.states)

    @property
    def control_names(self) -> tuple[str, ...]:
        """Names of the control components, in order."""
        return tuple(name for control in self.controls for name in control.names)

    @property
    def end_conditions(self) -> tuple[Variable, ...]:
        """Conditions of `end`, in order."""
        return named_variables(self.end)

    @property
    def path_conditions(self) -> tuple[Variable, ...]:
        """Conditions of `path`, in order."""
        return named_variables(self.path)

    @property
    def held_conditions(self) -> tuple[Variable, ...]:
        """Conditions of `held`, in order."""
        return named_variables(self.held)

    @property
    def output_variables(self) -> tuple[Variable, ...]:
        """Quantities of `outputs`, in order."""
        return named_variables(self.outputs)

    @property
    def integral_variables(self) -> tuple[Variable, ...]:
        """Quantities of `integrals`, in order."""
        return named_variables(self.integrals)

    @property
    def end_output_variables(self) -> tuple[Variable, ...]:
        """Quantities of `end_outputs`, in order."""
        return named_variables(self.end_outputs)

    def with_functions(self, functions: Mapping[str, Physics | None]) -> Phase:
        """Return the phase with other functions for the same conditions and quantities.

        Parameters
        ----------
        functions
            By field; a field of named values whose function is None is left out.
        """
        changes: dict[str, Any] = dict(functions)
        for name in (name for name in _NAMED if changes.get(name) is not None):
            changes[name] = PAIRS[name][1](changes[name], *named_variables(getattr(self, name)))
        return replace(self, **changes)

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
