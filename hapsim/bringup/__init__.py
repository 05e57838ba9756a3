"""For whoever writes firmware: judge it, disturb its wire, decode its frames."""
