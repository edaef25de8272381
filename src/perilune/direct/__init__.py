"""Collocation, its nonlinear program, its mesh."""
