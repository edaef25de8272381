"""Arc structure of a solution, and the multi-phase reformulation of its problem."""
