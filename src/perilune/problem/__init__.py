"""A problem, its solution and the record of its proof."""
