"""Speed against accuracy: a plucked string of masses and visco-elastic links, simulated by hapsim and by its peers."""
