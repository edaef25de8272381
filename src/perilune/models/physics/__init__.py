"""Bodies, atmospheres, vehicles, time scales, frames and coasts, which every model shares."""
