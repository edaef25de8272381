"""Certificates, proved anew: `expressions` and `equations`, flown in `steps`, and the second variation (`optimum`)."""
