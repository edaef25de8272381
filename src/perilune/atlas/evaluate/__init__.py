"""Evaluate a branch at a point: interpolation, polish by Newton, an independent re-integration."""
