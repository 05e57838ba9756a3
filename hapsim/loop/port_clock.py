"""The clock of a port: when its device sampled, estimated from the arrivals of its positions.

A position arrives late by a delay that jitters: by 125 µs on USB, by more where this machine wakes up late. The age of
another port's position is a difference of two such times, and its jitter would be a force: at 0.1 m/s, 125 µs are
0.025 N on 2000 N/m, and 0.06 N on 5 N·s/m. So the times are those of a line through the arrivals, fitted by least
squares over the last MEMORY_S: a second-order loop, whose gains are those of the growing fit until then.

* A device's clock differs from this machine's by at most CLOCKS_APART, so that the first arrivals, too, give no wild
  period.
* An arrival that is off the line by more than OFF_LINE_NS counts as if it were off by that, and leaves the
  period as it is: a machine that was held up hardly moves the line.
* Where all arrivals are off the line, to one side, for RESTART_S, the line begins anew there, with the period of
  before: the device was held up, or the way to it changed.

In virtual time the times are exact: `follows` is 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiling import inlined
from hapsim.loop.buffers import clip

MEMORY_S = 1.0
CLOCKS_APART = 1.5e-3  # 1000 ppm of the device's, and what this machine's own may be off
OFF_LINE_NS = 125_000.0  # USB's
RESTART_S = 0.05

PORT_CLOCK = np.dtype(
    [
        ("time_ns", np.float64),  # when the newest position was sampled, with the mean delay of arrivals
        ("period_ns", np.float64),  # from one to the next
        ("nominal_ns", np.float64),  # by the scene's rate
        ("follows", np.int64),  # 1: the arrivals; 0: virtual time
        ("arrivals", np.int64),  # since the line began,
        ("fitted", np.int64),  # and of those that the period was fitted to,
        ("most_arrivals", np.int64),  # the most that count
        ("side", np.int64),  # on which the last arrivals were off the line; 0: neither,
        ("off_since_ns", np.int64),  # and since when
    ],
    align=True,
)


@inlined
def advance_clock(clock, now_ns, gap):
    """Goes on by `gap` samples to a position that arrived at `now_ns`."""
    clock.time_ns += gap * clock.period_ns
    if clock.follows == 0:
        return
    off = now_ns - clock.time_ns
    if clock.arrivals == 0 or _is_elsewhere(clock, off, now_ns):
        clock.time_ns, clock.arrivals, clock.side = np.float64(now_ns), 1, 0
        clock.fitted = max(clock.fitted, 1)
        return
    clock.arrivals = min(clock.arrivals + 1, clock.most_arrivals)
    n = np.float64(clock.arrivals)
    clock.time_ns += clip(off, OFF_LINE_NS) * (4.0 * n - 2.0) / (n * (n + 1.0))
    if clock.side == 0:
        clock.fitted = min(clock.fitted + 1, clock.most_arrivals)
        n = np.float64(clock.fitted)
        apart = clock.period_ns + off / gap * 6.0 / (n * (n + 1.0)) - clock.nominal_ns
        clock.period_ns = clock.nominal_ns + clip(apart, CLOCKS_APART * clock.nominal_ns)


@inlined
def _is_elsewhere(clock, off, now_ns):
    """Returns whether all arrivals are off the line, to the side of this one, for too long."""
    side = 1 if off > OFF_LINE_NS else -1 if off < -OFF_LINE_NS else 0
    if side != clock.side:
        clock.side, clock.off_since_ns = side, now_ns
    return side != 0 and now_ns - clock.off_since_ns > RESTART_S * 1e9


def set_clock(clock: Any, *, rate_hz: float, follows: bool, first_ns: float = 0.0, ppm: float = 0.0) -> None:
    """Fills a PORT_CLOCK. In virtual time the first sample is at `first_ns`, and the device's clock is `ppm` millionths
    faster than nominal."""
    clock.nominal_ns = 1e9 / rate_hz
    clock.period_ns = clock.nominal_ns / (1.0 + 1e-6 * ppm)
    clock.follows, clock.time_ns = follows, first_ns - clock.period_ns
    clock.most_arrivals = max(round(MEMORY_S * rate_hz), 2)
