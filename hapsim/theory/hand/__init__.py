"""One hand on one simulated spring and damper: the temporary hybrid system (Florens et al., §4)."""

from hapsim.theory.hand.configuration import Configuration
from hapsim.theory.hand.pole_pair import frequency_and_ratio

__all__ = ["Configuration", "frequency_and_ratio"]
