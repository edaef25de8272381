"""Certificates, proved anew: `form`, `expressions`, `equations`, `steps` of a flight, its second order (`optimum`)."""
