"""Expressions before code generation: arcs as programs, without what decouples."""
