"""How problems and solutions are shown: reprs, views, names of quantities."""
