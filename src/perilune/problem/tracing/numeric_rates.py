"""The state equations of a problem in numbers, for simulation by the user's own program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.core import Matrix, PeriluneError, Vector, check_call, require_numbers, unknown_name

if TYPE_CHECKING:
    from perilune.problem.phase import Phase


class SimulatedProblem:
    """The functions by which a problem is flown from outside."""

    @check_call
    def rates(
        self: Any,
        x: Any,
        u: Any = (),
        t: Any = 0.0,
        *,
        phase: str | int | None = None,
        free: Mapping[str, float] | None = None,
    ) -> Vector | Matrix:
        """Return the rates x' = f(x, u, p) of the states of a phase, as its dynamics state them.

        Parameters
        ----------
        x
            State in SI, in the order of ``phase.states``: shape (states,), or (states, n) for n of them at once.
        u
            Control in SI, in the order of ``phase.control_names``: shape (components,), or (components, n). A
            `UnitVectorControl` is a unit vector, and taken as it is; a throttle is not cut at its bounds.
        t
            Time [s]. Dynamics depend on it only through x and u: it is there so that a simulator may pass its own.
        phase
            Name or number of the phase, where there are several.
        free
            Values [SI] of free parameters, as ``solution.free``, where the dynamics depend on them.

        Returns
        -------
        ndarray
            Rates in SI per second, of the shape of x (or as many columns as u has, where x has one).

        Raises
        ------
        PeriluneError
            If there is no such phase or free parameter, x or u has another number of components, the dynamics need
            a free parameter that is not passed, or a rate is not finite, as at a mass of 0.
        """
        stated = self.phases[_number_of(self, phase)]
        state = _components(x, stated.state_names, f"the state of {stated.name}")
        control = _components(u, stated.control_names, f"the control of {stated.name}")
        require_numbers(t, "a time [s]")
        passed = {} if free is None else free
        if isinstance(passed, Mapping) and (strange := set(passed) - set(self.free_names)):
            raise unknown_name("free parameter", min(strange, key=str), list(self.free_names))
        shape = _common_shape(state, control)
        try:
            with np.errstate(all="ignore"):
                found = stated.rates(list(state), list(control), self.parameters(passed))
        except AttributeError as error:
            if error.name not in self.free_names:
                raise
            raise PeriluneError(
                f"the dynamics of {stated.name} depend on the free parameter {error.name}", got="no value given",
                expected="a value of each that the dynamics take", advice="problem.rates(x, u, free=solution.free)",
            ) from None  # fmt: skip
        rates = np.array([np.broadcast_to(np.asarray(rate, dtype=float), shape) for rate in found])
        _refuse_infinite(stated, rates, state, control)
        return rates


def _common_shape(state: Any, control: Any) -> tuple[int, ...]:
    """Return the shape of points at which states and controls are given together."""
    try:
        return np.broadcast_shapes(state.shape[1:], control.shape[1:])
    except ValueError:
        got = f"{state.shape[1]} states and {control.shape[1]} controls"
        expected = "one control for each state, or one for all"
        raise PeriluneError("the numbers of states and controls differ", got=got, expected=expected) from None


def _number_of(problem: Any, phase: str | int | None) -> int:
    """Return the place of a phase that is named, numbered, or the only one."""
    names = [stated.name for stated in problem.phases]
    if phase is None:
        if len(names) > 1:
            raise PeriluneError(
                f"{problem.name} has several phases", got="no phase", expected="one of " + ", ".join(names),
                advice=f'problem.rates(x, u, phase="{names[0]}")',
            )  # fmt: skip
        return 0
    if isinstance(phase, str) and names.count(phase) == 1:
        return names.index(phase)
    if isinstance(phase, int | np.integer) and not isinstance(phase, bool) and 0 <= phase < len(names):
        return int(phase)
    if names.count(str(phase)) > 1:
        raise PeriluneError(
            "several phases have this name", got=str(phase), expected=f"a number from 0 to {len(names) - 1}"
        )
    raise unknown_name("phase", phase, names)


def _components(values: Any, names: Sequence[str], what: str) -> Matrix:
    """Return the values as numbers, one row for each name."""
    found = require_numbers(values, what, most=2) if len(names) or np.size(values) else np.empty(0)
    found = np.asarray(found, dtype=float)
    if found.ndim == 0 or len(found) != len(names):
        raise PeriluneError(
            f"this is not {what}", got=f"an array of shape {found.shape}" if found.ndim else "one number",
            expected=f"{len(names)} components: {', '.join(names) or 'none'}",
        )  # fmt: skip
    return found


def _refuse_infinite(stated: Phase, rates: Matrix, state: Matrix, control: Matrix) -> None:
    """Refuse rates that are no numbers, with the state and the control at which they are none."""
    bad = ~np.isfinite(rates)
    if not bad.any():
        return
    row, *column = (int(k) for k in np.argwhere(bad)[0])
    named = zip((*stated.state_names, *stated.control_names), (*state, *control), strict=True)
    at = [f"{name} = {np.broadcast_to(values, rates.shape[1:])[tuple(column)]:g}" for name, values in named]
    raise PeriluneError(
        f"the rate of {stated.state_names[row]} in {stated.name} is not finite", got=", ".join(at),
        expected="a state and a control at which the dynamics are defined, such as a mass above 0",
        advice="end the simulation before this state",
    )  # fmt: skip
