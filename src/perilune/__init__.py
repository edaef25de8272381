"""Optimal finite-thrust landing, descent and deorbit trajectories, each answer with its proof."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

TYPE_CHECKING = False  # as checkers know it by its name too: nothing is loaded for it before Ctrl-C can be answered
__version__ = "0.2.0"

# What is offered. Loaded on first use (`perilune.core.facade`), so that `import perilune` costs nothing.
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune import atlas, models, scenario
    from perilune.core.errors import InfeasibleError, NotConvergedError, Outcome, PeriluneError
    from perilune.core.maths import Table
    from perilune.core.units import Scales
    from perilune.families.batch import Batch
    from perilune.families.family import Family, FamilyPoint
    from perilune.families.solve_many import solve_many
    from perilune.families.sweep import sweep
    from perilune.io.exports.writing import export
    from perilune.io.load import load
    from perilune.io.save import save
    from perilune.methods.direct.pseudospectral import Pseudospectral
    from perilune.methods.evolutionary.genetic import Genetic
    from perilune.methods.evolutionary.hybrid import Hybrid
    from perilune.methods.indirect.indirect import Indirect
    from perilune.models.physics.bodies import MOON
    from perilune.problem.controls import ScalarControl, UnitVectorControl
    from perilune.problem.display import views
    from perilune.problem.display.views import Views
    from perilune.problem.initial_guess import guess
    from perilune.problem.named_values import Conditions, Quantities
    from perilune.problem.negated import opposite
    from perilune.problem.phase import Phase
    from perilune.problem.presolve import Finding, preflight
    from perilune.problem.problem import Problem
    from perilune.problem.results.arc_sequence import NamedArc
    from perilune.problem.results.extremal import Extremal, Nature
    from perilune.problem.results.solution import Result, Solution, Statistics
    from perilune.problem.results.trajectory import Curve, Trajectory
    from perilune.problem.tolerance import Tolerance
    from perilune.problem.variables import FreeParameter, Parameter, Variable
    from perilune.problem.verification import Check, Verification
    from perilune.solve import solve
    from perilune.verify import verify

# old name: new name. For one minor version, with a warning.
_RENAMED = {
    "Bounded": "ScalarControl",
    "Direction": "UnitVectorControl",
    "Free": "FreeParameter",
    "Given": "Parameter",
    "prove": "verify",
}

__all__ = [
    "MOON",
    "Batch",
    "Check",
    "Conditions",
    "Curve",
    "Extremal",
    "Family",
    "FamilyPoint",
    "Finding",
    "FreeParameter",
    "Genetic",
    "Hybrid",
    "Indirect",
    "InfeasibleError",
    "NamedArc",
    "Nature",
    "NotConvergedError",
    "Outcome",
    "Parameter",
    "PeriluneError",
    "Phase",
    "Problem",
    "Pseudospectral",
    "Quantities",
    "Result",
    "ScalarControl",
    "Scales",
    "Solution",
    "Statistics",
    "Table",
    "Tolerance",
    "Trajectory",
    "UnitVectorControl",
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
    "save",
    "scenario",
    "solve",
    "solve_many",
    "sweep",
    "verify",
    "views",
]

# What methods of a solution do by rooms above theirs, which know it and which it does not know.
_METHODS = {
    "plot": "perilune.report.plot",
    "animate": "perilune.report.animation",
    "solution_page": "perilune.report.notebook",
    "problem_page": "perilune.report.notebook",
    "verification_page": "perilune.report.notebook",
    "to_xarray": "perilune.io.exports.writing",
    "to_dataframe": "perilune.io.exports.writing",
    "member_frame": "perilune.families.export_frames",
    "member_dataset": "perilune.families.export_frames",
}


class _Package(ModuleType):
    """Module type that keeps a public function in place when its module of the same name is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and hasattr(value, name) and name in __all__):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        from perilune.core.deprecation import warn_renamed

        warn_renamed(f"perilune.{name}", f"perilune.{_RENAMED[name]}")
        name = _RENAMED[name]
    from perilune.core.facade import import_of_face

    value = import_of_face(__name__, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    from perilune.core.facade import public_names

    return public_names((*__all__, "__version__"))


def _import_method_function(name: str) -> Callable[..., Any]:
    """Return the function that does the work of a method, by its name."""
    return getattr(importlib.import_module(_METHODS[name]), name)
