"""Methods: frozen records of settings with ``run(problem, guess, callback) -> Solution``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.methods.binding_limit import with_binding_limit
    from perilune.methods.direct.pseudospectral import Pseudospectral
    from perilune.methods.evolutionary.fitness import ControlFitness
    from perilune.methods.evolutionary.genetic import Genetic
    from perilune.methods.evolutionary.hybrid import Hybrid
    from perilune.methods.indirect.continuation.parameter_scan import ExtremalRoot
    from perilune.methods.indirect.indirect import Indirect
    from perilune.methods.indirect.neighboring import Nearby
    from perilune.methods.indirect.random_costates import SIGNED
    from perilune.methods.indirect.result import Curves, compose_solution
    from perilune.methods.indirect.search import Search
    from perilune.methods.indirect.violations import solution_violations
    from perilune.methods.method import Method
    from perilune.methods.polish import solve_and_polish

__all__ = [
    "SIGNED",
    "ControlFitness",
    "Curves",
    "ExtremalRoot",
    "Genetic",
    "Hybrid",
    "Indirect",
    "Method",
    "Nearby",
    "Pseudospectral",
    "Search",
    "compose_solution",
    "solution_violations",
    "solve_and_polish",
    "with_binding_limit",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "binding_limit": "with_binding_limit",
        "direct.pseudospectral": "Pseudospectral",
        "evolutionary.fitness": "ControlFitness",
        "evolutionary.genetic": "Genetic",
        "evolutionary.hybrid": "Hybrid",
        "indirect.continuation.parameter_scan": "ExtremalRoot",
        "indirect.indirect": "Indirect",
        "indirect.neighboring": "Nearby",
        "indirect.random_costates": "SIGNED",
        "indirect.result": "Curves compose_solution",
        "indirect.search": "Search",
        "indirect.violations": "solution_violations",
        "method": "Method",
        "polish": "solve_and_polish",
    },
)
