"""The explorer: a page on this machine only, on which the optimal flight follows the sliders."""
