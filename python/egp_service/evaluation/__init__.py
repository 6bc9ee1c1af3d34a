"""The paper's experiments on this system, with baselines given the same care; `egp evaluate`."""
