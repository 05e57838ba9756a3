"""Scene -> MOCK: the device that the scene describes, at rest and disarmed."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import begin_decoding
from firmware_protocol.description import Description, to_registers
from firmware_protocol.frames import SETUP, armed_format, framing_of
from firmware_protocol.records import new_record
from hapsim.device.mock.firmware import MOCK
from hapsim.device.mock.sampler import SAMPLINGS, set_hold
from hapsim.scene import Scene

_FORCE_COUNTS = 2.0**31  # the limit in N lies at the end of the counts' range: the finest step that 32 bits give


def describe_mock(scene: Scene) -> Description:
    """What the scene's mock says of itself."""
    channels = scene.channels
    limit = scene.device.force_limit
    return Description(
        name="hapsim mock",
        rate_hz=scene.rate,
        pacings=1 << schema.PACED_BY_DEVICE | 1 << schema.PACED_BY_HOST | 1 << schema.LOCKSTEP,
        max_watchdog_samples=schema.MAX_WATCHDOG_SAMPLES,
        position_scale=(scene.mock_device.quantum,) * channels,
        force_scale=(limit / _FORCE_COUNTS,) * channels,
        force_limit=(limit,) * channels,
        velocity_scale=(scene.mock_device.quantum * scene.rate,) * channels,
    )


def assemble_mock(scene: Scene) -> Any:
    """The mock that the scene's `device` and `mock` describe: MOCK."""
    description = describe_mock(scene)
    mock = new_record(MOCK)
    mock.channels = scene.channels
    _set_bodies(mock, scene)
    _set_converters(mock, scene, description)
    mock.force_scale[: scene.channels] = description.force_scale
    mock.force_limit[: scene.channels] = description.force_limit
    mock.registers[:] = to_registers(description)
    for formats, to_device in ((mock.heard, True), (mock.spoken, False)):
        formats.setup = framing_of(SETUP, to_device)
        formats.armed = framing_of(armed_format(scene.channels), to_device)
        formats.armed_with_velocity = framing_of(armed_format(scene.channels, velocity=True), to_device)
    begin_decoding(mock.decoder, SETUP, to_device=True)
    return mock


def _set_bodies(mock: Any, scene: Scene) -> None:
    device, bodies = scene.mock_device, mock.initial[: scene.channels]
    bodies["mass"] = device.mass
    bodies["friction"] = device.friction
    bodies["stiffness"] = device.stiffness
    bodies["coulomb"] = device.coulomb
    bodies["position"] = device.initial_position
    bodies["velocity"] = device.initial_velocity
    mock.bodies[: scene.channels] = bodies


def _set_converters(mock: Any, scene: Scene, description: Description) -> None:
    device, converters = scene.mock_device, mock.converters[: scene.channels]
    converters["period"] = 1.0 / scene.rate
    for converter in converters:
        mock.depth = set_hold(converter, device.hold, device.delay)
    converters["average"] = SAMPLINGS[device.sampling]
    converters["quantum"] = device.quantum
    converters["velocity_quantum"] = description.velocity_scale
    converters["noise"] = device.noise
    # Spread apart, and never zero, from which the generator would not move.
    seeds = np.random.SeedSequence(device.seed).generate_state(scene.channels, np.uint64)
    converters["seed"] = seeds | np.uint64(1)
