"""How fast and how steady the loop is, beside its peers: a C loop, the same loop in Python, cyclictest."""
