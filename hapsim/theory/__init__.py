"""Sampled-data mathematics of the temporary hybrid system, after Florens, Voda and Urma.

It depends on NumPy (and, for scenes of hundreds of masses, on SciPy's sparse matrices), and on nothing else of the
project, so a prediction and the measurement of a run are independent. Public names are those in `__all__`.
"""

from hapsim.theory.hand import Configuration, frequency_and_ratio
from hapsim.theory.network import (
    Margin,
    Margins,
    Mode,
    Network,
    NotWorkedOutError,
    Solution,
    Stabilizing,
    margins_of,
    solve,
)

__all__ = [
    "Configuration",
    "Margin",
    "Margins",
    "Mode",
    "Network",
    "NotWorkedOutError",
    "Solution",
    "Stabilizing",
    "frequency_and_ratio",
    "margins_of",
    "solve",
]
