"""Certificates, proved anew: what one states (`equations`), flown (`steps`), and of the second order (`optimum`)."""
