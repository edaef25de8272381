"""The explorer: a page on this machine only, on which the optimal flight follows the sliders."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.app.client import MESSAGE
    from perilune.app.server import Explorer
    from perilune.app.sliders import Knob
    from perilune.app.source import Subject, subject_of
    from perilune.app.static_page import build_static_page, default_sliders
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
