"""Level 3: second variation, conjugate points, strict complementarity, sensitivities."""
