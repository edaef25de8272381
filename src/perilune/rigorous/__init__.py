"""Level 5: a theorem about the stated problem, by ball arithmetic (FLINT) and nothing of the solver's."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.rigorous.verified import add_theorem_checks
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
