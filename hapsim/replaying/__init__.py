"""Replay and export of recorded runs."""
