"""Recordings of a run: trace, record, report."""
