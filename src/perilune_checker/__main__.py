"""Run the checker: ``python -m perilune_checker certificate.json``."""

import sys

from perilune_checker.check import run_checker

if __name__ == "__main__":
    sys.exit(run_checker())
