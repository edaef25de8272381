"""Run the checker: ``python -m perilune_checker certificate.json``."""

import sys

if __name__ == "__main__":
    try:
        from perilune_checker.check import run_checker
    except ModuleNotFoundError as missing:
        sys.exit(f"not checked: {missing.name} is not installed; pip install python-flint")
    if len(sys.argv) != 2:
        sys.exit("usage: python -m perilune_checker certificate.json")
    sys.exit(run_checker())
