"""The indirect method: initial costates, Newton trials, structure search, admissibility, diagnosis."""
