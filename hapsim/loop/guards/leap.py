"""A position that is farther off than any force or blow can have brought a hand: the loop stops before it answers.

From one sample to the next a position changes by what it changed before, and by what forces make of that.
`watch_for_leaps` says how far that is; STABILITY.md says why no hand gets there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import inlined

HAND_N = 200.0  # a hand pushes and pulls with less
LEAST_MASS = 0.1  # of the declared one: what is left where the hand lets go. With it, blows of ten times HAND_N
HAND_M_PER_S = 10.0  # up to here a hand, or what it runs into, may reverse within a sample
SENSOR_M = 0.005  # what a sensor may add; noise that is known comes to it,
NOISE_RMS = 20.0  # so many times, where one sample in 1e15 has more than 8 (of a second difference's 2.45 rms)

_EACH = (schema.MAX_CHANNELS,)

LEAP = np.dtype(
    [
        ("channels", np.int64),  # so many are judged
        ("by_host", np.int64),  # 1: the host paces, and samples last as long as it takes
        ("last", np.float64, _EACH),  # m, the last position that was read
        ("span", np.float64),  # sample periods from the position before the last to the last
        ("pace", np.float64, _EACH),  # m per sample period, of the last step,
        ("pace_before", np.float64, _EACH),  # and of the one before
        ("sent_ns", np.int64),  # when the force had left that asked for the last position
        ("accelerated", np.float64, _EACH),  # m per sample period squared, by every force together
        ("sprung", np.float64, _EACH),  # the same, for each m that the device's own spring is stretched
        ("braked", np.float64, _EACH),  # share of the pace that the device's friction may take in a period
        ("reversed", np.float64),  # m per sample period: the fastest that a blow turns round
        ("sensed", np.float64, _EACH),  # m
        ("leapt_m", np.float64),  # what was found to be too far off,
        ("bound_m", np.float64),  # what could have been,
        ("channel", np.int64),  # and where
    ],
    align=True,
)


@inlined
def is_leap(leap, io, state, gap, now, period_ns):
    """Whether the position newly in `io.measured`, which arrived at `now` (ns), `gap` samples after the last one, is
    where none can be. `state`: as it was with that one. The first two begin a motion at any speed."""
    periods = np.float64(gap)
    if leap.by_host:
        # The device samples when it is asked; the longer of the two times, for either may be held up.
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
        # Of the last two steps: a blow that fell within the last one has left little of it.
        now_at, before = abs(leap.pace[c]), abs(leap.pace_before[c])
        speed = now_at if now_at > before else before
        leap.pace_before[c] = leap.pace[c]
        leap.pace[c] = step / periods
        turned = 2.0 * (speed if speed < leap.reversed else leap.reversed)
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
) -> None:
    """Fills a LEAP for the channels of a scene. All of shape (channels,), SI units: the least declared mass, the most
    friction and stiffness of the device, every force but the hand's, and the m per count; `noise_m`: the sensor's rms
    noise, as far as it is known.

    With A = (force + HAND_N) / (LEAST_MASS mass), T the sample period, v the larger speed of the last two steps, a
    position may be off the straight line of the two before it by

        A T² + 2 min(v, HAND_M_PER_S) T + min(1, b0 T / (LEAST_MASS m)) v T + k0 T² / (LEAST_MASS m) abs(x) + S

    with S = SENSOR_M + NOISE_RMS noise + 4 counts; over lost positions by as much more as a longer time lets it.
    """
    period, channels = 1.0 / rate_hz, mass.size
    least = LEAST_MASS * mass
    with np.errstate(over="ignore"):
        leap.channels, leap.by_host, leap.span = channels, by_host, 1.0
        leap.accelerated[:channels] = (force + HAND_N) / least * period**2
        leap.sprung[:channels] = stiffness / least * period**2
        # Where the host paces, nobody tells to the microsecond how long a sample was: a whole step may be wrong.
        leap.braked[:channels] = 1.0 if by_host else friction / least * period
        leap.reversed = HAND_M_PER_S * period
        leap.sensed[:channels] = SENSOR_M + NOISE_RMS * noise_m + 4.0 * count_m
