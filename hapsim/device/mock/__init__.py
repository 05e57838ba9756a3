"""The mock device: a real mass under a held, delayed force, behind the same bytes that a device speaks."""
