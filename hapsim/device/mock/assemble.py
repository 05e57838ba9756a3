"""Scene -> Mock: the device that the scene describes, at rest and disarmed."""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import new_decoder
from firmware_protocol.description import Description, to_registers
from firmware_protocol.frames import SETUP, armed_format
from hapsim.device.mock.firmware import BOARD, OUTBOX_BYTES, Mock
from hapsim.device.mock.motion import BODY
from hapsim.device.mock.sampler import CONVERTER
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


def assemble_mock(scene: Scene) -> Mock:
    """The mock that the scene's `device` and `mock` describe."""
    description = describe_mock(scene)
    device = scene.mock_device
    channels = scene.channels
    bodies = np.zeros(channels, BODY)
    bodies["mass"] = device.mass
    bodies["friction"] = device.friction
    bodies["stiffness"] = device.stiffness
    bodies["coulomb"] = device.coulomb
    bodies["position"] = device.initial_position
    bodies["velocity"] = device.initial_velocity
    converters = np.zeros(channels, CONVERTER)
    converters["period"] = 1.0 / scene.rate
    whole = math.floor(device.delay)
    converters["whole_delay"] = whole
    converters["part_delay"] = device.delay - whole
    converters["impulse"] = device.hold == "impulse"
    converters["average"] = device.sampling == "average"
    converters["quantum"] = device.quantum
    converters["velocity_quantum"] = description.velocity_scale
    converters["noise"] = device.noise
    # Spread apart, and never zero, from which the generator would not move.
    converters["seed"] = np.random.SeedSequence(device.seed).generate_state(channels, np.uint64) | np.uint64(1)
    return Mock(
        bodies=bodies.copy(),
        initial=bodies,
        converters=converters,
        commands=np.zeros((whole + 2, channels)),
        force_scale=np.array(description.force_scale),
        force_limit=np.array(description.force_limit),
        counts=np.zeros(2 * channels, np.int64),
        registers=to_registers(description),
        decoder=new_decoder(SETUP, to_device=True),
        board=np.zeros(1, BOARD)[0],
        armed=armed_format(channels),
        armed_with_velocity=armed_format(channels, velocity=True),
        outbox=np.zeros(OUTBOX_BYTES, np.uint8),
    )
