"""Solution branches: charts, arc sequences, status of bounds, continuation along a parameter."""
