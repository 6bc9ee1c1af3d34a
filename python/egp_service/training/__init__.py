"""Training: from data to a library file, and how well a library predicts held-out data."""
