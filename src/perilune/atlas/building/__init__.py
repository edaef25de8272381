"""Build, extend, merge, audit, verify and export atlases."""
