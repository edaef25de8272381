"""Display of problems and solutions: reprs, views, names of quantities."""
