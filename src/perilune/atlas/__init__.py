"""Extremals mapped over a region of parameters, kept on disk, and answers read from them."""
