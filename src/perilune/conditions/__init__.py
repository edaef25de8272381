"""Pontryagin's conditions of a problem, and the control that minimises H."""
