"""Prediction of the stiffness and damping that a hand will feel in a scene, from its linear form.

Public names are those in `__all__`.
"""

from firmware_protocol.schema import WireTime
from hapsim.prediction.any_hand import AnyHand, ShakingHand, WorstHand
from hapsim.prediction.felt_alone import Desired, Felt, Robustness, correction_for, robustness_of
from hapsim.prediction.linear import configuration_of
from hapsim.prediction.part import HAND_HZ, HAND_STIFFNESS, Along, OwnMotion, Part, Weight
from hapsim.prediction.plausibility import unlikely
from hapsim.prediction.predict import (
    Prediction,
    is_surely_unstable,
    partials_of,
    predict,
    predict_on_wire,
    surely_shaken_by,
    with_mass,
)
from hapsim.prediction.predict_impedance import PredictedImpedance, ZWidth, predict_impedance, z_width_of
from hapsim.prediction.stability import LinkMargin, Region, Shaking
from hapsim.prediction.timing import HostSilence, host_silence
from hapsim.prediction.warnings import warnings_about

__all__ = [
    "HAND_HZ",
    "HAND_STIFFNESS",
    "Along",
    "AnyHand",
    "Desired",
    "Felt",
    "HostSilence",
    "LinkMargin",
    "OwnMotion",
    "Part",
    "PredictedImpedance",
    "Prediction",
    "Region",
    "Robustness",
    "Shaking",
    "ShakingHand",
    "Weight",
    "WireTime",
    "WorstHand",
    "ZWidth",
    "configuration_of",
    "correction_for",
    "host_silence",
    "is_surely_unstable",
    "partials_of",
    "predict",
    "predict_impedance",
    "predict_on_wire",
    "robustness_of",
    "surely_shaken_by",
    "unlikely",
    "warnings_about",
    "with_mass",
    "z_width_of",
]
