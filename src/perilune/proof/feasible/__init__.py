"""Level 1: the trajectory is propagated again, and every stated condition holds."""
