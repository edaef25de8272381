"""The grid of a branch: blocks of nodes, and where a bound is crossed between nodes."""
