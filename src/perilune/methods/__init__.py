"""Methods: frozen records of settings with ``run(problem, guess, callback) -> Solution``."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
