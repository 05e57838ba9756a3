"""What a correction asks of the loop: a predictor on every channel that has a device point, and tables for a mass that
is estimated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from firmware_protocol.description import Description
from hapsim.loop.adaptive import Adaptation, AdaptiveChannel
from hapsim.loop.predictor import PredictorMemory
from hapsim.prediction.correction import Corrected, Rendering
from hapsim.theory.correction import forces_in_second_difference, state_predictor


class LoopCorrection:
    """Everything that it keeps in memory for the loop; nothing, where nothing is predicted."""

    def __init__(self, loop: Any, rendering: Rendering, description: Description) -> None:
        """`loop`: LOOP, whose control is already set."""
        self._adaptation: Adaptation | None = None
        predictors = rendering.predictors()
        if not predictors:
            return
        device = rendering.desired.device
        self._memory = PredictorMemory(
            loop.predictor,
            {channel: (one.readings, one.forces) for channel, one in predictors.items()},
            channels=description.channels,
            senses=any(one.senses for one in predictors.values()),
            goes_on=device.hold == "zoh",
            lives_samples=int(loop.control.time_to_live),
        )
        self._channels = channels = _adaptive_channels(rendering)
        """Those that adapted at the beginning: no other begins to while it runs."""
        if channels:
            numerator, first_lag = forces_in_second_difference(rendering.ports[0].declared)
            self._adaptation = Adaptation(
                loop.predictor,
                channels,
                period_s=rendering.desired.period,
                numerator=numerator,
                first_lag=first_lag,
                count_m=np.array(description.position_scale),
            )

    def follow(self, rendering: Rendering, samples: int) -> None:
        """Another scene before the same device, over so many samples. A channel on which nothing adapts any more has
        the predictor that its links are simulated for, and nothing comes to their force."""
        if self._adaptation is None:
            return
        channels = _adaptive_channels(rendering)
        predictors = rendering.predictors()
        for channel, before in self._channels.items():
            if channel not in channels:
                constant = np.zeros_like(before.stiffness)
                one = predictors.get(channel)
                told = before.weights[0] if one is None else np.hstack([one.readings, one.forces])
                weights = np.broadcast_to(told, before.weights.shape)
                channels[channel] = before._replace(stiffness=constant, damping=constant, weights=weights)
        self._adaptation.follow({channel: channels[channel] for channel in self._channels}, samples)

    def masses(self, channels: int) -> dict[str, tuple[float | None, ...]]:
        """What `Report` and `Progress` say of the masses that are estimated, by their names there: a value per channel,
        None where none is estimated; no values where no channel has one."""
        if self._adaptation is None:
            return {}
        found = self._adaptation.masses()
        rows = [found.get(channel, (None, None, None)) for channel in range(channels)]
        masses, uncertainties, explained = zip(*rows, strict=True)
        return {
            "estimated_mass_kg": masses,
            "estimated_mass_uncertainty_kg": uncertainties,
            "mass_explained": explained,
        }


def _adaptive_channels(rendering: Rendering) -> dict[int, AdaptiveChannel]:
    senses = bool(rendering.desired.sensed_links)
    return {port.channel: _adaptive(port, senses) for port in rendering.ports if port.schedule is not None}


def _adaptive(port: Corrected, senses: bool) -> AdaptiveChannel:
    assert port.schedule is not None
    elements, masses = port.schedule.elements, port.schedule.masses
    predictors = [state_predictor(replace(port.declared, mass=one.made_for), senses) for one in elements]
    return AdaptiveChannel(
        span=(float(masses[0]), float(masses[-1])),
        stiffness=np.array([one.stiffness - elements[0].stiffness for one in elements]),
        damping=np.array([one.damping - elements[0].damping for one in elements]),
        rest=port.rest,
        weights=np.array([np.hstack([one.readings, one.forces]) for one in predictors]),
        device_stiffness=port.declared.stiffness,
        desired_stiffness=port.written[0] + port.declared.stiffness,
    )
