"""Old place of `perilune.methods.direct.pseudospectral`."""

import sys

from perilune.core import moved_module

sys.modules[__name__] = moved_module(__name__, "perilune.methods.direct.pseudospectral")
