"""Families of solutions along parameters."""
