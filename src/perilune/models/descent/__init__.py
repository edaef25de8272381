"""Powered descent over a turning body: problem, coordinates, starts with two impulses or burns."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.models.descent.problem import Ignition, Site, Steering, powered_descent
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)

__all__ = ["Ignition", "Site", "Steering", "powered_descent"]
