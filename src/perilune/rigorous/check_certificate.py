"""Checker of certificates under its old name, ``python -m perilune.rigorous.check_certificate FILE``."""

import sys
import warnings

from perilune_checker.check import run_checker

if __name__ == "__main__":
    warnings.warn(
        "python -m perilune.rigorous.check_certificate is python -m perilune_checker now; the old name goes with 0.4",
        FutureWarning,
        stacklevel=1,
    )
    sys.exit(run_checker())
