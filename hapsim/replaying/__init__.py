"""Recorded runs, run again without a device."""
