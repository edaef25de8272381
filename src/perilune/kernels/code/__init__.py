"""Machine code from programs, kept on disk."""
