"""The mock's converters: what the body's position and velocity become on the wire, and when a commanded force acts on
the body.

Command c[n], decided during sample n, acts from (n + delay) T on, as its hold says. With delay = D + phi, sample n sees
what c[n-D-1] and those before it leave for its first phi T, and c[n-D] with them for the rest.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from hapsim.compiling import helper
from hapsim.device.mock.motion import move, strike
from hapsim.holds import HOLDS, Piece

MOST_PIECES, MOST_AGES = 6, 4

SAMPLINGS = {"ideal": 0.0, "average": 1.0}
"""By a scene's names for what is measured, the window, in sample periods that end with the sample, over which it is the
mean of the position; 0: the position at the instant."""

PIECE = np.dtype(
    [
        ("duration", np.float64),  # of a Piece of a hold, as are its weights
        ("impulse", np.float64, (MOST_AGES,)),
        ("level", np.float64, (MOST_AGES,)),
        ("slope", np.float64, (MOST_AGES,)),
        ("opens", np.int64),  # whether the window opens with it
    ],
    align=True,
)

CONVERTER = np.dtype(
    [
        ("period", np.float64),  # s, nominal
        ("whole_delay", np.int64),  # D
        ("pieces", PIECE, (MOST_PIECES,)),
        ("pieces_in_use", np.int64),
        ("ages", np.int64),  # how many commands they weigh
        ("keeps_last_force", np.int64),
        ("window", np.float64),  # of SAMPLINGS
        ("quantum", np.float64),  # m per count
        ("velocity_quantum", np.float64),  # (m/s) per count; 0: the device senses no velocity
        ("noise", np.float64),  # m rms, and as many periods of it as there are in a second, in m/s rms, of the velocity
        ("before", np.float64),  # m, where the body was when the window opened
        ("seed", np.uint64),  # where the noise's generator starts when the device is armed
        ("state", np.uint64),  # where it stands
    ]
)


def set_timing(converter: Any, hold: str, sampling: str, delay: float) -> int:
    """Sets how a CONVERTER holds a command that is `delay` sample periods late, and how it measures; how many samples
    of commands that takes."""
    whole, window = math.floor(delay), SAMPLINGS[sampling]
    opens, pieces = _split(HOLDS[hold].pieces(delay - whole), 1.0 - window)
    converter.whole_delay, converter.keeps_last_force, converter.window = whole, HOLDS[hold].keeps_last_force, window
    converter.pieces_in_use = len(pieces)
    converter.ages = max(len(weights) for _, *each in pieces for weights in each)
    for record, (duration, *each) in zip(converter.pieces[: len(pieces)], pieces, strict=True):
        record.duration = duration
        for of_record, weights in zip((record.impulse, record.level, record.slope), each, strict=True):
            of_record[: len(weights)] = weights
    converter.pieces["opens"] = np.arange(MOST_PIECES) == opens
    return whole + max(2, int(converter.ages))


def _split(pieces: list[Piece], at: float) -> tuple[int, list[Piece]]:
    """Those of the pieces that last, one of which begins `at` sample periods into the sample, and which that is: after
    the last where none does."""
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
    return len(before), before + after


@helper
def advance_body(how, body, converter, commands, depth, channel, n, h):
    """Moves one channel's body through sample n, which lasts `h` seconds. `how`: see `move`; `commands`: N, the last
    `depth` rows of them, a column for each channel."""
    newest, gone = n - converter.whole_delay, 0.0
    for i in range(converter.pieces_in_use):
        piece = converter.pieces[i]
        force, impulse, slope = 0.0, 0.0, 0.0
        for age in range(converter.ages):
            command = commands[(newest - age) % depth, channel]
            force += piece.level[age] * command
            impulse += piece.impulse[age] * command
            slope += piece.slope[age] * command
        if piece.opens:
            body.area, converter.before = 0.0, body.position
        if impulse != 0.0:
            strike(body, impulse * converter.period)
        duration = piece.duration * h if i + 1 < converter.pieces_in_use else h - gone
        body.slope = slope / converter.period
        move(how, body, force, duration)
        gone += duration
    body.slope = 0.0


@helper
def sample(body, converter, h):
    """The position that the device measures, in m, at the end of a sample that lasted `h` seconds."""
    position = body.area / (converter.window * h) if converter.window > 0.0 else body.position
    body.area = 0.0
    return position + _noise(converter)


@helper
def first_sample(body, converter):
    """The measured position at the start. A mean looks back along a free motion.

    The noise begins anew: the same seed, the same run.
    """
    converter.state = converter.seed
    position = body.position
    if converter.window > 0.0:
        position -= 0.5 * converter.window * converter.period * body.velocity
    return position + _noise(converter)


@helper
def sample_velocity(body, converter, h):
    """The velocity that the device measures, in m/s, at the end of a sample that lasted `h` seconds.

    At the instant it is that of the motion so far: a force that changes now, or an impulse, is not in it yet.
    """
    velocity = body.velocity
    if converter.window > 0.0:
        velocity = (body.position - converter.before) / (converter.window * h)
    return velocity + _noise(converter) / converter.period


@helper
def first_velocity(body, converter):
    """The measured velocity at the start, after the position: along a free motion the mean is the instant's value."""
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
    """A normal value, from two that are uniform (Box and Muller)."""
    if not converter.noise > 0.0:
        return 0.0
    first, second = uniform(converter), uniform(converter)
    radius = math.sqrt(-2.0 * math.log(first))
    return converter.noise * radius * math.cos(2.0 * math.pi * second)


@helper
def uniform(generator):
    """A value in (0, 1] (xorshift64*) from a record with a `state`: the mock's own, so that the same seed gives the
    same run everywhere."""
    x = generator.state
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    generator.state = x
    scrambled = x * np.uint64(2685821657736338717)
    return (np.float64(scrambled >> np.uint64(11)) + 1.0) / 9007199254740992.0
