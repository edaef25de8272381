"""Genetic search and its fitness, and the hybrid of it with another method."""
