"""Kinds of problems as files state them: their sections, and the function that makes the problem."""
