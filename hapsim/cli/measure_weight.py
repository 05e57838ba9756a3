"""`hapsim measure --mass`: how heavy what the hand moves feels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from hapsim.cli.output import spoken
from hapsim.errors import UsageError
from hapsim.number_format import number, rounded

if TYPE_CHECKING:
    from hapsim.cli.options import ExcitationOptions
    from hapsim.measuring.measure_trace import Measurement
    from hapsim.prediction import Prediction
    from hapsim.scene import Scene


class MeasuredWeight(NamedTuple):
    """kg, and N/m."""

    hand_stiffness: float
    measured: float
    uncertainty: float
    predicted: float | None
    continuous: float | None
    """Predicted, without sampling and delay."""


def with_hand(scene: Scene, channel: int, stiffness: float | None) -> Scene:
    """Returns the scene whose mock is held by a hand of this stiffness, N/m (None: by that of the scene). UsageError
    where no hand holds the mock, or that of a device is not known."""
    if scene.device.port is not None:
        if stiffness is None:
            raise UsageError(
                "--mass: the stiffness of the hand that holds the device is missing; add --hand-stiffness KH"
            )
        return scene
    from hapsim.scene import Mock
    from hapsim.scene.quantity import per_channel

    mock = scene.mock or Mock()
    stiffnesses = list(per_channel(mock.hand.stiffness, scene.channels))
    stiffnesses[channel] = stiffnesses[channel] if stiffness is None else stiffness
    if not stiffnesses[channel] > 0.0:
        raise UsageError("--mass: no hand holds the mock; expected mock.hand.stiffness, or --hand-stiffness KH")
    hand = mock.hand.model_copy(update={"stiffness": tuple(stiffnesses)})
    return scene.model_copy(update={"mock": mock.model_copy(update={"hand": hand})})


def measured_weight(
    scene: Scene, prediction: Prediction, measurement: Measurement, channel: int, excitation: ExcitationOptions
) -> MeasuredWeight:
    """Returns how heavy it felt, and should."""
    from hapsim.scene.quantity import per_channel

    stiffness = excitation.hand_stiffness
    if stiffness is None:
        assert scene.mock is not None
        stiffness = float(per_channel(scene.mock.hand.stiffness, scene.channels)[channel])
    one = next((one for one in prediction.together if channel in one.channels), None)
    predicted = None if one is None else one.weighs(stiffness)
    return MeasuredWeight(stiffness, *measurement.felt_mass(stiffness), *(predicted or (None, None)))


def weight_sentence(weight: MeasuredWeight, channel: int) -> str:
    """Returns it in words."""
    unit, hand = spoken(channel), f"a hand of {number(weight.hand_stiffness, 4)} N/m"
    if not math.isfinite(weight.measured):
        return unit(f"Held by {hand} nothing was seen to swing: how heavy it feels is not known")
    if weight.measured <= 0.0:
        return unit(f"Held by {hand} it swings no slower than the device alone: what it moves feels like no mass")
    off = weight.uncertainty
    known = f"{rounded(weight.measured, off)} ± {number(off, 1)}" if math.isfinite(off) else number(weight.measured, 4)
    told = f"Shaken by {hand}, what it moves feels like {known} kg"
    if weight.predicted is not None and weight.continuous is not None and math.isfinite(weight.predicted):
        told += f" (predicted: {number(weight.predicted)}; without sampling and delay {number(weight.continuous)})"
    elif weight.predicted is None:
        told += " (not predicted: that is done for one hand and a loop of at most a hundred numbers)"
    return unit(told)
