"""The closed loop of any linear scene: hands, masses and links together."""

from hapsim.theory.network.margin import Margin, Margins, margins_of
from hapsim.theory.network.modes import Mode, Solution
from hapsim.theory.network.network import Network
from hapsim.theory.network.reasons import NotWorkedOutError
from hapsim.theory.network.solve import solve
from hapsim.theory.network.state import LARGE, is_large, transition

__all__ = [
    "LARGE",
    "Margin",
    "Margins",
    "Mode",
    "Network",
    "NotWorkedOutError",
    "Solution",
    "is_large",
    "margins_of",
    "solve",
    "transition",
]
