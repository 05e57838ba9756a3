"""Pictures, each drawn from data that the caller can also have as numbers."""
