"""Genetic search and its fitness, and the hybrid of it with the indirect method."""
