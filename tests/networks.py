"""The network of one hand, of which a test changes what it is about."""

from __future__ import annotations

from typing import Any

from hapsim.theory import Network

HAND: dict[str, Any] = {
    "rate": 1000.0,
    "channel_mass": [0.2],
    "channel_friction": [1.0],
    "delay": 1.0,
    "hold": "zoh",
    "sampling": "ideal",
    "point_mass": [],
    "ends": [[0, -1]],
    "stiffness": [2000.0],
    "damping": [5.0],
}


def network_of(**changed: Any) -> Network:
    """A hand of 0.2 kg and 1 N·s/m on a wall of 2000 N/m and 5 N·s/m, a sample late."""
    return Network(**HAND | changed)
