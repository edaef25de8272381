"""Published results, computed again and set beside what was printed."""
