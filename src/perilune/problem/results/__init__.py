"""What a solution holds: extremals, nodes, extrema, arc sequences, dispersion, warnings."""
