"""What the hand will feel in a scene, before it runs: the scene as the linear theory takes it, and what follows."""

from hapsim.prediction.predict import (
    Felt,
    LinkBudget,
    LinkMargin,
    Prediction,
    configuration_of,
    is_surely_unstable,
    predict,
    surely_grows_by,
    warnings_about,
)

__all__ = [
    "Felt",
    "LinkBudget",
    "LinkMargin",
    "Prediction",
    "configuration_of",
    "is_surely_unstable",
    "predict",
    "surely_grows_by",
    "warnings_about",
]
