"""Recordings in the viewer of Rerun; requires the `[view]` extra."""
