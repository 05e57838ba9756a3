"""Scene -> MOCK: the device of the scene, disarmed."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.description import Description, Servo, line_registers, to_registers
from firmware_protocol.frames import SETUP, Format, armed_format, framing_of
from firmware_protocol.lines import LARGEST_DAMPING, LARGEST_STIFFNESS, SHIFTS, Lines, line_units, lines_of
from firmware_protocol.schema import BITS_PER_BYTE, WireTime, wire_time
from hapsim.device.mock.firmware import advance_coupled, advance_driven, take_late_force
from hapsim.device.mock.record import KEPT_REPORTS, MOCK, MOST_LATE, MOST_STEPS
from hapsim.device.mock.sampler import set_timing
from hapsim.device.mock.servo import FAULTS, follow_commands
from hapsim.errors import UsageError
from hapsim.prediction.timing import parts_on_wire, time_to_live_samples
from hapsim.scene import Scene
from hapsim.scene.mock import FORCE_COUNTS
from hapsim.scene.mock_limits import mock_refusal
from hapsim.scene.words import inverted_mask

_HARDEST = 1000.0  # the largest acceleration on the wire, in that of the largest force alone
_BEYOND = 64.0  # at least, of the limit: a line's force at the position that it answers
_DECAY = 50.0  # 1/s, of the mass alone by the damping with which a line's largest stiffness is stable
_MARGIN = 4.0  # of a line's largest damping


def describe_mock(scene: Scene) -> Description:
    """Returns the description that the scene's mock sends."""
    channels, mock = scene.channels, scene.mock_device
    lines, scale = _describe_lines(scene)
    follows = scene.device.is_admittance
    senses = mock.mass_matrix is None and not mock.is_driven and lines is None and not follows  # acceleration
    return Description(
        name="hapsim mock",
        rate_hz=scene.rate,
        pacings=1 << schema.PACED_BY_DEVICE | 1 << schema.PACED_BY_HOST | 1 << schema.LOCKSTEP,
        max_watchdog_samples=schema.MAX_WATCHDOG_SAMPLES,
        position_scale=mock.quantum,
        force_scale=(scale,) * channels,
        force_limit=(mock.force_limit,) * channels,
        velocity_scale=tuple(one * scene.rate for one in mock.quantum),
        acceleration_scale=tuple(_HARDEST * mock.force_limit / FORCE_COUNTS / mass for mass in mock.mass if senses),
        sensors=schema.SENSES_ACCELERATION * senses
        | schema.FOLLOWS_LINES * (lines is not None)
        | schema.HAS_DIGITAL_WORD * scene.has_words
        | (schema.SENSES_FORCE | schema.FOLLOWS_COMMANDS) * follows,
        lines=lines,
        hand_force_scale=(mock.sensed_force_scale,) * (channels * follows),
        hand_force_range=(mock.sensed_force_limit,) * (channels * follows),
        servo=_describe_servo(scene) if follows else None,
        rotary=sum(1 << c for c, motion in enumerate(scene.device.motions(channels)) if motion == "rotary"),
    )


def _describe_servo(scene: Scene) -> Servo:
    device, channels = scene.device, scene.channels
    each = [(0.0, 1.0) if one is None else (one.bandwidth, one.damping) for one in scene.mock_device.servo]
    limits = device.speed_limits(channels), device.acceleration_limits(channels)
    return Servo(*limits, *zip(*each, strict=True))


def _describe_lines(scene: Scene) -> tuple[Lines | None, float]:
    """Returns how the mock follows lines, and N per count: scales for what its bare mass can bear (PROTOCOL.md, section
    6.1). A force scale of a power of ten lets the wire carry round numbers exactly."""
    board, mock = scene.device.board(scene.rate), scene.mock_device
    if board is None:
        return None, mock.force_scale
    scale = max(mock.force_scale, 10.0 ** math.ceil(math.log10(_BEYOND * mock.force_limit / FORCE_COUNTS)))
    local = 1.0 / (scene.rate * board.steps)
    late = (0.5 + board.delay) * local
    units, shifts, largest = [], [], []
    for quantum, mass, friction in zip(mock.quantum, mock.mass, mock.friction, strict=True):
        own = line_units(scale / quantum, board.window * local)
        most = (friction + _DECAY * mass) / late, mass / (late + 0.5 * board.window * local) / _MARGIN
        counts = (LARGEST_STIFFNESS, LARGEST_DAMPING)
        fine = [math.floor(math.log2(n * unit / value)) for n, unit, value in zip(counts, own, most, strict=True)]
        shift = [min(max(one, SHIFTS[0]), SHIFTS[-1]) for one in fine]
        units.append(own)
        shifts.append((shift[0], shift[1]))
        values = [value / math.ldexp(unit, -s) for value, unit, s in zip(most, own, shift, strict=True)]
        largest.append((min(int(values[0]), counts[0]), min(int(values[1]), counts[1])))
    return lines_of((*board, KEPT_REPORTS), units, shifts, largest), scale


def assemble_mock(scene: Scene) -> Any:
    """Returns the MOCK of the scene's `device` and `mock`. Raises UsageError if it cannot move so, or if every force
    would expire on the wire in virtual time."""
    if words := mock_refusal(scene):
        raise UsageError(words)
    description, device = describe_mock(scene), scene.mock_device
    mock = described_mock(description)
    bodies, converters = mock.initial[: scene.channels], mock.converters[: scene.channels]
    bodies["mass"] = device.mass
    bodies["friction"], bodies["stiffness"], bodies["push"] = hand_values(scene)
    if device.mass_matrix is not None:
        mock.coupling.inverse[: scene.channels, : scene.channels] = np.linalg.inv(device.mass_matrix)
        mock.called.advance = advance_coupled.address()
    bodies["coulomb"] = device.coulomb
    bodies["position"] = device.initial_position
    bodies["velocity"] = device.initial_velocity
    mock.bodies[: scene.channels] = bodies
    if device.is_driven:
        _drive(mock, scene)
    converters["period"] = 1.0 / (scene.rate * (1.0 + 1e-6 * device.clock_ppm))
    for converter in converters:
        mock.depth = set_timing(converter, device.hold, device.sampling, device.delay)
    converters["quantum"] = device.quantum
    converters["velocity_quantum"] = description.velocity_scale
    converters["acceleration_quantum"] = description.acceleration_scale or 0.0
    converters["acceleration_noise"] = device.acceleration_noise
    converters["acceleration_age"] = device.acceleration_age
    converters["corner"] = 2.0 * math.pi * (device.acceleration_bandwidth or 0.0)
    converters["noise"] = device.noise
    converters["seed"] = _seeds(device.seed, scene.channels)
    if description.lines:
        mock.follower.late = round(device.delay * description.lines.steps)
    if description.servo:
        _follow_commands(mock, scene, description, description.servo)
    _set_wire(mock, scene)
    _set_inputs(mock, scene)
    for grip, (second, mass) in zip(mock.grips, device.grips, strict=False):
        grip.sample, grip.mass = max(0, round(second * scene.rate)), mass
    return mock


def _set_inputs(mock: Any, scene: Scene) -> None:
    """Sets the digital inputs: off at arming, and their changes in order."""
    mock.inputs = mock.first_inputs = inverted_mask(scene.inputs.values())
    changes = dict[int, int]()
    for name, seconds in scene.mock.inputs.items() if scene.mock else ():
        for second in seconds:
            sample = max(0, round(second * scene.rate))
            changes[sample] = changes.get(sample, 0) ^ scene.inputs[name].mask
    for flip, change in zip(mock.flips, sorted(changes.items()), strict=False):
        flip.sample, flip.inputs = change


def _follow_commands(mock: Any, scene: Scene, description: Description, servo: Servo) -> None:
    """Puts servos before the bodies, which are then what the hand adds beyond the force sensor, and sensors on them."""
    device, used = scene.mock_device, slice(scene.channels)
    follow_commands(mock, device.servo, servo, rate=scene.rate, delay=device.delay)
    mock.bodies["mass"][used] = mock.initial["mass"][used] = device.hand.mass
    sensors, own = mock.force_sensors[used], device.force_sensor
    sensors["quantum"], sensors["range"] = description.hand_force_scale, description.hand_force_range
    sensors["offset"], sensors["drift"], sensors["noise"] = own.offset, own.drift / scene.rate, own.noise
    sensors["fault"], sensors["fault_sample"] = FAULTS.index(own.fault), round(own.fault_time * scene.rate)
    sensors["seed"] = _seeds((device.seed, 3), scene.channels)


def _drive(mock: Any, scene: Scene) -> None:
    """Puts motors and transmissions before the bodies."""
    device, drives, none = scene.mock_device, mock.drives[: scene.channels], (0.0, 1.0)
    drives["cogging"], pitch = (device.cogging.force, device.cogging.pitch) if device.cogging else none
    drives["wave"] = 2.0 * math.pi / pitch
    drives["noise"], band = (device.force_noise.rms, device.force_noise.band) if device.force_noise else none
    drives["corner"] = 2.0 * math.pi * band
    if device.saturation:
        drives["softness"] = ((1.0 - device.saturation.share) ** -2 - 1.0) / device.saturation.force**2
    drives["seed"] = _seeds((device.seed, 2), scene.channels)
    for record, own, friction in zip(drives, device.drive, device.friction, strict=True):
        record.motor_mass, record.stiffness, record.damping = own.motor_mass, own.stiffness, own.damping
        record.backlash, record.lag = own.backlash, own.lag
        record.sensor, record.rough = (side == "handle" and own.is_elastic for side in (own.sensor, own.friction_at))
        record.motor_friction = friction if own.is_elastic and not record.rough else 0.0
    mock.called.advance = advance_driven.address()


def described_mock(description: Description) -> Any:
    """Returns a MOCK with this description and the frame formats of its channels, without bodies and converters."""
    mock, channels = new_record(MOCK), description.channels
    mock.channels = channels
    mock.force_scale[:channels] = description.force_scale
    mock.force_limit[:channels] = description.force_limit
    mock.registers[:] = to_registers(description)
    mock.offered = schema.parts_of(description.parts)
    if description.lines:
        _follow(mock, description, description.lines)
    mock.grips["sample"] = mock.flips["sample"] = -1
    for formats, to_device in ((mock.host_formats, True), (mock.mock_formats, False)):
        formats.setup = framing_of(SETUP, to_device)
        for wire in _armed_formats(channels):
            formats.armed[wire.parts] = framing_of(wire, to_device)
    mock.decoder.framing = framing_of(SETUP, to_device=True)
    return mock


@cache
def _armed_formats(channels: int) -> list[Format]:
    """Returns the formats of an armed device with any parts that fit into a frame."""
    return [armed_format(channels, parts) for parts in schema.COMBINATIONS if schema.fits(channels, parts)]


def _follow(mock: Any, description: Description, lines: Lines) -> None:
    """Lets the mock follow lines. Raises UsageError for more local periods than it keeps."""
    from hapsim.device.mock.line_follower import follow_lines

    if max(lines.steps, lines.delay, lines.window) > MOST_STEPS:
        raise UsageError(
            f"device.board_rate: found {lines.steps} local periods in a sample, a delay of {lines.delay} and a window "
            f"of {lines.window}; expected at most {MOST_STEPS}: a lower board rate"
        )
    follower = mock.follower
    follower.steps, follower.delay, follower.window = lines.steps, lines.delay, lines.window
    for c in range(description.channels):
        follower.shifts[c], follower.largest[c] = line_registers(mock.registers, c)
        follower.limit[c] = round(description.force_limit[c] / description.force_scale[c])
    follow_lines(mock)


def hand_values(scene: Scene) -> NDArray[np.float64]:
    """Returns the values of the mock's bodies in the hand, shape (3, C): friction (N·s/m) and stiffness (N/m), with the
    device's own, and push (N)."""
    device, values = scene.mock_device, np.empty((3, scene.channels))
    hand = device.hand
    values[0] = np.add(device.friction, hand.damping)
    values[1] = np.add(device.stiffness, hand.stiffness)
    values[2] = np.add(hand.force, np.multiply(hand.stiffness, hand.position))
    return values


def _seeds(entropy: int | tuple[int, int], count: int) -> NDArray[np.uint64]:
    """Returns seeds far apart, never zero: from zero the generator would not move."""
    return np.random.SeedSequence(entropy).generate_state(count, np.uint64) | np.uint64(1)


def _set_wire(mock: Any, scene: Scene) -> None:
    """Sets the delays of the wire. In virtual time the host itself takes no time."""
    device = scene.mock_device
    wire = wire_time(scene.channels, parts_on_wire(scene), scene.rate, device.baud, device.turnaround, 0.0)
    late = None if wire.delay_samples is None else wire.delay_samples - 1
    if scene.device.clock == "lockstep":
        _require_passable(wire, late, time_to_live_samples(scene.rate))
    mock.late_samples = min(late or 0, MOST_LATE)
    mock.chance.share = device.misses if scene.device.clock == "lockstep" else 0.0
    mock.chance.seed = _seeds((device.seed, 1), 1)[0]
    if mock.late_samples or mock.chance.share:
        mock.called.take_force = take_late_force.address()
    mock.byte_ns = BITS_PER_BYTE * 1e9 / device.baud if device.baud else 0.0
    mock.turnaround_ns = device.turnaround * 1e9


def _require_passable(wire: WireTime, late: int | None, lives: int) -> None:
    if late is None:
        longest = max(wire.bytes_to_host, wire.bytes_to_device)
        raise UsageError(
            f"mock.baud: found {wire.baud}, at which a frame of {longest} bytes takes longer than the sample period of "
            f"{wire.period * 1e3:.4g} ms, so that frames queue up without end; expected more than "
            f"{math.ceil(longest * BITS_PER_BYTE / wire.period)} (bit/s), or a lower rate"
        )
    if late > lives:
        raise UsageError(
            f"mock.baud, mock.turnaround: an exchange takes {wire.exchange_s * 1e3:.4g} ms, so that every force is "
            f"late by {late} samples and older than its time to live of {lives}: none would ever act. "
            "Expected a faster wire, or a lower rate"
        )
