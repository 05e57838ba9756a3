"""The sign guard: it stops the loop, before the hand has gone far, if a motor is wired the wrong way round.

The acceleration itself does not show which way a motor pushes, because a hand pushes harder than most motors. Its
change with the force that acted does. So both x'' and F go through the same filter,

    D / (1 - a/q)³,     D = 1 - 1/q, a = exp(-T / (s FILTER_S)),

as the second differences of two paths: q, that of the positions, and p, that of 1 kg under the force alone. The filter
passes changes within some milliseconds, but neither a hand's slow push nor single counts of an encoder. Over lost
positions both paths are straight lines, so that they stay comparable. Coarser counts hide more of the motion that the
force limit F gives to the mass m, so all times are s times as long, s = sqrt(count m / F / FINE_S2) and at least 1.
A bridge may send finer counts than its encoder has: the least difference between two steps of the position shows them.

Sums of their squares and products, which decay within s SUMS_S, give the residuals of q = g p: R(right) for the best
g within RIGHT, R(wrong) within WRONG with the other sign, both divided by the declared mass; and

    J = (R(right) - R(wrong)) / (R(wrong) + noise of the counts).

The channels of a hand in the plane are judged as one, p and q being complex numbers. z = sum of conj(p) q and
z' = sum of p q fit q to a turned p, and to a turned mirror image of it. Right is a turn of at most 45°. Wrong is one of
60° or more; or a mirror image, if Re z is small beside |z| or |z'|, since a force along one line shows only part of it.

A hand that leans into a wall harder and harder can make J large for a while. So if J exceeds SUSPICION for SUSPECT_S,
and there is enough force, the guard releases the hand's force for RELEASE_S: a test that the hand does not expect. Only
the sums from then until VERDICT_S decide: with J above SURE the motor is wrong. The other ratio,
(R(wrong) - R(right)) / (R(right) + noise), acquits. If it exceeds SURE for SUSPECT_S, with or without a test, the motor
of a line is right, and judged no more. In the plane a hand that circles agrees with its force whatever the motors do:
there only tests acquit, and only the sector of the force's axis. A force that lasts in a sector which is not acquitted
plans a test.

The guard misses a motor whose force changes little, or moves the device less than the hand does: soft springs, heavy
hands, small limits. tools/bench/README.md has the figures.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import record_at
from hapsim.loop.buffers import scale_line
from hapsim.loop.force_history import IN_ALL, acting_force, history_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import SLEWED

WRONG_SIGN = -21

FILTER_S, SUMS_S, LEAST_SUMS_S = 0.002, 0.005, 0.007  # shorter sums than the last hold too few samples
SUSPECT_S, RELEASE_S, VERDICT_S = 0.003, 0.012, 0.028
FINE_S2 = 3.2e-7  # s² = count m/F: with coarser counts all of these times are longer
SUSPICION, SURE = 1.0, 12.0
NOISE, PAIR_NOISE = 0.15, 0.05  # of a position, in squares of its count; of a pair less, as 45° explain half of 90°
RELEASED_FROM = 0.1  # of the force limit: to release less shows nothing
MOST_GAP = 3  # samples; after more lost positions the paths are not comparable
RIGHT, WRONG = (0.4, 50.0), (0.4, 4.0)  # 1/m times the declared mass: a device alone is much lighter than in a hand
ROUNDED, COARSER = 2, 8  # counts of the wire: rounding changes a step by less; an encoder's larger counts are more
SECTORS, PASSES = 4, 2  # of 45°, both ways alike; tests that acquit each of them
PLANNED_FROM, PLANNED_AFTER_S, APART_S = 0.2, 0.01, 0.06  # share of the force limit; duration; pause after a test
MOST_PLANNED = 8  # tests in a sector

_COS_45, _SIN_60 = math.sqrt(0.5), math.sqrt(0.75)
_EACH = (schema.MAX_CHANNELS,)
_STAGES = (4 * schema.MAX_CHANNELS,)
_BY_SECTOR = (SECTORS * schema.MAX_CHANNELS,)

SIGN = np.dtype(
    [
        ("is_over", np.int64),  # 1: every motor is right
        ("releases", np.int64),  # hands whose force is released now
        ("tests", np.int64),  # releases so far
        ("channel", np.int64),  # of the wrong motor, or the first of a hand's
        ("rate", np.float64),  # Hz
        ("period_squared", np.float64),  # s²
        ("seen", np.int64),  # positions
        # Of each channel:
        ("counts", np.int64, _EACH),  # the last position,
        ("position", np.float64, _EACH),  # in m,
        ("step", np.float64, _EACH),  # and m in a sample, up to there
        ("lead", np.float64, _EACH),  # kg·m in a sample: speed of 1 kg at a sample less its mean speed up to there
        ("motion", np.float64, _STAGES),  # of the filter: three sums, and the last of them a sample before
        ("push", np.float64, _STAGES),
        ("compared", np.int64, _EACH),  # counts: a step,
        ("apart", np.int64, _EACH),  # and the least difference between two; 0: none was seen
        ("is_right", np.int64, _EACH),
        # Of each hand, at its first channel:
        ("most_mass", np.float64, _EACH),  # kg
        ("heaviest", np.float64, _EACH),  # 1/kg
        ("lightest", np.float64, _EACH),
        ("count", np.float64, _EACH),  # m, for which the times below are set; 0: for none
        ("pole", np.float64, _EACH),  # a
        ("forget", np.float64, _EACH),  # decay of the sums per sample
        ("noise", np.float64, _EACH),  # m², of the counts, in the sums
        ("least", np.int64, _EACH),  # samples in a sum,
        ("row", np.int64, _EACH),  # suspicions in a row,
        ("release", np.int64, _EACH),  # samples without force,
        ("verdict", np.int64, _EACH),  # samples from the release to the last verdict
        ("kept", np.int64, _EACH),  # samples in these sums
        ("push_push", np.float64, _EACH),
        ("motion_motion", np.float64, _EACH),
        ("turned", np.complex128, _EACH),  # z,
        ("mirrored", np.complex128, _EACH),  # and z'; of a line Re z alone is used
        ("against", np.int64, _EACH),  # samples in a row in which J is suspicious,
        ("along", np.int64, _EACH),  # or the other ratio sure
        ("since", np.int64, _EACH),  # samples since the release; -1: there is no test
        ("plans", np.int64, _EACH),  # 1: tests of a hand in the plane are planned
        ("loaded", np.int64, _EACH),  # samples in which force acted in a sector that is not acquitted
        ("pause", np.int64, _EACH),  # samples until the next test
        ("sector", np.int64, _EACH),  # of the last test
        ("passed", np.int64, _BY_SECTOR),  # tests that acquitted it,
        ("planned", np.int64, _BY_SECTOR),  # and all of its tests
    ],
    align=True,
)

_sign_at = record_at(SIGN)


@hook
def release(sign, tick):
    """Makes the force of the tested hands zero, in all of their channels: else the force would turn."""
    sign, tick = _sign_at(sign), tick_at(tick)
    if sign.releases == 0:
        return 0
    io = io_at(tick.io)
    for c in range(np.uint64(io.channels)):
        other = c
        while 0 <= sign.since[c] < sign.release[c]:
            io.force_counts[other] = 0
            scale_line(io, other, 0.0)
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
        other = np.int64(np.uint64(c) + io.to_next[c])  # c, if the hand has one channel
        if sign.is_right[c] or other < c:
            continue
        judged += 1
        _sum_up(sign, history, io, c, other, gap)
        against, along = _ratios(sign, c, other)
        if sign.since[c] >= 0 and against > SURE:
            sign.channel, code = c, WRONG_SIGN
        if other != c:
            _judge_pair(sign, history, io, c, other, gap, against, along)
        else:
            _judge_line(sign, history, io, c, gap, against, along)
        sign.releases += 0 <= sign.since[c] < sign.release[c]
    sign.seen += 1
    sign.is_over = judged == 0
    return code


@helper
def _judge_line(sign, history, io, c, gap, against, along):
    """Acquits the motor, goes on with its test, or begins one."""
    sign.along[c] = sign.along[c] + 1 if along > SURE else 0
    if sign.along[c] >= sign.row[c]:
        sign.is_right[c], sign.since[c] = 1, -1
    elif sign.since[c] >= 0:
        _continue_test(sign, c, gap)
    else:
        sign.against[c] = sign.against[c] + 1 if against > SUSPICION else 0
        acts = abs(acting_force(history, IN_ALL + c, 0))
        if sign.against[c] >= sign.row[c] and acts >= RELEASED_FROM * io.force_limit[c]:
            _begin_test(sign, c)


@helper
def _judge_pair(sign, history, io, c, other, gap, against, along):
    """Acquits a sector, goes on with a test, or begins one: for suspicion, or by plan."""
    sign.pause[c] = max(sign.pause[c] - gap, 0)
    if sign.since[c] >= 0:
        _continue_test(sign, c, gap)
        if along > SURE:
            sign.since[c] = -1
            sign.passed[SECTORS * c + sign.sector[c]] += 1
            is_right = True
            for i in range(SECTORS):
                is_right &= sign.passed[SECTORS * c + i] >= PASSES
            sign.is_right[c] = sign.is_right[other] = is_right
        return
    x, y = acting_force(history, IN_ALL + c, 0), acting_force(history, IN_ALL + other, 0)
    share = math.hypot(x / io.force_limit[c], y / io.force_limit[other])
    sector = _sector(x, y)
    at = SECTORS * c + sector
    is_open = sign.passed[at] < PASSES
    sign.against[c] = sign.against[c] + 1 if against > SUSPICION else 0
    sign.loaded[c] = sign.loaded[c] + gap if is_open and share >= PLANNED_FROM else 0
    suspected = sign.against[c] >= sign.row[c] and share >= RELEASED_FROM and is_open
    due = sign.plans[c] and sign.loaded[c] >= PLANNED_AFTER_S * sign.rate and sign.planned[at] < MOST_PLANNED
    if sign.pause[c] == 0 and (suspected or due):
        _begin_test(sign, c)
        sign.sector[c], sign.loaded[c], sign.pause[c] = sector, 0, np.int64(APART_S * sign.rate)
        sign.planned[at] += 1


@helper
def _begin_test(sign, c):
    sign.tests += 1
    sign.since[c] = sign.against[c] = sign.kept[c] = 0


@helper
def _continue_test(sign, c, gap):
    sign.since[c] = sign.since[c] + gap if sign.since[c] + gap <= sign.verdict[c] else -1


@helper
def _sector(x, y):
    """Returns the sector of a force's axis: 0 from x to the diagonal, and so on to 3."""
    if y < 0.0 or (y == 0.0 and x < 0.0):
        x, y = -x, -y
    if x >= 0.0:
        return 0 if x > y else 1
    return 2 if -x <= y else 3


@helper
def _sum_up(sign, history, io, c, other, gap):
    """Adds the filtered motion, and the filtered path of 1 kg under the force that acted, to the sums of a hand."""
    count = _count(sign, io, c, gap)
    if other != c:
        count = max(count, _count(sign, io, other, gap))
    if count != sign.count[c]:
        _set_times(sign, c, count, io.force_limit[c])
        sign.noise[c] = (NOISE if other == c else PAIR_NOISE) * count * count / (1.0 - sign.forget[c])
    pole = sign.pole[c]
    x, pushed_x = _filtered_channel(sign, history, io, c, gap, pole)
    y, pushed_y = _filtered_channel(sign, history, io, other, gap, pole) if other != c else (0.0, 0.0)
    if sign.seen < 2:
        return
    if sign.kept[c] == 0 or gap > MOST_GAP:
        sign.kept[c] = 0
        sign.push_push[c] = sign.motion_motion[c] = sign.turned[c] = sign.mirrored[c] = 0.0
    sign.kept[c] += 1
    forget = sign.forget[c]
    sign.push_push[c] = forget * sign.push_push[c] + pushed_x * pushed_x + pushed_y * pushed_y
    sign.motion_motion[c] = forget * sign.motion_motion[c] + x * x + y * y
    q = x + 1j * y
    sign.turned[c] = forget * sign.turned[c] + (pushed_x - 1j * pushed_y) * q
    sign.mirrored[c] = forget * sign.mirrored[c] + (pushed_x + 1j * pushed_y) * q


@helper
def _count(sign, io, c, gap):
    """Returns the count (m) of a channel's positions: that of the wire, or the least difference between two steps, if
    that is larger. Takes the newest step."""
    step = io.position_counts[c] - sign.counts[c]
    sign.counts[c] += step
    apart = abs(step - sign.compared[c])
    if sign.seen > 0 and gap == 1 and apart > ROUNDED:
        sign.compared[c] = step
        sign.apart[c] = apart if sign.apart[c] == 0 else min(sign.apart[c], apart)
    return io.position_scale[c] * (sign.apart[c] if sign.apart[c] > COARSER else 1)


@helper
def _set_times(sign, c, count, force_limit):
    """Sets the times of a hand, and its filter, for positions with this count (m)."""
    stretched = sign.rate * max(1.0, math.sqrt(count * sign.most_mass[c] / force_limit / FINE_S2))
    sign.count[c] = count
    sign.pole[c], sign.forget[c] = math.exp(-1.0 / (FILTER_S * stretched)), math.exp(-1.0 / (SUMS_S * stretched))
    sign.least[c], sign.row[c] = np.rint(LEAST_SUMS_S * stretched), np.rint(SUSPECT_S * stretched)
    sign.release[c], sign.verdict[c] = np.rint(RELEASE_S * stretched), np.rint(VERDICT_S * stretched)


@helper
def _filtered_channel(sign, history, io, c, gap, pole):
    """Returns the filtered motion of a channel, and the filtered path of 1 kg under its force."""
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
        return 0.0, 0.0
    return _filtered(sign.motion, 4 * c, bend, pole, gap), _filtered(sign.push, 4 * c, way / gap, pole, gap)


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
def _ratios(sign, c, other):
    """Returns J of a hand, and the other ratio; 0 with too few samples."""
    if sign.kept[c] < sign.least[c]:
        return 0.0, 0.0
    noise, along, aside = sign.noise[c], sign.turned[c].real, abs(sign.turned[c].imag)
    if other == c:
        right, wrong = _residual(sign, c, along, RIGHT), _residual(sign, c, -along, WRONG)
        return (right - wrong) / (wrong + noise), (wrong - right) / (right + noise)
    turned, mirrored = abs(sign.turned[c]), abs(sign.mirrored[c])
    right = _residual(sign, c, turned if along >= aside else _COS_45 * (along + aside), RIGHT)
    wrong = _residual(sign, c, turned if along <= 0.5 * turned else 0.5 * along + _SIN_60 * aside, WRONG)
    worst = wrong
    if along < 0.5 * max(turned, mirrored):
        worst = min(wrong, _residual(sign, c, mirrored, WRONG))
    return (right - worst) / (worst + noise), (wrong - right) / (right + noise)


@helper
def _residual(sign, c, gain, bounds):
    """Returns the residual (m²) of the best 1/m within the bounds, for pushes that agree with the motion by `gain`."""
    pushed = sign.push_push[c]
    best = gain / pushed if pushed > 0.0 else 0.0
    best = min(max(best, bounds[0] * sign.heaviest[c]), bounds[1] * sign.lightest[c])
    return sign.motion_motion[c] - 2.0 * best * gain + best * best * pushed


def watch_signs(sign: Any, *, rate_hz: float, masses: Sequence[tuple[float, float]], known: Iterable[int] = ()) -> None:
    """Fills a SIGN. `masses`: kg, the least and the largest of each channel's hand; `known`: channels whose motor is
    known to be right."""
    for c, (least, most) in enumerate(masses):
        sign.most_mass[c], sign.lightest[c], sign.heaviest[c] = most, 1.0 / least, 1.0 / most
    sign.rate, sign.period_squared = rate_hz, rate_hz**-2
    sign.since[:], sign.plans[:] = -1, 1
    sign.plans[list(known)] = 0


def _set_up(loop: Any, setting: Setting) -> Any:
    from hapsim.prediction.force_bounds import SIGN_RATE_HZ

    scene, channels = setting.scene, setting.scene.channels
    if scene.rate < SIGN_RATE_HZ or not (setting.in_hand or setting.judges_sign):
        return None
    spans = scene.device.mass_spans(channels)
    hands = [list(zip(*(spans[one] for one in scene.hand_of(c)), strict=True)) for c in range(channels)]
    masses = [(min(least), max(most)) for least, most in hands]
    watch_signs(loop.sign, rate_hz=scene.rate, masses=masses, known=setting.known_motors)
    return loop.sign


def _sentence(run: EndedRun) -> str:
    first = int(run.loop.sign.channel)
    hand = run.scene.hand_of(first)
    named = f"channel {first}" if len(hand) == 1 else f"channels {hand[0]} and {hand[1]}"
    swapped = ""
    if len(hand) > 1:
        swapped = (
            ". Or the motors of x and y are exchanged, or the axes turned: "
            f"`hapsim probe PORT --push N --pair {hand[0]},{hand[1]}`"
        )
    return (
        f"motor and position of {named} disagree in sign: the device accelerated against its "
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
    mode="impedance",
)
