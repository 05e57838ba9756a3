"""Measurement: ring the closed loop, record it, identify what the hand met. It never sees a prediction."""
