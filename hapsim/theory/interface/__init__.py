"""The holds, samplings and dampers there are, by the names that a scene file uses; and how a delay is split."""

from hapsim.theory.interface.dampers import DAMPERS, WITH_CUTOFF, DamperModel, damper_named
from hapsim.theory.interface.holds import HOLDS, Hold, HoldSegment
from hapsim.theory.interface.samplings import SAMPLINGS, Sampling, Term, product, whole_and_fraction

__all__ = [
    "DAMPERS",
    "HOLDS",
    "SAMPLINGS",
    "WITH_CUTOFF",
    "DamperModel",
    "Hold",
    "HoldSegment",
    "Sampling",
    "Term",
    "damper_named",
    "product",
    "whole_and_fraction",
]
