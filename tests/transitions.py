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
