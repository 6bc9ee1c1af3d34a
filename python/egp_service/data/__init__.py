"""Data: transitions of a vehicle on one surface, collected on the plant or imported from a log."""
