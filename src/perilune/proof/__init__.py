"""Proof of a solution by other code than the solver's: SciPy and the numpy physics, no symbols, no kernels."""
