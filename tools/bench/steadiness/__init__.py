"""Speed and jitter of the loop, next to its peers: a C loop, the same loop in Python, cyclictest."""
