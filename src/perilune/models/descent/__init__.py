"""Powered descent over a turning body: problem, coordinates, starts with two impulses or burns."""
