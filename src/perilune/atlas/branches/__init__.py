"""Branches of extremals: charts, arc sequences, the status of bounds, continuation along a parameter."""
