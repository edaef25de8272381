"""Propagation of arcs, Newton's method and continuation for the boundary value problem."""
