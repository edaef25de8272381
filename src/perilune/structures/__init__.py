"""A solution read as a sequence of arcs, and the problem restated with them."""
