"""Parameter sweeps: each point is predicted, measured on the mock in virtual time, or computed by a function."""
