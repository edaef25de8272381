"""Content of a solution: extremals, nodes, extrema, arc sequences, dispersion, warnings."""
