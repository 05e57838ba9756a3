"""C programs that hapsim's compiled ticks are measured against, and what builds them."""
