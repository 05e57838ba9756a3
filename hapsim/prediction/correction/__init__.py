"""What is run in place of a scene, so that the hand feels the scene: `device.correction`, one kind a file."""

from hapsim.prediction.correction.lone import felt_error
from hapsim.prediction.correction.rendering import CORRECTIONS, Corrected, Rendering, rendered
from hapsim.prediction.correction.unreachable import Remedies, remedies_for, stable_masses

__all__ = [
    "CORRECTIONS",
    "Corrected",
    "Remedies",
    "Rendering",
    "felt_error",
    "remedies_for",
    "rendered",
    "stable_masses",
]
