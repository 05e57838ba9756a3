"""What the hand will feel in a scene, before it runs: the scene as the linear theory takes it, and what follows.

Public is what `__all__` names.
"""

from hapsim.prediction.predict import (
    Felt,
    LinkMargin,
    Prediction,
    Shaking,
    WireTime,
    configuration_of,
    felt_at_rate,
    is_surely_unstable,
    predict,
    surely_shaken_by,
    warnings_about,
)

__all__ = [
    "Felt",
    "LinkMargin",
    "Prediction",
    "Shaking",
    "WireTime",
    "configuration_of",
    "felt_at_rate",
    "is_surely_unstable",
    "predict",
    "surely_shaken_by",
    "warnings_about",
]
