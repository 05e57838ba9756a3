"""The other side of the wire: opening a port, the conversation before and after the loop, and the mock device."""
