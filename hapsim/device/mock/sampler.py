"""The mock's converters: what the body's position and velocity become on the wire, and when a commanded force acts on
the body.

Command c[n], decided during sample n, acts from (n + delay) T on: held until the next one (zero-order hold), or as an
impulse c[n] T. With delay = D + phi, sample n sees c[n-D-1] for its first phi T and c[n-D] for the rest.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.compiling import helper
from hapsim.device.mock.motion import move, strike

HOLDS = {"zoh": 0, "impulse": 1}
"""A scene's names for what becomes of a force: it acts until the next one, or is given at once as an impulse."""

SAMPLINGS = {"ideal": 0, "average": 1}
"""A scene's names for what is measured: the position at the instant, or its mean over the sample before."""

CONVERTER = np.dtype(
    [
        ("period", np.float64),  # s, nominal
        ("whole_delay", np.int64),  # D
        ("part_delay", np.float64),  # phi, in [0, 1)
        ("impulse", np.int64),  # of HOLDS
        ("average", np.int64),  # of SAMPLINGS
        ("quantum", np.float64),  # m per count
        ("velocity_quantum", np.float64),  # (m/s) per count; 0: the device senses no velocity
        ("noise", np.float64),  # m rms, and as many periods of it as there are in a second, in m/s rms, of the velocity
        ("before", np.float64),  # m, where the body was at the sample before
        ("seed", np.uint64),  # where the noise's generator starts when the device is armed
        ("state", np.uint64),  # where it stands
    ]
)


@helper
def advance_body(how, body, converter, commands, depth, channel, n, h):
    """Moves one channel's body through sample n, which lasts `h` seconds. `how`: see `move`; `commands`: N, the last
    `depth` rows of them, a column for each channel."""
    newer = commands[(n - converter.whole_delay) % depth, channel]
    first = converter.part_delay * h
    if converter.impulse:
        move(how, body, 0.0, first)
        strike(body, newer * converter.period)
        move(how, body, 0.0, h - first)
        return
    if first > 0.0:
        move(how, body, commands[(n - converter.whole_delay - 1) % depth, channel], first)
    move(how, body, newer, h - first)


@helper
def sample(body, converter, h):
    """The position that the device measures, in m, at the end of a sample that lasted `h` seconds."""
    position = body.area / h if converter.average else body.position
    body.area = 0.0
    return position + _noise(converter)


@helper
def first_sample(body, converter):
    """The measured position at the start. Averaged sampling looks back along a free motion.

    The noise begins anew: the same seed, the same run.
    """
    converter.state = converter.seed
    position = body.position
    if converter.average:
        position -= 0.5 * converter.period * body.velocity
    return position + _noise(converter)


@helper
def sample_velocity(body, converter, h):
    """The velocity that the device measures, in m/s, at the end of a sample that lasted `h` seconds.

    At the instant it is that of the motion so far: a force that changes now, or an impulse, is not in it yet.
    """
    velocity = (body.position - converter.before) / h if converter.average else body.velocity
    converter.before = body.position
    return velocity + _noise(converter) / converter.period


@helper
def first_velocity(body, converter):
    """The measured velocity at the start, after the position: along a free motion the mean is the instant's value."""
    converter.before = body.position
    return body.velocity + _noise(converter) / converter.period


@helper
def to_counts(value, quantum):
    """(counts, whether they fit 32 bits); a value that does not fit stops at the end of the scale."""
    counts = np.rint(value / quantum)
    if not abs(counts) < 2147483648.0:
        return np.int64(math.copysign(2147483647.0, counts)), False
    return np.int64(counts), True


@helper
def _noise(converter):
    """A normal value (Box and Muller) from two that are uniform in (0, 1] (xorshift64*): the mock's own, so that the
    same seed gives the same noise everywhere."""
    if not converter.noise > 0.0:
        return 0.0
    uniform = (0.0, 0.0)
    for _ in range(2):
        x = converter.state
        x ^= x >> np.uint64(12)
        x ^= x << np.uint64(25)
        x ^= x >> np.uint64(27)
        converter.state = x
        scrambled = x * np.uint64(2685821657736338717)
        uniform = (uniform[1], (np.float64(scrambled >> np.uint64(11)) + 1.0) / 9007199254740992.0)
    radius = math.sqrt(-2.0 * math.log(uniform[0]))
    return converter.noise * radius * math.cos(2.0 * math.pi * uniform[1])
