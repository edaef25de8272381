"""Expressions before there is code: arcs as programs, without what decouples."""
