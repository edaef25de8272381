"""What is known of a problem and from where, as data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from perilune import Indirect, Pseudospectral
from perilune.problem import Problem

Method = Indirect | Pseudospectral


@dataclass(frozen=True, kw_only=True, eq=False)
class Answered:
    """A problem with its answer.

    Parameters
    ----------
    name
        Of the record.
    make
        Returns the problem.
    objective
        J of the optimum, SI.
    source
        Where it is known from.
    uncertainty
        Of `objective`: half a unit of the last digit of the source, 0 for a closed form; SI.
    costate
        lambda(0) of the first phase, SI, where it is known.
    free
        Optimal free parameters, SI, as far as they are known.
    switches
        Times at which a control of the first phase jumps [s], as far as they are known.
    truth
        Computes `objective` from a closed form, where there is one.
    methods
        The methods that must solve it from nothing, in the settings that it needs.
    refused
        Methods that cannot, with what their refusal must say (a regular expression).
    mesh_gain
        How many times the relative error of J may exceed the mesh accuracy: 1, unless the source says why.
    """

    name: str
    make: Callable[[], Problem]
    objective: float
    source: str
    uncertainty: float = 0.0
    costate: tuple[float, ...] | None = None
    free: Mapping[str, float] = field(default_factory=dict)
    switches: tuple[float, ...] = ()
    truth: Callable[[], float] | None = None
    methods: tuple[Method, ...] = (Indirect(), Pseudospectral())
    refused: tuple[tuple[Method, str], ...] = ()
    mesh_gain: float = 1.0

    def error_allowed(self, method: Method) -> float:
        """Largest error of J, SI: 1e-8 relative, or the accuracy asked of the mesh."""
        scale = self.make().scales.of(self.make().objective_unit)
        if isinstance(method, Pseudospectral):
            allowed = self.mesh_gain * method.tolerance * (scale + abs(self.objective))
        else:
            allowed = 1e-8 * abs(self.objective)
        return max(allowed, self.uncertainty)
