"""Speed against accuracy: hapsim beside its peers, on strings of masses and visco-elastic links."""
