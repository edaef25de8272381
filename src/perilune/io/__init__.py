"""Files: written, read back."""
