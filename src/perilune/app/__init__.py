"""The explorer: a page on this machine alone, on which the optimal flight follows what is dragged."""
