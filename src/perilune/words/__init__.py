"""Old place of `perilune.core`."""
