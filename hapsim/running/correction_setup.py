"""Filling the loop's memory for a correction: a predictor on each channel with a device point, and tables by mass if
the mass is estimated."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.description import Description
from hapsim.compiling.native import address_of
from hapsim.holds import HOLDS
from hapsim.loop.adaptive import (
    ADAPTIVE,
    ADDED,
    HAND_S,
    LEAST_SLEW,
    MOST_SLOW_SPAN,
    MOST_SPAN,
    SCALE,
    SLEW_S,
    add_difference,
    predict_adaptively,
    read_accelerations,
)
from hapsim.loop.hooks import Hook, Stage
from hapsim.loop.posted import Mailbox
from hapsim.loop.predictor import STATES, look_ahead_by_sensors, predict
from hapsim.prediction.correction import Corrected, Rendering
from hapsim.prediction.correction.kind import predictor_for
from hapsim.scene import Scene
from hapsim.scene.device import Device
from hapsim.theory.correction import StatePredictor, forces_at_sample, forces_in_second_difference
from hapsim.theory.interface import acting_at_sample

Table = NDArray[np.float64]

_LEAST_STIFFNESS = 1e-9  # N/m


class LoopCorrection:
    """The memory of a correction for the loop; empty for one that predicts nothing."""

    def __init__(self, loop: Any, rendering: Rendering, description: Description) -> None:
        """`loop`: a LOOP with its control set."""
        self._ports = {port.channel: port for port in rendering.ports if port.schedule is not None}
        """Adaptive ports by channel; none is added while the scene runs."""
        self.hooks: list[Hook] = []
        """Hooks that the exchange calls."""
        self.tables: list[Table] = []
        """Tables that the loop may still read, the newest last."""
        predictors, self._record = rendering.predictors(), loop.predictor
        self._predicts = bool(predictors)
        record, device = self._record, rendering.desired.device
        if rendering.kind is not None and rendering.kind.by_sensors:
            self._look_ahead(device, rendering.desired, loop)
        if not predictors:
            return
        self._keep_forces(max(one.lags for one in predictors.values()), device, loop)
        record.readings = 1 + any(one.senses for one in predictors.values())
        tables = self._channel_tables(rendering)
        record.rows = max(len(table) for table in tables.values())
        record.width = next(iter(tables.values())).shape[1]
        self.tables = [self._table(tables)]
        self._numbers = self.tables[0][:, 0].copy()
        record.numbers = address_of(self._numbers)
        record.table = record.before = address_of(self.tables[0])
        record.samples = 1
        if self._ports:
            self._adapt(rendering, description)
            self.hooks.append(Hook(Stage.ADD, add_difference, record))
            if self._adaptive.senses:
                self.hooks.append(Hook(Stage.ADD, read_accelerations, record))
        self.hooks.append(Hook(Stage.PREDICT, predict_adaptively if self._ports else predict, record))

    def _keep_forces(self, lags: int, device: Device, loop: Any) -> None:
        """Makes room for the forces of this many samples."""
        record, rows = self._record, 2 << max(lags, 1).bit_length()
        self._lags, self._forces = lags, np.zeros((rows, 2, schema.MAX_CHANNELS))
        record.lags, record.forces, record.mask = lags, address_of(self._forces), rows - 1
        record.keeps_last_force = HOLDS[device.hold].keeps_last_force
        record.lives = loop.control.time_to_live

    def _look_ahead(self, device: Device, scene: Scene, loop: Any) -> None:
        """Fills the numbers of `look_ahead_by_sensors`."""
        hold, ages = HOLDS[device.hold], (0, device.acceleration_age)
        newest, sensed = (acting_at_sample(device.delay, device.hold, age) for age in ages)
        change = [now - then for now, then in zip_longest(newest, sensed, fillvalue=0.0)] if any(ages) else []
        self._keep_forces(len(change), device, loop)
        self._record.width = 1 + len(change)
        self._numbers = np.zeros((schema.MAX_CHANNELS, self._record.width))
        window = 1.0 if device.sampling == "average" else 0.0
        self._numbers[:, 0] = (device.delay + hold.mean_delay + 0.5 * window) * scene.period
        masses = np.array(device.masses(scene.channels))
        self._numbers[: masses.size, 1:] = np.array(change) / masses[:, None]
        self._record.numbers = address_of(self._numbers)
        self.hooks.append(Hook(Stage.PREDICT, look_ahead_by_sensors, self._record))

    def _adapt(self, rendering: Rendering, description: Description) -> None:
        """Fills an ADAPTIVE."""
        period = rendering.desired.period
        self._adaptive = record = new_record(ADAPTIVE)
        self._period = period
        record.slew = 1.0 / max(SLEW_S / period, LEAST_SLEW)
        estimate, sensed, scene = record.estimate, record.sensed, rendering.desired
        record.senses, record.squared_period = "acceleration" in scene.sensed, period**2
        declared = rendering.ports[0].declared
        acting = forces_in_second_difference(declared), forces_at_sample(declared, scene.device.acceleration_age)
        for one, (weights, first_lag) in zip((estimate, sensed), acting, strict=True):
            one.first_lag, one.count = first_lag, len(weights)
            one.weights[: len(weights)] = period**2 * weights
            one.uncertainty[:] = math.inf
        sensed.span[:] = min(max(round(HAND_S / period), 1), MOST_SPAN)
        sensed.slow_span[:] = sensed.span
        sensed.rounding[:] = math.inf  # all that the forces do not explain may be noise
        for channel, port in self._ports.items():
            record.adapts[channel] = 1
            for spans in (record, estimate, sensed):
                spans.log_least[channel], spans.log_most[channel] = np.log(_span(port))
                spans.log_mass[channel] = spans.log_least[channel]
            sensed.log_least[channel] -= 3.0 * SCALE
            sensed.log_most[channel] += 3.0 * SCALE
            estimate.spring[channel] = sensed.spring[channel] = port.declared.stiffness * period**2
            record.joint.log_mass[channel], record.joint.uncertainty[channel] = record.log_least[channel], math.inf
            estimate.rounding[channel] = description.position_scale[channel] ** 2 / 12.0
        for channel, samples in self._spans(rendering):
            estimate.next_span[channel] = samples
        estimate.span[:] = estimate.next_span
        estimate.slow_span[:] = np.minimum(estimate.span, MOST_SLOW_SPAN)
        self._record.adaptive = address_of(record)

    def _spans(self, rendering: Rendering) -> Iterator[tuple[int, int]]:
        """Yields each adaptive channel with the span of its estimate, in samples."""
        for port in (one for one in rendering.ports if one.channel in self._ports and one.schedule is not None):
            stiffness = max(port.written[0] + port.declared.stiffness, _LEAST_STIFFNESS)
            half_period_s = math.pi * math.sqrt(_span(port)[0] / stiffness)
            samples = min(max(half_period_s / rendering.desired.period, 1.0), float(MOST_SPAN))
            yield port.channel, round(samples)

    def fade_to(self, rendering: Rendering, samples: int, mailbox: Mailbox) -> None:
        """Adds to the next change a fade to the correction of another scene, over `samples`. A channel that no longer
        adapts gets the predictor of its links, and nothing is added to their force."""
        for channel, span in self._spans(rendering) if self._ports else ():
            mailbox.add(self._adaptive.estimate, "next_span", span, channel)
        if self._predicts:
            record = self._record
            read = [int(address) for address in (record.posted, record.table, record.before)]  # in the order of its way
            self.tables = [one for one in self.tables if address_of(one) in read]
            self.tables.append(self._table(self._channel_tables(rendering)))
            mailbox.add(record, "posted_samples", max(samples, 1))
            mailbox.add(record, "posted", address_of(self.tables[-1]))

    def masses(self, channels: int) -> dict[str, tuple[float | None, ...]]:
        """Returns the estimated masses by their names in `Report` and `Progress`: a value per channel, None without an
        estimate; no names if no channel has one."""
        names = ("estimated_mass_kg", "estimated_mass_uncertainty_kg", "mass_explained", "mass_age_s")
        if not self._ports:
            return {}
        rows: list[tuple[float | None, ...]] = [(None, None, None, None)] * channels
        estimate = self._adaptive.joint if self._adaptive.senses else self._adaptive.estimate
        for channel, port in self._ports.items():
            (least, most), mass = _span(port), float(np.exp(estimate.log_mass[channel]))
            uncertainty = min(float(estimate.uncertainty[channel]) * mass, most - least)
            age_s = float(estimate.age[channel] * self._period)
            rows[channel] = mass, uncertainty, float(estimate.explained[channel]), age_s
        return dict(zip(names, zip(*rows, strict=True), strict=True))

    def _table(self, tables: dict[int, Table]) -> Table:
        """Returns all channels' tables as one; a channel without a predictor passes the measured position on."""
        whole = np.zeros((schema.MAX_CHANNELS, int(self._record.rows), int(self._record.width)))
        row, readings = STATES + self._lags, int(self._record.readings)
        whole[..., (2 + readings) * row] = whole[..., (4 + readings) * row] = 1.0  # the measured position
        for channel, table in tables.items():
            whole[channel] = table
        return whole

    def _channel_tables(self, rendering: Rendering) -> dict[int, Table]:
        """Returns (masses or 1, width) numbers by channel: a predictor's for each mass. With an estimated mass they end
        with the addition to the scene's force, which is that for the least mass."""
        tables = {channel: self._numbers_of([one]) for channel, one in rendering.predictors().items()}
        if self._ports:
            tables = {channel: np.pad(table, ((0, 0), (0, ADDED))) for channel, table in tables.items()}
        adaptive = (port for port in rendering.ports if port.channel in self._ports and port.schedule is not None)
        return tables | {port.channel: self._adaptive_table(port) for port in adaptive}

    def _adaptive_table(self, port: Corrected) -> Table:
        assert port.schedule is not None
        elements = port.schedule.elements
        dK = np.array([one.stiffness - elements[0].stiffness for one in elements])
        dB = np.array([one.damping - elements[0].damping for one in elements])
        predictors = [predictor_for(replace(port.declared, mass=one.made_for), one.observer) for one in elements]
        return np.column_stack([self._numbers_of(predictors), dK, dB, dK * port.rest])

    def _numbers_of(self, predictors: list[StatePredictor]) -> Table:
        """Returns (predictors, width): the rows of step, reading and ahead for all lags, then both gains."""
        table = []
        for one in predictors:
            rows = np.vstack([one.step, one.reading, one.ahead])
            padded = np.pad(rows, ((0, 0), (0, STATES + self._lags - rows.shape[1])))
            table.append(np.concatenate([padded.ravel(), one.gains.ravel(), one.first.ravel()]))
        return np.array(table)


def _span(port: Corrected) -> tuple[float, float]:
    """Returns the least and the greatest mass (kg) of a channel that adapts."""
    assert port.schedule is not None
    return float(port.schedule.masses[0]), float(port.schedule.masses[-1])
