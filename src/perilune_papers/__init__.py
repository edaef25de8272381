"""Published results, computed again and compared with what was printed."""
