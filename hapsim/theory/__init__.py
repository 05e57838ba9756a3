"""Sampled-data mathematics of the temporary hybrid system, after Florens, Voda and Urma.

It stands on NumPy alone, and on nothing else of the project: what it predicts and what a run measures are
independent roads to the same number.
"""

from hapsim.theory.configuration import Configuration
from hapsim.theory.network import Mode, Network
from hapsim.theory.oscillator import frequency_and_ratio

__all__ = ["Configuration", "Mode", "Network", "frequency_and_ratio"]
