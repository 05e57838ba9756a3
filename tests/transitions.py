"""Transition of a whole network over a sample, from the theory's loop."""

from __future__ import annotations

import numpy as np

from hapsim.theory import Network
from hapsim.theory.arrays import Floats
from hapsim.theory.network import loop


def transition(network: Network) -> Floats:
    """Matrix from the state at one sample to the state at the next, of a scene that is not large."""
    change = loop(network).change
    return np.asarray(change + np.eye(len(change)))


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    """Returns the largest distance of a pole of a motion to the nearest pole of the other set, both ways."""
    found, expected = (poles[np.abs(poles) > 1e-3] for poles in (found, expected))
    assert found.size == expected.size
    return max(
        float(np.abs(one[:, None] - other).min(axis=1).max()) for one, other in ((found, expected), (expected, found))
    )
