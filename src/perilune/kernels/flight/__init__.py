"""Integration of arcs: steps, events, lanes, and the engine that callers hold."""
