"""The mock's converters: hold and delay of a commanded force, and measurement of position, velocity and acceleration.

Command c[n], decided during sample n, acts from (n + delay) T on, shaped by its hold. With delay = D + phi, the first
phi T of sample n has the pieces of c[n-D-1] and earlier commands; the rest also has those of c[n-D].
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from hapsim.compiling import helper
from hapsim.device.mock.motion import acceleration, move, move_together, strike, strike_together
from hapsim.holds import HOLDS, Piece

MOST_PIECES, MOST_AGES = 6, 4
_SLICES = 16  # of a piece of the force, where the sensor of the acceleration has a bandwidth

SAMPLINGS = {"ideal": 0.0, "average": 1.0}
"""Window over which the position is averaged, in sample periods, ending with the sample, by the scene's names; 0: the
position at the instant."""

PIECE = np.dtype(
    [
        ("duration", np.float64),  # this and the weights as in holds.Piece
        ("impulse", np.float64, (MOST_AGES,)),
        ("level", np.float64, (MOST_AGES,)),
        ("slope", np.float64, (MOST_AGES,)),
        ("opens", np.int64),  # 1: the window opens with it
    ],
    align=True,
)

CONVERTER = np.dtype(
    [
        ("period", np.float64),  # s, nominal
        ("whole_delay", np.int64),  # D
        ("pieces", PIECE, (MOST_PIECES,)),
        ("pieces_in_use", np.int64),
        ("ages", np.int64),  # the number of weighted commands
        ("keeps_last_force", np.int64),
        ("window", np.float64),  # of SAMPLINGS
        ("quantum", np.float64),  # m per count
        ("velocity_quantum", np.float64),  # (m/s) per count; 0: the device senses no velocity
        ("noise", np.float64),  # m rms; of the velocity, noise / period in m/s rms
        ("acceleration_quantum", np.float64),  # (m/s²) per count; 0: the device senses no acceleration
        ("acceleration_noise", np.float64),  # m/s² rms
        ("acceleration_age", np.int64),  # 0: just after the force of the next sample begins to act; 1: just before
        ("acting", np.float64),  # N, at the end of the last sample
        ("corner", np.float64),  # rad/s, of the sensor's low-pass; 0: none
        ("low_passed", np.float64),  # m/s², its value
        ("before", np.float64),  # m, the position at which the window opened
        ("seed", np.uint64),  # of the noise's generator, at each arming
        ("state", np.uint64),
    ]
)


def set_timing(converter: Any, hold: str, sampling: str, delay: float) -> int:
    """Sets hold, delay (sample periods) and sampling of a CONVERTER. Returns the number of commands to keep."""
    whole, window = math.floor(delay), SAMPLINGS[sampling]
    before, after = _split(HOLDS[hold].pieces(delay - whole), 1.0 - window)
    pieces = before + after
    converter.whole_delay, converter.keeps_last_force, converter.window = whole, HOLDS[hold].keeps_last_force, window
    converter.pieces_in_use = len(pieces)
    converter.ages = max(len(weights) for _, *each in pieces for weights in each)
    for record, (duration, *each) in zip(converter.pieces[: len(pieces)], pieces, strict=True):
        record.duration = duration
        for of_record, weights in zip((record.impulse, record.level, record.slope), each, strict=True):
            of_record[: len(weights)] = weights
    converter.pieces["opens"] = np.arange(MOST_PIECES) == len(before)
    return whole + max(2, int(converter.ages))


def _split(pieces: list[Piece], at: float) -> tuple[list[Piece], list[Piece]]:
    """Returns the pieces before and after the time `at` in the sample (sample periods), without empty ones."""
    before: list[Piece] = []
    after: list[Piece] = []
    begin = 0.0
    for piece in pieces:
        first = min(max(at - begin, 0.0), piece.duration)
        if first > 0.0:
            before.append(piece._replace(duration=first))
        if piece.duration > first:
            grown = itertools.zip_longest(piece.level, piece.slope, fillvalue=0.0)
            level = tuple(level + first * slope for level, slope in grown)
            after.append(Piece(piece.duration - first, piece.impulse if first == 0.0 else (), level, piece.slope))
        begin += piece.duration
    return before, after


@helper
def advance_body(how, body, converter, commands, depth, channel, n, h):
    """Moves one channel's body through sample n, which lasts `h` seconds. `how`: of `move`; `commands`: N, a ring of
    `depth` rows with a column for each channel."""
    gone = 0.0
    for i in range(converter.pieces_in_use):
        piece = converter.pieces[i]
        force, impulse = begin_piece(body, converter, piece, commands, depth, channel, n)
        if impulse != 0.0:
            strike(body, impulse)
        duration = piece.duration * h if i + 1 < converter.pieces_in_use else h - gone
        converter.acting = force + body.slope * duration
        if converter.corner > 0.0:
            _move_with_sensor(how, body, converter, force, duration)
        else:
            move(how, body, force, duration)
        gone += duration
    body.slope = 0.0


@helper
def begin_piece(body, converter, piece, commands, depth, channel, n):
    """Sets the slope of the force in a piece of sample n, and opens the window. Returns force (N) and impulse (N·s)."""
    newest = n - converter.whole_delay
    force, impulse, slope = 0.0, 0.0, 0.0
    for age in range(converter.ages):
        command = commands[(newest - age) % depth, channel]
        force += piece.level[age] * command
        impulse += piece.impulse[age] * command
        slope += piece.slope[age] * command
    if piece.opens:
        body.area, converter.before = 0.0, body.position
    body.slope = slope / converter.period
    return force, impulse * converter.period


@helper
def advance_together(bodies, count, coupling, converters, commands, depth, n, acts, h):
    """Moves all bodies, whose mass is a matrix, through sample n, which lasts `h` seconds. The commanded forces act for
    the first `acts` of them. Hold and delay are the same on every channel."""
    timing, gone = converters[0], 0.0
    for i in range(timing.pieces_in_use):
        for c in range(count):
            converter = converters[c]
            coupling.force[c], coupling.impulse[c] = begin_piece(
                bodies[c], converter, converter.pieces[i], commands, depth, c, n
            )
        strike_together(bodies, count, coupling)
        duration = timing.pieces[i].duration * acts if i + 1 < timing.pieces_in_use else acts - gone
        move_together(bodies, count, coupling, duration)
        gone += duration
    for c in range(count):
        coupling.force[c] = bodies[c].slope = 0.0
    if acts < h:
        move_together(bodies, count, coupling, h - acts)


@helper
def release_body(how, body, converter, h):
    """Moves one channel's body for `h` seconds without a commanded force, after its time to live."""
    converter.acting = 0.0
    if converter.corner > 0.0:
        _move_with_sensor(how, body, converter, 0.0, h)
    else:
        move(how, body, 0.0, h)


@helper
def _move_with_sensor(how, body, converter, force, h):
    """Moves a body as `move` does, and the low-pass of its acceleration: exactly for an acceleration that is a straight
    line within each of `_SLICES` slices."""
    slice_s = h / _SLICES
    u = converter.corner * slice_s
    kept = math.exp(-u)
    mean = -math.expm1(-u) / u if u > 0.0 else 1.0  # of exp(-w t) over the slice
    for i in range(_SLICES):
        at = force + body.slope * (i * slice_s)
        before = acceleration(body, at)
        move(how, body, at, slice_s)
        after = acceleration(body, at + body.slope * slice_s)
        converter.low_passed = kept * converter.low_passed + (mean - kept) * before + (1.0 - mean) * after


@helper
def sample(body, converter, h):
    """Returns the measured position, in m, at the end of a sample that lasted `h` seconds."""
    position = body.area / (converter.window * h) if converter.window > 0.0 else body.position
    body.area = 0.0
    return position + noise(converter, converter.noise)


@helper
def first_sample(body, converter):
    """Returns the measured position at the start, in m, a mean along the free motion before. Restarts the noise."""
    converter.state = converter.seed
    position = body.position
    if converter.window > 0.0:
        position -= 0.5 * converter.window * converter.period * body.velocity
    return position + noise(converter, converter.noise)


@helper
def sample_velocity(body, converter, h):
    """Returns the measured velocity, in m/s, at the end of a sample that lasted `h` seconds.

    It belongs to the motion so far, before a change of the force or an impulse at this instant.
    """
    velocity = body.velocity
    if converter.window > 0.0:
        velocity = (body.position - converter.before) / (converter.window * h)
    return velocity + noise(converter, converter.noise) / converter.period


@helper
def first_velocity(body, converter):
    """Returns the measured velocity at the start, in m/s. Call it after `first_sample`."""
    return body.velocity + noise(converter, converter.noise) / converter.period


@helper
def sample_acceleration(body, converter, commands, depth, channel, n):
    """Returns the measured acceleration, in m/s², at the instant at which sample n begins, of a body that `acting` or,
    at age 0, the force of sample n moves. That of a delay of 0 is not decided yet: then `acting` counts at age 0 too.
    """
    force, velocity = converter.acting, body.velocity
    first = converter.pieces[0]
    is_known = converter.whole_delay > 0 or (first.level[0] == 0.0 and first.impulse[0] == 0.0)
    if converter.acceleration_age == 0 and is_known:
        newest, force = n - converter.whole_delay, 0.0
        for age in range(converter.ages):
            command = commands[(newest - age) % depth, channel]
            force += first.level[age] * command
            body.velocity += first.impulse[age] * command * converter.period / body.mass
    value = acceleration(body, force) if converter.corner == 0.0 else converter.low_passed
    body.velocity = velocity
    return value + noise(converter, converter.acceleration_noise)


@helper
def first_acceleration(body, converter):
    """Returns the measured acceleration at the start, in m/s², without a commanded force. Call it after the others."""
    converter.acting, converter.low_passed = 0.0, acceleration(body, 0.0)
    return converter.low_passed + noise(converter, converter.acceleration_noise)


@helper
def to_counts(value, quantum):
    """Returns (counts, whether they fit 32 bits); other values saturate at the end of the scale."""
    counts = np.rint(value / quantum)
    if not abs(counts) < 2147483648.0:
        return np.int64(math.copysign(2147483647.0, counts)), False
    return np.int64(counts), True


@helper
def noise(generator, rms):
    """Returns a normally distributed noise value from two uniform ones (Box and Muller)."""
    if not rms > 0.0:
        return 0.0
    first, second = uniform(generator), uniform(generator)
    return rms * math.sqrt(-2.0 * math.log(first)) * math.cos(2.0 * math.pi * second)


@helper
def uniform(generator):
    """Returns a value in (0, 1] of the generator xorshift64*: a seed gives the same run on every machine."""
    x = generator.state
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    generator.state = x
    return (np.float64(x * np.uint64(2685821657736338717) >> np.uint64(11)) + 1.0) / 9007199254740992.0
