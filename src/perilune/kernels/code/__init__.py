"""From a program to machine code, kept on disk."""
