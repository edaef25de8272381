"""Survey: find branches by initial solves, from neighbours, around folds, among other minima."""
