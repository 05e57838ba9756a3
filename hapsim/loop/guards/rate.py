"""The loop stops, after a second or two, if a device does not sample at the rate that it declares.

At half the rate a damper damps twice as much, and a spring takes twice the damping back: no prediction holds.

The guard compares the device's own count of samples with the host's clock, over windows of at least a quarter of a
second. Several in a row have to be off to the same side, because a delay of the host makes one window long and the next
one short. It judges nothing where the host paces, in virtual time, and where the mock runs in this process.
"""

from __future__ import annotations

import numpy as np

from hapsim.compiling import inlined

WINDOW_NS = 250_000_000  # by the declared rate
WINDOW_SAMPLES = 64  # at least
WINDOWS = 4  # in a row
MOST_OFF = 1.5

WATCH = np.dtype(
    [
        ("judges", np.int64),  # 1: the device has a timer of its own that is to be judged
        ("opened_ns", np.int64),  # when this window's first position arrived; 0: before the first window
        ("opened_sample", np.int64),  # and which one it was
        ("long", np.int64),  # windows in a row that lasted too long,
        ("short", np.int64),  # or not long enough
        ("rate_hz", np.float64),  # of the last window that did not fit
    ],
    align=True,
)


@inlined
def is_off_rate(watch, sample, now, period_ns):
    """Whether the positions, of which number `sample` arrived at `now` (ns), have come at another rate for long."""
    if watch.judges == 0:
        return False
    samples = sample - watch.opened_sample
    if watch.opened_ns != 0:
        if samples < WINDOW_SAMPLES or samples * period_ns < WINDOW_NS:
            return False
        lasted = now - watch.opened_ns
        nominal = samples * period_ns
        watch.long = watch.long + 1 if lasted > MOST_OFF * nominal else 0
        watch.short = watch.short + 1 if lasted * MOST_OFF < nominal else 0
        if watch.long + watch.short > 0:
            watch.rate_hz = samples * 1e9 / (lasted if lasted > 0 else 1)
    watch.opened_ns = now
    watch.opened_sample = sample
    return watch.long >= WINDOWS or watch.short >= WINDOWS
