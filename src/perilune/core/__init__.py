"""Foundation of all rooms: outcomes, units, maths, declarations, array types."""
