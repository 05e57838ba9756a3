"""The closed loop of any linear scene: hands, masses and links together."""

from hapsim.theory.network.margin import Margin
from hapsim.theory.network.modes import Mode, Solution
from hapsim.theory.network.network import LARGE, Network

__all__ = ["LARGE", "Margin", "Mode", "Network", "Solution"]
