"""Optimal finite-thrust landing, descent and deorbit trajectories, each answer with its proof."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

TYPE_CHECKING = False  # as checkers know it by its name too: nothing is loaded for it before Ctrl-C can be answered
__version__ = "0.2.0"

# name: module. Loaded on first use, so that `import perilune` costs nothing.
_EXPORTS = {
    "Problem": "perilune.problem.problem",
    "Phase": "perilune.problem.phase",
    "Variable": "perilune.problem.variables",
    "Direction": "perilune.problem.controls",
    "Bounded": "perilune.problem.controls",
    "Given": "perilune.problem.variables",
    "Free": "perilune.problem.variables",
    "Scales": "perilune.words.units",
    "Table": "perilune.words.maths",
    "Finding": "perilune.problem.preflight",
    "Solution": "perilune.problem.solution",
    "Trajectory": "perilune.problem.solution",
    "Curve": "perilune.problem.solution",
    "Result": "perilune.problem.solution",
    "Statistics": "perilune.problem.solution",
    "NamedArc": "perilune.problem.named_arcs",
    "Extremal": "perilune.problem.extremal",
    "Nature": "perilune.problem.extremal",
    "Family": "perilune.families.family",
    "FamilyPoint": "perilune.families.family",
    "Views": "perilune.problem.views",
    "Tolerance": "perilune.problem.tolerance",
    "Verification": "perilune.problem.verification",
    "Check": "perilune.problem.verification",
    "Outcome": "perilune.words.outcome",
    "PeriluneError": "perilune.words.outcome",
    "InfeasibleError": "perilune.words.outcome",
    "NotConvergedError": "perilune.words.outcome",
    "Indirect": "perilune.methods.indirect",
    "Pseudospectral": "perilune.methods.pseudospectral",
    "Hybrid": "perilune.methods.hybrid",
    "Genetic": "perilune.methods.genetic",
    "MOON": "perilune.models.bodies",
    "load": "perilune.io.reload",
    "guess": "perilune.problem.guess",
    "save": "perilune.io.export",
    "export": "perilune.io.exports.writing",
    "opposite": "perilune.problem.opposite",
    "preflight": "perilune.problem.preflight",
    "solve": "perilune.solve",
    "sweep": "perilune.families.sweep",
    "prove": "perilune.solve",
    "verify": "perilune.solve",
    "atlas": "perilune.atlas",
    "models": "perilune.models",
    "scenario": "perilune.scenario",
    "views": "perilune.problem.views",
}

__all__ = [
    "MOON",
    "Bounded",
    "Check",
    "Curve",
    "Direction",
    "Extremal",
    "Family",
    "FamilyPoint",
    "Finding",
    "Free",
    "Genetic",
    "Given",
    "Hybrid",
    "Indirect",
    "InfeasibleError",
    "NamedArc",
    "Nature",
    "NotConvergedError",
    "Outcome",
    "PeriluneError",
    "Phase",
    "Problem",
    "Pseudospectral",
    "Result",
    "Scales",
    "Solution",
    "Statistics",
    "Table",
    "Tolerance",
    "Trajectory",
    "Variable",
    "Verification",
    "Views",
    "atlas",
    "export",
    "guess",
    "load",
    "models",
    "opposite",
    "preflight",
    "prove",
    "save",
    "scenario",
    "solve",
    "sweep",
    "verify",
    "views",
]

# What methods of a solution do by rooms above theirs, which know it and which it does not know.
_METHODS = {
    "plot": "perilune.report.shown",
    "animate": "perilune.report.animated",
    "solution_page": "perilune.report.pages",
    "problem_page": "perilune.report.pages",
    "verification_page": "perilune.report.pages",
    "to_xarray": "perilune.io.exports.writing",
    "to_dataframe": "perilune.io.exports.writing",
    "family_frame": "perilune.families.datasets",
    "family_dataset": "perilune.families.datasets",
}

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune import atlas, models, scenario
    from perilune.families.family import Family, FamilyPoint
    from perilune.families.sweep import sweep
    from perilune.io.export import save
    from perilune.io.exports.writing import export
    from perilune.io.reload import load
    from perilune.methods.genetic import Genetic
    from perilune.methods.hybrid import Hybrid
    from perilune.methods.indirect import Indirect
    from perilune.methods.pseudospectral import Pseudospectral
    from perilune.models.bodies import MOON
    from perilune.problem import views
    from perilune.problem.controls import Bounded, Direction
    from perilune.problem.extremal import Extremal, Nature
    from perilune.problem.guess import guess
    from perilune.problem.named_arcs import NamedArc
    from perilune.problem.opposite import opposite
    from perilune.problem.phase import Phase
    from perilune.problem.preflight import Finding, preflight
    from perilune.problem.problem import Problem
    from perilune.problem.solution import Curve, Result, Solution, Statistics, Trajectory
    from perilune.problem.tolerance import Tolerance
    from perilune.problem.variables import Free, Given, Variable
    from perilune.problem.verification import Check, Verification
    from perilune.problem.views import Views
    from perilune.solve import prove, solve, verify
    from perilune.words.maths import Table
    from perilune.words.outcome import InfeasibleError, NotConvergedError, Outcome, PeriluneError
    from perilune.words.units import Scales


class _Package(ModuleType):
    """Module type that keeps a public function in place when its module of the same name is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and hasattr(value, name) and name in _EXPORTS):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module 'perilune' has no attribute {name!r}", name=name, obj=sys.modules[__name__])
    module = importlib.import_module(_EXPORTS[name])
    value = getattr(module, name, module)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    from perilune.words.face import public_names

    return public_names((*__all__, "__version__"))


def _import_method_function(name: str) -> Callable[..., Any]:
    """Return the function that does the work of a method, by its name."""
    return getattr(importlib.import_module(_METHODS[name]), name)
