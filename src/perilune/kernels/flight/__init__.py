"""Arcs flown: steps, events, lanes, and the engine that callers hold."""
