"""Continuation of extremals: along a free parameter, a smoothing of the problem, the durations."""
