"""The rate guard: it stops the loop, after a second or two, if a device does not sample at its declared rate.

At half the rate a damper damps twice as much, and a spring removes twice as much damping: no prediction holds.

The guard compares the device's own count of samples with the host's clock, over windows of at least a quarter of a
second. Several windows in a row must be off to the same side, because a delay of the host makes one window long and the
next one short. It is disabled if the host paces, in virtual time, and for a mock in this process.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiling.native import record_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, tick_at
from hapsim.prediction.timing import FIRST_SAMPLES

TOO_LATE, WRONG_RATE = -25, -26

WINDOW_NS = 250_000_000  # by the declared rate
WINDOW_SAMPLES = 64  # at least
WINDOWS = 4  # in a row
MOST_OFF = 1.5

WATCH = np.dtype(
    [
        ("period_ns", np.int64),  # 0: the device has no timer to judge
        ("opened_ns", np.int64),  # arrival of this window's first position; 0: before the first window
        ("opened_sample", np.int64),  # and its sample
        ("long", np.int64),  # windows in a row that were too long,
        ("short", np.int64),  # or too short
        ("rate_hz", np.float64),  # of the last window that was either
    ],
    align=True,
)


_watch_at = record_at(WATCH)


@hook
def judge_rate(watch, tick):
    """Judges the rate at the end of every window: WRONG_RATE or 0."""
    watch, tick = _watch_at(watch), tick_at(tick)
    samples = tick.sample - watch.opened_sample
    if watch.opened_ns != 0:
        if samples < WINDOW_SAMPLES or samples * watch.period_ns < WINDOW_NS:
            return 0
        lasted = tick.now_ns - watch.opened_ns
        nominal = samples * watch.period_ns
        watch.long = watch.long + 1 if lasted > MOST_OFF * nominal else 0
        watch.short = watch.short + 1 if lasted * MOST_OFF < nominal else 0
        if watch.long + watch.short > 0:
            watch.rate_hz = samples * 1e9 / (lasted if lasted > 0 else 1)
    watch.opened_ns = tick.now_ns
    watch.opened_sample = tick.sample
    return WRONG_RATE if watch.long >= WINDOWS or watch.short >= WINDOWS else 0


def _set_up(loop: Any, setting: Setting) -> Any:
    if setting.scene.device.clock != "device" or not setting.behind_port:
        return None
    loop.watch.period_ns = loop.control.period_ns
    return loop.watch


def _sentence(run: EndedRun) -> str:
    return (
        f"the device samples at {run.loop.watch.rate_hz:.4g} Hz, where it declares {run.report.nominal_rate_hz:g} Hz; "
        f"stopped after {run.report.ticks} ticks. At another rate than the scene's, stiffness and damping feel "
        "different: set the device's timer right"
    )


GUARD = Guard("watch", WATCH, {Stage.JUDGE: judge_rate}, _set_up, WRONG_RATE, "wrong rate", _sentence)

# The first forces: if most of them are late, the wire is slower than the run assumed.

FIRST = np.dtype([("ticks", np.int64)], align=True)
"""Number of ticks to judge after arming. If most of their forces are late, the scene would shake the hand."""

_first_at = record_at(FIRST)


@hook
def judge_first_forces(first, tick):
    """Judges the first ticks: TOO_LATE if most forces are late, else 0."""
    first, tick = _first_at(first), tick_at(tick)
    return TOO_LATE if tick.number < first.ticks and 2 * tick.missed > first.ticks else 0


def _set_up_first(loop: Any, setting: Setting) -> Any:
    loop.first.ticks = FIRST_SAMPLES
    return loop.first if setting.first_late else None


def _sentence_of_first(run: EndedRun) -> str:
    return (
        f"{run.report.deadline_misses} of the first {run.report.ticks} forces were late: the scene is unstable on a "
        f"wire that takes {run.setting.first_late} Use a faster wire, a lower rate or less stiffness; --unstable runs "
        "it all the same"
    )


FIRST_FORCES = Guard(
    "first", FIRST, {Stage.JUDGE: judge_first_forces}, _set_up_first, TOO_LATE, "forces late", _sentence_of_first
)
