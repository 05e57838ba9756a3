"""Measurement: ring the closed loop, record it, identify what the hand felt. It never sees a prediction."""
