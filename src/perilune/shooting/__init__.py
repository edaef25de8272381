"""Arcs, roots and families of the boundary value problem."""
