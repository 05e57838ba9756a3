"""The callback of a sound card, compiled: it reads the loop's ring at the pace of the card's own clock.

A block's first frame is that of the time `delay` ago. Two clocks are compared for that: every block knows how many
frames the card has played, and by the ring's time how many the device has moved the scene by. A line is fitted to the
two (least squares over all blocks at first, later over the last 30 s: an alpha-beta filter), and the reading place is
steered to the line, less the delay, in a quarter of the line's time. So the jitter of either side moves the pitch by
parts in a million at most, and in no steps. zita-ajbridge does the same, with a loop filter in place of the fit.

Frames between the ring's are those of a windowed sinc (Kaiser, 96 dB): 64 taps at the lower of the two rates, from a
table with lines between its phases. Where frames are missing, the last value decays within some milliseconds and the
sound fades in again. Nothing here allocates, locks or calls the system (the clock is read in the user's address space).
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from firmware_protocol import schema
from firmware_protocol.compiled import ONE, new_record
from hapsim.compiling import fence, helper, reassociated
from hapsim.compiling.native import address_of, array_at, native, record_at
from hapsim.loop.histogram import HISTOGRAM, note
from hapsim.loop.sound import SOUND_RING, SoundRing
from hapsim.loop.system import SCRATCH, flush_denormals, now_ns, restore_denormals

CHUNK = 64  # frames that are computed at once
_HALF = 32  # taps on either side, at the lower rate
_SIDELOBES_DB = 96.0
_PHASES = 512
_FIRST_S, _MEMORY_S = 0.5, 30.0  # of the fitted line: how much the nominal rate counts for, and how far back it goes
_STEERING = 0.25  # of the memory: the time constant of the steering
_MOST_STEERING = 1e-3  # of the ratio: less than two cents
_OUTLIER_S, _PATIENCE_S = 2e-3, 0.25  # a measured place is off by no more, or for no longer
_FADE_S, _DECAY_S = 0.01, 0.003
_MOST_OFF = 0.05  # of the slope from the nominal one: there is room for no more
_STALE_PERIODS = 4.0
_MARGIN_S = 1e-3  # that wake-ups of the loop and of the card are late by, all the same
_UNDERFLOW = 4  # PortAudio's flag

PLAYER = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("ring", np.uint64),  # address of a SOUND_RING
        ("channels", np.int64),  # of the ring
        ("outputs", np.int64),  # of the card
        ("rate_hz", np.float64),  # of the card
        ("burst", np.int64),  # frames that come at once
        ("stale_ns", np.int64),  # age of a ring's time that says nothing any more
        ("volume", np.float64),
        ("latency_s", np.float64),  # from the arrival of a position to the loudspeaker, as asked for
        ("delay", np.float64),  # frames of the ring from the line to the reading place
        ("output_s", np.float64),  # the card's own latency, where a block does not say
        ("quiet", np.int64),  # set by another thread: the sound fades out
        # The filter
        ("half", np.int64),  # taps on either side
        ("phases", np.int64),
        ("table", np.uint64),  # address of (phases + 1, 2 half) float32
        ("taps", np.uint64),  # address of 2 half float32, for one frame
        ("work", np.uint64),  # address of (channels, room) float32: what a chunk reads
        ("room", np.int64),
        # The line: frames of the ring over frames of the card
        ("begun", np.int64),
        ("memory", np.float64),  # frames of the card
        ("line", np.float64),  # frames that the device has moved the scene by, now
        ("slope", np.float64),
        ("nominal", np.float64),  # slope
        ("outliers", np.int64),  # frames of the card since the line began to be off
        # The sound
        ("playing", np.int64),
        ("place", np.int64),  # the frame that is read,
        ("part", np.float64),  # and the part of one behind it
        ("ratio", np.float64),  # frames of the ring for one of the card
        ("fade", np.float64),
        ("held", np.float32, (schema.MAX_CHANNELS,)),  # the last values, which decay after a gap
        ("newest", np.float32, (schema.MAX_CHANNELS,)),
        # For the report
        ("blocks", np.int64),
        ("frames", np.int64),  # of the card
        ("underruns", np.int64),  # times that the ring had no frames for the card,
        ("card_underruns", np.int64),  # and that this came too late for it
        ("lost", np.int64),  # frames of the ring that were overwritten before
        ("latency", HISTOGRAM),  # ns, of each block: from the arrival of a position to the loudspeaker
        ("simulated_ns", np.int64),  # the time, of a simulated card; 0: the clock's
        SCRATCH,
    ],
    align=True,
)


class Player:
    """The memory of the callback."""

    def __init__(
        self, ring: SoundRing, hz: tuple[float, float], *, burst: int, outputs: int, latency_s: float, volume: float
    ) -> None:
        """`hz`: of the ring and of the card; `burst`: frames that the ring gets at once; `latency_s`: from the arrival
        of a position to the loudspeaker, or what is needed if that is more."""
        ratio, channels = hz[0] / hz[1], int(ring.record.channels)
        half, table = half_length(ratio), filter_table(ratio)
        room = math.ceil((CHUNK + 1) * ratio * (1.0 + _MOST_OFF) * (1.0 + _MOST_STEERING)) + 2 * half + 2
        self._memory = table, np.ones(2 * half, np.float32), np.ones((channels, room), np.float32), ring
        self.record = record = new_record(PLAYER)
        """PLAYER."""
        record.table, record.taps, record.work = (array.ctypes.data for array in self._memory[:3])
        record.address, record.ring = address_of(record), ring.record.address
        record.channels, record.outputs, record.rate_hz, record.burst = channels, outputs, hz[1], burst
        record.stale_ns = round(1e9 * (_STALE_PERIODS * burst / hz[0] + _OUTLIER_S))
        record.half, record.phases, record.room = half, len(table) - 1, room
        record.slope = record.nominal = record.ratio = ratio
        record.latency_s, record.volume = latency_s, volume


_player_at, _ring_at = record_at(PLAYER), record_at(SOUND_RING)
_floats_at, _doubles_at = array_at(np.float32), array_at(np.float64)


def half_length(ratio: float) -> int:
    """Returns how many frames of the ring the filter reads on either side. `ratio`: the ring's rate to the card's."""
    return math.ceil(_HALF * max(1.0, ratio))


def filter_table(ratio: float) -> np.ndarray:
    """Returns the filter, (phases + 1, taps) float32: row p for a place p/phases behind a frame. It passes 0.40 of the
    lower rate, and takes 96 dB from 0.5 of it on."""
    half, phases = half_length(ratio), math.ceil(_PHASES / max(1.0, ratio))
    transition = (_SIDELOBES_DB - 8.0) / (2.285 * 2.0 * math.pi * (2 * half - 1))
    cutoff = 0.5 / max(1.0, ratio) - 0.5 * transition
    distance = np.arange(phases + 1)[:, None] / phases + (half - 1.0 - np.arange(2 * half))
    window = np.i0(0.1102 * (_SIDELOBES_DB - 8.7) * np.sqrt(np.maximum(1.0 - (distance / half) ** 2, 0.0)))
    rows = np.sinc(2.0 * cutoff * distance) * window
    return (rows / rows.sum(axis=1, keepdims=True)).astype(np.float32)


@native(types.int64, *[types.uint64] * 6, bulk=True)
def play(_unused, output, count, times, flags, player):
    """PortAudio's callback: fills `count` frames of `output`. `player`: address of a PLAYER."""
    player = _player_at(player)
    mode = flush_denormals()
    ring, out = _ring_at(player.ring), _floats_at(output, np.int64(count) * player.outputs)
    frames = np.int64(count)
    player.blocks += 1
    if flags & np.uint64(_UNDERFLOW):
        player.card_underruns += 1
    _follow_line(player, ring, frames)
    output_s = _output_latency(player, times)
    _steer(player, ring, frames, output_s)
    if player.playing:
        behind = player.line - player.place - player.part
        note(player.latency, np.int64(1e9 * (output_s + behind / (player.slope * player.rate_hz))))
    first = np.int64(0)
    while first < frames:
        some = frames - first
        if some > CHUNK:
            some = np.int64(CHUNK)
        if player.playing and not _has_frames(player, ring, some):
            _interrupt(player)
        _fill(player, ring, out, first, some)
        first += some
    player.frames += frames
    restore_denormals(mode)
    return 0


@helper
def _follow_line(player, ring, frames):
    """Compares the two clocks: corrects the line to this block's first frame."""
    now = now_ns(player.scratch) if player.simulated_ns == 0 else player.simulated_ns
    version = ring.version
    fence()
    written, time_ns = ring.written, ring.time_ns
    fence()
    is_whole = version == ring.version and version & 1 == 0
    age = now - time_ns
    if not is_whole or written == 0 or age > player.stale_ns:
        player.line += player.slope * frames
        return
    age_frames = (age if age > 0 else 0) * 1e-9 * player.slope * player.rate_hz
    if not player.begun:
        player.begun, player.line, player.memory = 1, written + age_frames, _FIRST_S * player.rate_hz
        return
    player.line += player.slope * frames
    off = written + age_frames - player.line
    most = _OUTLIER_S * player.slope * player.rate_hz
    player.outliers = player.outliers + frames if abs(off) > most else 0
    if player.outliers > _PATIENCE_S * player.rate_hz:
        player.line, player.memory, player.outliers = player.line + off, _FIRST_S * player.rate_hz, 0
        return
    off = min(max(off, -most), most)
    n = max(player.memory / frames, 3.0)
    player.line += off * (4.0 * n - 2.0) / (n * (n + 1.0))
    slope = player.slope + off * 6.0 / (n * (n + 1.0) * frames)
    player.slope = min(max(slope, (1.0 - _MOST_OFF) * player.nominal), (1.0 + _MOST_OFF) * player.nominal)
    player.memory = min(player.memory + frames, _MEMORY_S * player.rate_hz)


@helper
def _output_latency(player, times):
    """Returns the time in s until the card plays this block; what it declares where the block does not say."""
    if times != 0:
        clock = _doubles_at(times, 3)  # PaStreamCallbackTimeInfo: input, now, output
        ahead = clock[2] - clock[1]
        if 0.0 < ahead < 1.0:
            return ahead
    return player.output_s


@helper
def _steer(player, ring, frames, output_s):
    """Chooses the ratio of this block; starts to play, or to play again, where there are frames."""
    frames_per_s = player.slope * player.rate_hz
    needed = player.slope * frames + _MARGIN_S * frames_per_s + player.half + player.burst
    if not player.playing:
        player.delay = (player.latency_s - output_s) * frames_per_s
    player.delay = max(player.delay, needed)
    target = player.line - player.delay
    if player.playing:
        off = player.place + player.part - target
        if abs(off) <= 0.5 * player.delay:
            most = _MOST_STEERING * player.slope
            player.ratio = player.slope + min(max(-off / (_STEERING * player.memory), -most), most)
            return
        _interrupt(player)  # one of the clocks has leapt
    if not player.begun or player.quiet:
        return
    player.place = np.int64(math.floor(target))
    player.part, player.ratio = target - player.place, player.slope
    if player.place >= player.half and _has_frames(player, ring, frames):
        player.playing, player.fade = 1, 0.0


@helper
def _interrupt(player):
    """Stops the playback for lack of frames: the last values decay from here on."""
    player.underruns += player.quiet == 0
    for c in range(np.uint64(player.channels)):
        player.held[c] = player.newest[c]
    player.playing, player.fade = 0, 0.0


@helper
def _has_frames(player, ring, frames):
    """Returns True if the ring has the input of these frames of the card; counts overwritten frames."""
    last = player.place + np.int64(player.part + player.ratio * (frames - 1)) + player.half + 1  # for rounding
    lost = ring.pushed + 1 - ring.capacity - (player.place - player.half + 1)
    if lost > 0:
        player.lost += lost
    return lost <= 0 and last < ring.written


@helper
def _fill(player, ring, out, first, frames):
    """Computes frames of the card, on every output."""
    count, outputs, channels = np.uint64(2 * player.half), np.uint64(player.outputs), np.uint64(player.channels)
    taps, work = _floats_at(player.taps, 2 * player.half), _floats_at(player.work, player.channels * player.room)
    if player.playing:
        _gather(player, ring, work, frames)
    begin, rise = player.place, 1.0 / (_FADE_S * player.rate_hz)
    decay = np.float32(1.0 - 1.0 / (_DECAY_S * player.rate_hz))
    for frame in range(frames):
        gain = np.float32(player.volume * player.fade)
        if player.playing:
            _interpolate_taps(player, taps)
        for c in range(channels):
            player.held[c] *= decay
            value = player.held[c]
            if player.playing:
                at = c * np.uint64(player.room) + np.uint64(player.place - begin)
                value += gain * _product(taps, work, at, count)
            player.newest[c] = value
        for output in range(outputs):
            source = output if channels > ONE else np.uint64(0)
            value = player.newest[source] if source < channels else np.float32(0.0)
            out[np.uint64(first + frame) * outputs + output] = value
        if player.playing:
            player.part += player.ratio
            whole = np.int64(player.part)
            player.place += whole
            player.part -= whole
            player.fade = max(player.fade - rise, 0.0) if player.quiet else min(player.fade + rise, 1.0)


@helper
def _gather(player, ring, work, frames):
    """Copies what these frames read, channel by channel."""
    channels, mask = np.uint64(player.channels), np.uint64(ring.capacity - 1)
    source = _floats_at(ring.frames, ring.capacity * ring.channels)
    first = np.uint64(player.place - player.half + 1)
    count = np.uint64(np.int64(player.part + player.ratio * (frames - 1)) + 2 * player.half + 1)
    for i in range(count):
        at = ((first + i) & mask) * channels
        for c in range(channels):
            work[c * np.uint64(player.room) + i] = source[at + c]


@helper
def _interpolate_taps(player, taps):
    count = np.uint64(2 * player.half)
    table = _floats_at(player.table, (player.phases + 1) * 2 * player.half)
    phase = player.part * player.phases
    row = np.int64(phase)
    share, at = np.float32(phase - row), np.uint64(row) * count
    for i in range(count):
        taps[i] = table[at + i] + share * (table[at + count + i] - table[at + i])


@reassociated
def _product(taps, work, at, count):
    total = np.float32(0.0)
    for i in range(count):
        total += taps[i] * work[at + i]
    return total
