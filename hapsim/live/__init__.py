"""A running scene for other programs: one model (`hub`), and a view of it a file."""
