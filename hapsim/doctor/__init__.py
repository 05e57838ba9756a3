"""How steady this machine is for a haptic loop: what wakes it late, what it keeps up with, and what would help."""
