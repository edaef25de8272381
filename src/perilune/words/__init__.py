"""The words that every room uses: outcomes, units, maths, array types."""
