"""Precision landing in the tangent plane of a site: problem, path constraints, presolve."""
