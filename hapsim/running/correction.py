"""Fills the loop's memory for a correction: a predictor on each channel with a device point, and tables by mass where
the mass is estimated."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from typing import Any

import numpy as np

from firmware_protocol.description import Description
from hapsim.holds import HOLDS
from hapsim.loop.adaptive import ADDED, Adaptation, AdaptiveChannel
from hapsim.loop.predictor import PredictorMemory, Table, numbers_of
from hapsim.prediction.correction import Corrected, Rendering
from hapsim.prediction.correction.predictor import predictor_for
from hapsim.theory.correction import StatePredictor, forces_in_second_difference


class LoopCorrection:
    """What a correction keeps in memory for the loop; nothing if it predicts nothing."""

    def __init__(self, loop: Any, rendering: Rendering, description: Description) -> None:
        """`loop`: a LOOP with its control set."""
        self._memory: PredictorMemory | None = None
        self._adaptation: Adaptation | None = None
        predictors = rendering.predictors()
        if not predictors:
            return
        device = rendering.desired.device
        self._adapts = frozenset(port.channel for port in rendering.ports if port.schedule is not None)
        """The channels that adapt; none is added while the scene runs."""
        self._lags = max(one.lags for one in predictors.values())
        self._memory = PredictorMemory(
            loop.predictor,
            self._tables(rendering),
            lags=self._lags,
            readings=1 + any(one.senses for one in predictors.values()),
            keeps_last_force=HOLDS[device.hold].keeps_last_force,
            lives_samples=int(loop.control.time_to_live),
        )
        if self._adapts:
            numerator, first_lag = forces_in_second_difference(rendering.ports[0].declared)
            self._adaptation = Adaptation(
                loop.predictor,
                _adaptive_channels(rendering, self._adapts),
                period_s=rendering.desired.period,
                numerator=numerator,
                first_lag=first_lag,
                count_m=np.array(description.position_scale),
            )

    def follow(self, rendering: Rendering, samples: int) -> None:
        """Fades to the correction of another scene over so many samples. A channel on which nothing adapts any more
        gets the predictor of its links, and nothing is added to their force."""
        if self._adaptation is not None:
            self._adaptation.follow(_adaptive_channels(rendering, self._adapts))
        if self._memory is not None:
            self._memory.follow(self._tables(rendering), samples)

    def masses(self, channels: int) -> dict[str, tuple[float | None, ...]]:
        """Returns the estimated masses under their names in `Report` and `Progress`: a value per channel, None where
        none is estimated; no values if no channel has one."""
        if self._adaptation is None:
            return {}
        found = self._adaptation.masses()
        rows = [found.get(channel, (None, None, None)) for channel in range(channels)]
        names = ("estimated_mass_kg", "estimated_mass_uncertainty_kg", "mass_explained")
        return dict(zip(names, zip(*rows, strict=True), strict=True))

    def _tables(self, rendering: Rendering) -> dict[int, Table]:
        tables = {channel: self._table([one]) for channel, one in rendering.predictors().items()}
        if self._adapts:
            tables = {channel: np.pad(table, ((0, 0), (0, ADDED))) for channel, table in tables.items()}
        adaptive = (port for port in rendering.ports if port.channel in self._adapts and port.schedule is not None)
        return tables | {port.channel: self._adaptive_table(port) for port in adaptive}

    def _adaptive_table(self, port: Corrected) -> Table:
        """Returns for each mass the predictor's numbers, and what is added to the scene's force for the least mass."""
        assert port.schedule is not None
        elements = port.schedule.elements
        least = elements[0]
        dK = np.array([one.stiffness - least.stiffness for one in elements])
        dB = np.array([one.damping - least.damping for one in elements])
        predictors = [predictor_for(replace(port.declared, mass=one.made_for), one.observer) for one in elements]
        return np.column_stack([self._table(predictors), dK, dB, dK * port.rest])

    def _table(self, predictors: list[StatePredictor]) -> Table:
        return np.array([numbers_of(*one, lags=self._lags) for one in predictors])


def _adaptive_channels(rendering: Rendering, channels: Container[int]) -> dict[int, AdaptiveChannel]:
    return {
        port.channel: AdaptiveChannel(
            span=(float(port.schedule.masses[0]), float(port.schedule.masses[-1])),
            device_stiffness=port.declared.stiffness,
            desired_stiffness=port.written[0] + port.declared.stiffness,
        )
        for port in rendering.ports
        if port.channel in channels and port.schedule is not None
    }
