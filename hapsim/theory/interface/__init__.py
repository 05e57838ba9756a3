"""The holds, samplings and dampers there are, by the names that a scene file uses; and how a delay is split."""

from hapsim.theory.interface.dampers import DAMPERS, WITH_CUTOFF, DamperModel, damper_answer, damper_named
from hapsim.theory.interface.holds import hold_lag, hold_segments
from hapsim.theory.interface.samplings import SAMPLINGS, Sampling, whole_and_fraction

__all__ = [
    "DAMPERS",
    "SAMPLINGS",
    "WITH_CUTOFF",
    "DamperModel",
    "Sampling",
    "damper_answer",
    "damper_named",
    "hold_lag",
    "hold_segments",
    "whole_and_fraction",
]
