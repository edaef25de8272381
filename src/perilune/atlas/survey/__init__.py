"""Find branches: initial solves, neighbours, folds, other minima."""
