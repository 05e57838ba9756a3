"""The daemon's life around its runs: a device that comes and goes, the service manager, and who asks how it is."""
