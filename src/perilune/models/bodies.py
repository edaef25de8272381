"""Old place of `perilune.models.physics.bodies`."""

import sys

from perilune.core import moved_module

sys.modules[__name__] = moved_module(__name__, "perilune.models.physics.bodies")
