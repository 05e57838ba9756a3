"""The sign guard: it stops the loop, before the hand has gone far, if a motor is wired the wrong way round.

The acceleration itself does not show which way a motor pushes, because a hand pushes harder than most motors. Its
change with the force that acted does. So both x'' and F go through the same filter,

    D / (1 - a/q)³,     D = 1 - 1/q, a = exp(-T / FILTER_S),

as the second differences of two paths: that of the positions, and that of 1 kg under the force alone. The filter
passes changes within some milliseconds, but neither a hand's slow push nor single counts of an encoder. Over lost
positions both paths are straight lines, so that they stay comparable. Sums of their squares and products, which decay
within SUMS_S, give the residuals of x'' = F/m: R(right) for the best 1/m within RIGHT, R(wrong) within WRONG with the
other sign, both times the declared mass; and

    J = (R(right) - R(wrong)) / (R(wrong) + counts²).

A hand that leans into a wall harder and harder can make J large for a while. So if J exceeds SUSPICION for SUSPECT_S,
and there is enough force, the guard releases the force for RELEASE_S: a test that the hand does not expect. Only the
sums from then until VERDICT_S decide: with J above SURE the motor is wrong. If the other ratio,
(R(wrong) - R(right)) / (R(right) + counts²), exceeds SURE for SUSPECT_S, with or without a test, the motor is right,
and its channel is judged no more.

The guard misses a motor whose force changes little, or moves the device less than the hand does: soft springs, heavy
hands, small limits. tools/bench/README.md has the figures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import record_at
from hapsim.loop.force_history import IN_ALL, acting_force, history_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import SLEWED

WRONG_SIGN = -21

FILTER_S, SUMS_S, LEAST_SUMS_S = 0.002, 0.005, 0.007  # shorter sums than the last hold too few samples
SUSPECT_S, RELEASE_S, VERDICT_S = 0.003, 0.012, 0.028
SUSPICION, SURE = 1.0, 12.0
RELEASED_FROM = 0.1  # of the force limit: to release less shows nothing
MOST_GAP = 3  # samples; after more lost positions the paths are not comparable
RIGHT, WRONG = (0.4, 50.0), (0.4, 4.0)  # 1/m times the declared mass: a device alone is much lighter than in a hand

_EACH = (schema.MAX_CHANNELS,)
_STAGES = (4 * schema.MAX_CHANNELS,)

SIGN = np.dtype(
    [
        ("is_over", np.int64),  # 1: every motor is right
        ("releases", np.int64),  # channels whose force is released now
        ("tests", np.int64),  # releases so far
        ("channel", np.int64),  # of the wrong motor
        ("pole", np.float64),  # a
        ("forget", np.float64),  # decay of the sums per sample
        ("period_squared", np.float64),  # s²
        ("least", np.int64),  # samples in a sum,
        ("row", np.int64),  # suspicions in a row,
        ("release", np.int64),  # samples without force,
        ("verdict", np.int64),  # samples from the release to the last verdict
        ("right", np.float64, (2 * schema.MAX_CHANNELS,)),  # 1/kg: least and most of each channel
        ("wrong", np.float64, (2 * schema.MAX_CHANNELS,)),
        ("seen", np.int64),  # positions
        ("position", np.float64, _EACH),  # m, the last one,
        ("step", np.float64, _EACH),  # and m in a sample, up to there
        ("lead", np.float64, _EACH),  # kg·m in a sample: speed of 1 kg at a sample less its mean speed up to there
        ("motion", np.float64, _STAGES),  # of the filter: three sums, and the last of them a sample before
        ("push", np.float64, _STAGES),
        ("kept", np.int64, _EACH),  # samples in these sums
        ("push_push", np.float64, _EACH),
        ("push_motion", np.float64, _EACH),
        ("motion_motion", np.float64, _EACH),
        ("against", np.int64, _EACH),  # samples in a row in which J is suspicious,
        ("along", np.int64, _EACH),  # or the other ratio sure
        ("since", np.int64, _EACH),  # samples since the release; -1: there is no test
        ("is_right", np.int64, _EACH),
    ],
    align=True,
)

_sign_at = record_at(SIGN)


@hook
def release(sign, tick):
    """Makes the force of the tested channels zero, and of the others of the same hand: else the force would turn."""
    sign, tick = _sign_at(sign), tick_at(tick)
    if sign.releases == 0:
        return 0
    io = io_at(tick.io)
    for c in range(np.uint64(io.channels)):
        other = c
        while 0 <= sign.since[c] < sign.release:
            io.force_counts[other] = 0
            other += io.to_next[other]
            if other == c:
                break
    tick.flags |= SLEWED
    return 0


@hook
def judge_signs(sign, tick):
    """Judges the motion of the last `gap` samples: WRONG_SIGN for the motor of `sign.channel`, else 0."""
    sign, tick = _sign_at(sign), tick_at(tick)
    if sign.is_over:
        return 0
    history, io, gap = history_at(tick.history), io_at(tick.io), tick.gap
    code, judged = 0, 0
    sign.releases = 0
    for c in range(io.channels):
        if sign.is_right[c]:
            continue
        judged += 1
        _sum_up(sign, history, io, c, gap)
        count = io.position_scale[c]
        noise = count * count / (1.0 - sign.forget)
        right, other = _residual(sign, c, sign.right), _residual(sign, c, sign.wrong)
        has_enough = sign.kept[c] >= sign.least
        against = (right - other) / (other + noise) if has_enough else 0.0
        along = (other - right) / (right + noise) if has_enough else 0.0
        sign.along[c] = sign.along[c] + 1 if along > SURE else 0
        if sign.along[c] >= sign.row:
            sign.is_right[c], sign.since[c] = 1, -1
        elif sign.since[c] >= 0:
            if against > SURE:
                sign.channel, code = c, WRONG_SIGN
            sign.since[c] = sign.since[c] + gap if sign.since[c] + gap <= sign.verdict else -1
        else:
            sign.against[c] = sign.against[c] + 1 if against > SUSPICION else 0
            _begin_test(sign, history, io, c)
        sign.releases += 0 <= sign.since[c] < sign.release
    sign.seen += 1
    sign.is_over = judged == 0
    return code


@helper
def _begin_test(sign, history, io, c):
    """Begins a test if there is suspicion and enough force."""
    acts = abs(acting_force(history, IN_ALL + c, 0))
    if sign.against[c] >= sign.row and acts >= RELEASED_FROM * io.force_limit[c]:
        sign.tests += 1
        sign.since[c] = sign.against[c] = sign.kept[c] = 0


@helper
def _sum_up(sign, history, io, c, gap):
    """Adds the filtered motion, and the filtered path of 1 kg under the force that acted, to the sums."""
    position = io.position_counts[c] * io.position_scale[c]
    step = (position - sign.position[c]) / gap
    bend = step - sign.step[c]
    way, lead = 0.0, sign.lead[c]
    for before in range(gap - 1, -1, -1):
        gained = sign.period_squared * acting_force(history, IN_ALL + c, before)
        way += lead + 0.5 * gained
        lead += gained
    sign.position[c], sign.step[c], sign.lead[c] = position, step, lead - way / gap
    if sign.seen < 2:
        return
    motion = _filtered(sign.motion, 4 * c, bend, sign.pole, gap)
    push = _filtered(sign.push, 4 * c, way / gap, sign.pole, gap)
    if sign.kept[c] == 0 or gap > MOST_GAP:
        sign.kept[c] = 0
        sign.push_push[c] = sign.push_motion[c] = sign.motion_motion[c] = 0.0
    sign.kept[c] += 1
    sign.push_push[c] = sign.forget * sign.push_push[c] + push * push
    sign.push_motion[c] = sign.forget * sign.push_motion[c] + push * motion
    sign.motion_motion[c] = sign.forget * sign.motion_motion[c] + motion * motion


@helper
def _filtered(sums, at, bend, pole, gap):
    """Returns the filtered bend of a path that bends at the first of `gap` samples and is then straight."""
    for i in range(gap):
        sums[at] = pole * sums[at] + (bend if i == 0 else 0.0)
        sums[at + 1] = pole * sums[at + 1] + sums[at]
        sums[at + 3] = sums[at + 2]
        sums[at + 2] = pole * sums[at + 2] + sums[at + 1]
    return sums[at + 2] - sums[at + 3]


@helper
def _residual(sign, c, bounds):
    """Returns the residual (m²) for the best 1/m within the bounds."""
    pushed, both = sign.push_push[c], sign.push_motion[c]
    best = both / pushed if pushed > 0.0 else 0.0
    best = min(max(best, bounds[2 * c]), bounds[2 * c + 1])
    return sign.motion_motion[c] - 2.0 * best * both + best * best * pushed


def watch_signs(sign: Any, *, rate_hz: float, masses: Sequence[tuple[float, float]]) -> None:
    """Fills a SIGN. `masses`: kg, the least and the largest of each channel."""
    for c, (least, most) in enumerate(masses):
        sign.right[2 * c : 2 * c + 2] = RIGHT[0] / most, RIGHT[1] / least
        sign.wrong[2 * c : 2 * c + 2] = -WRONG[1] / least, -WRONG[0] / most
    sign.period_squared = rate_hz**-2
    sign.pole, sign.forget = (math.exp(-1.0 / (one * rate_hz)) for one in (FILTER_S, SUMS_S))
    sign.least, sign.row = round(LEAST_SUMS_S * rate_hz), round(SUSPECT_S * rate_hz)
    sign.release, sign.verdict = round(RELEASE_S * rate_hz), round(VERDICT_S * rate_hz)
    sign.since[:] = -1


def _set_up(loop: Any, setting: Setting) -> Any:
    from hapsim.prediction.force_bounds import SIGN_RATE_HZ

    rate_hz, device = setting.scene.rate, setting.scene.device
    if rate_hz < SIGN_RATE_HZ or not (setting.in_hand or setting.judges_sign):
        return None
    watch_signs(loop.sign, rate_hz=rate_hz, masses=device.mass_spans(setting.description.channels))
    return loop.sign


def _sentence(run: EndedRun) -> str:
    channel = run.loop.sign.channel
    swapped = ". Or the motors of x and y are exchanged: `hapsim probe --push`" if run.loop.io.to_next[channel] else ""
    return (
        f"motor and position of channel {channel} disagree in sign: the device accelerated against its "
        f"force, and a release of the force confirmed it (tick {run.report.ticks}). Swap the motor's two wires; or "
        f"reverse the encoder, if the position falls when the hand moves the positive way{swapped} "
        "(hapsim/STABILITY.md)"
    )


GUARD = Guard(
    "sign",
    SIGN,
    {Stage.LOWER: release, Stage.JUDGE: judge_signs},
    _set_up,
    WRONG_SIGN,
    "sign wrong",
    _sentence,
    reads_history=True,
    stopped_motor=lambda loop: int(loop.sign.channel),
)
