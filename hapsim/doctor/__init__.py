"""Examination of this machine for a haptic loop: wake-up latency, rates that it keeps, and advice."""
