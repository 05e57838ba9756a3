"""A scene's poles and modes: all of a small scene's, some of a large one's."""

from __future__ import annotations

from hapsim.theory.network.large_modes import some_modes
from hapsim.theory.network.modes import Solution, all_modes
from hapsim.theory.network.network import Network
from hapsim.theory.network.state import is_large


def solve(network: Network) -> Solution:
    """The poles and modes: all of them, or of a large scene those that matter, and how they were found.

    Raises:
        NotWorkedOutError: the scene is large, and its scheme's matrix is neither sparse nor has modes that are.
    """
    return some_modes(network) if is_large(network) else all_modes(network)
