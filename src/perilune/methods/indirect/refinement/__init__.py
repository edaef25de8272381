"""Refinement of a rough answer to an extremal of known arcs: its structure is searched for, and revised by rule."""
