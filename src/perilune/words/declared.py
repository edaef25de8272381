"""Old place of `perilune.core.fields`."""

import sys

from perilune.core import moved_module

sys.modules[__name__] = moved_module(__name__, "perilune.core.fields")
