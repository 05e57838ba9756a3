"""What waiting for bytes, and reading them, can come to: one set of numbers, so that one passes through the other.

A positive number where bytes are read is their count.
"""

from __future__ import annotations

HEARD = 1
"""A position was taken."""
TIMED_OUT = 0
"""Nothing came, or nothing among the bytes was a position."""
HUNG_UP = -1
"""The other side of the port is gone."""
FAILED = -2
"""The system refused; there is nothing to be retried."""
FAULT = -3
"""The device said that it stopped."""
BAD_FORCE = -4
"""The scene's force is not a number."""
OFF_RATE = -5
"""The device does not sample at the rate that it declares."""
LEAPT = -6
"""A position is where no hand can have moved the device."""
DIVERGED = -7
"""The simulated force gave the hand more energy than a passive object can hold, or swings at its limit."""
WRONG_SIGN = -8
"""A motor pushes the other way round than it is told."""
OUT_OF_TRAVEL = -9
"""The device is farther outside its travel than the force reaches."""
