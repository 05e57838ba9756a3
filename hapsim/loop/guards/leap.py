"""The loop stops before it answers a position where no force or blow can have brought a hand.

`watch_for_leaps` has the bound; STABILITY.md explains it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import inlined
from hapsim.scales import Scale

LEAST_MASS = 0.1  # of the declared one, where the hand lets go. It also allows blows of ten times a hand's force
NOISE_RMS = 20.0  # of the noise; one sample in 1e15 has more than 8 (a second difference has 2.45 rms)

_EACH = (schema.MAX_CHANNELS,)

LEAP = np.dtype(
    [
        ("channels", np.int64),  # that are judged
        ("by_host", np.int64),  # 1: the host paces, and samples last as long as it takes
        ("last", np.float64, _EACH),  # m, the last position that was read
        ("span", np.float64),  # sample periods from the position before the last to the last
        ("pace", np.float64, _EACH),  # m per sample period, of the last step,
        ("pace_before", np.float64, _EACH),  # and of the one before
        ("sent_ns", np.int64),  # when the force had left that asked for the last position
        ("accelerated", np.float64, _EACH),  # m per sample period squared, by all forces together,
        ("sprung", np.float64, _EACH),  # and by the device's own spring, per m of stretch
        ("braked", np.float64, _EACH),  # share of the pace that the device's friction may take in a period
        ("reversed", np.float64, _EACH),  # m per sample period: the fastest that a blow reverses
        ("sensed", np.float64, _EACH),  # m
        ("leapt_m", np.float64),  # the leap that was found,
        ("bound_m", np.float64),  # its bound,
        ("channel", np.int64),  # and its channel
    ],
    align=True,
)


@inlined
def is_leap(leap, io, state, gap, now, period_ns):
    """Whether the position in `io.measured`, which arrived at `now` (ns), `gap` samples after the last one, is a leap.
    `state`: of the last one. The first two positions begin a motion at any speed."""
    periods = np.float64(gap)
    if leap.by_host:
        # The device samples on request. The longer of the two times counts: either may be delayed.
        asked, heard = state.sent_ns - leap.sent_ns, now - state.newest_ns
        elapsed = np.float64(asked if asked > heard else heard) / period_ns
        leap.sent_ns = state.sent_ns
        periods = elapsed if elapsed > periods else periods
    mean = 0.5 * (periods + leap.span)
    leap.span = periods
    found = False
    for c in range(np.uint64(leap.channels)):
        last = leap.last[c]
        leap.last[c] = io.measured[c]
        step = io.measured[c] - last
        off = abs(step - leap.pace[c] * periods)
        # The faster of the last two steps, since a blow within the last one has slowed it.
        now_at, before = abs(leap.pace[c]), abs(leap.pace_before[c])
        speed = now_at if now_at > before else before
        leap.pace_before[c] = leap.pace[c]
        leap.pace[c] = step / periods
        turned = 2.0 * (speed if speed < leap.reversed[c] else leap.reversed[c])
        braked = leap.braked[c] * mean
        bound = leap.sensed[c] + periods * (
            turned
            + (braked if braked < 1.0 else 1.0) * speed
            + mean * (leap.accelerated[c] + leap.sprung[c] * (abs(last) + speed * mean))
        )
        if off > bound and state.ticks > 1:
            leap.leapt_m, leap.bound_m, leap.channel = off, bound, c
            found = True
    return found


def watch_for_leaps(
    leap: Any,
    *,
    rate_hz: float,
    by_host: bool,
    mass: np.ndarray,
    friction: np.ndarray,
    stiffness: np.ndarray,
    force: np.ndarray,
    noise_m: float,
    count_m: np.ndarray,
    scales: Sequence[Scale],
) -> None:
    """Fills a LEAP. Arrays have the shape (channels,), in SI units: the least declared mass, the largest friction and
    stiffness of the device, the sum of all forces but the hand's, and the m per count; `noise_m`: rms;
    `scales`: of each channel's motion.

    With A = (force + hand_force) / (LEAST_MASS mass), T the sample period, v the larger speed of the last two steps, a
    position may be off the line through the two before it by

        A T² + 2 min(v, hand_speed) T + min(1, b0 T / (LEAST_MASS m)) v T + k0 T² / (LEAST_MASS m) abs(x) + S

    with S = sensor + NOISE_RMS noise + 4 counts; over lost positions by more, for the longer time.
    """
    period, channels = 1.0 / rate_hz, mass.size
    least = LEAST_MASS * mass
    hand_force, speed, sensor = np.transpose([(one.hand_force, one.hand_speed, one.sensor) for one in scales])
    with np.errstate(over="ignore"):
        leap.channels, leap.by_host, leap.span = channels, by_host, 1.0
        leap.accelerated[:channels] = (force + hand_force) / least * period**2
        leap.sprung[:channels] = stiffness / least * period**2
        # Where the host paces, the length of a sample is uncertain: a whole step may be wrong.
        leap.braked[:channels] = 1.0 if by_host else friction / least * period
        leap.reversed[:channels] = speed * period
        leap.sensed[:channels] = sensor + NOISE_RMS * noise_m + 4.0 * count_m
