"""Corrected scenes: they run in place of a scene, so that the hand feels the scene (`device.correction`; `kind.py`)."""

from hapsim.prediction.correction.element import Remedies, felt_error, remedies_for, stable_masses
from hapsim.prediction.correction.kind import CORRECTIONS, CorrectionKind
from hapsim.prediction.correction.rendering import GOOD, Corrected, Rendering, rendered
