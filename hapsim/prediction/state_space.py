"""The closed loop of a scene as matrices, for programs that design controllers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.theory.arrays import Floats
from hapsim.theory.network import Network, is_large, state_size
from hapsim.theory.sample import loop


class StateSpace(NamedTuple):
    """x[n+1] = A x[n] + B u[n], y[n] = C x[n] + D u[n], from sample to sample. `control.ss(*these, dt=1 / rate)` takes
    them (python-control).

    u (C,) is a force in N that the host adds to that of the links on each channel, and which acts when theirs does; y
    (C + M,) are the positions of channels and masses in m, as the host reads them."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats


def state_space_of(network: Network) -> StateSpace:
    """Returns the matrices of a loop. Raises UsageError for a large scene."""
    if is_large(network):
        raise UsageError(f"found {state_size(network)} numbers in the scene's state, too many for matrices")
    whole, channels = loop(network, inputs=True), network.channel_mass.size
    size = len(whole.change)
    return StateSpace(
        np.eye(size) + whole.change, whole.push[:, :channels], whole.points, np.zeros((len(whole.points), channels))
    )
