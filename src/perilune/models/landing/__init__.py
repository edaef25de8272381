"""Hybrid-engine landing from an orbit: problem and presolve."""
