"""What a computer can do about the deformation: predict the state in which the mass will meet the force."""

from hapsim.theory.correction.predicted_loop import PredictedLoop
from hapsim.theory.correction.state_predictor import (
    SLOWEST,
    StatePredictor,
    as_read,
    forces_in_second_difference,
    state_predictor,
)

__all__ = ["SLOWEST", "PredictedLoop", "StatePredictor", "as_read", "forces_in_second_difference", "state_predictor"]
