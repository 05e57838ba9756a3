"""The fixed-rate loop: clocks, ports, exchange, guards, statistics. Compiled, without the GIL."""
