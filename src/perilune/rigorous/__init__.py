"""Level 5: a theorem about the stated problem, by ball arithmetic (FLINT) and nothing of the solver's."""
