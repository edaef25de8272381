"""Files of solutions: written and read back."""
