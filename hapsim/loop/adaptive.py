"""The correction `adaptive`: an estimate of the mass of the temporary hybrid system, with its uncertainty, during a
run. The force follows the estimate, by a factor e within SLEW_S at most.

`prediction/correction/adaptive.py` computes the predictor's table beforehand: the simulated values for each mass,
stable for all masses. A scene without this correction never compiles it.

**The estimate.** A held force f and a hand push a mass m. Its position is read as x + w, with w the noise and rounding
of the sensor:

    y[n] - 2 y[n-1] + y[n-2] = (phi[n] + hand) / m + noise,      phi[n] = T² (sum of w_i f[n-i]) - k0 T² y[n-1]

Summed twice over L samples both sides stay exact; the motion grows with L², the noise does not. L is half the loop's
period, at most MOST_SPAN samples. A hand pushes slowly, so both sides are then differenced twice over D samples. The
results are the motion Y and the forces P. The part in proportion to the velocity is friction: it is fitted, and
subtracted from both.

Noise in Y leaves sum(PP) / sum(PY) unbiased; a hand's push that the scene answers leaves sum(PY) / sum(YY) unbiased.
Fourth differences of the positions are noise, since no hand moves that fast. Its energy is subtracted from sum(YY). The
estimate is the geometric mean of the two ratios. Its uncertainty has three parts: their distance, the scatter between
blocks (each as long as the sums), and the motion that neither forces nor noise explain.

A block counts only if the forces move the mass clearly more than the noise. The estimate comes from the latest BLOCKS
of them, or, if these disagree after a grip, from the latest FEWEST_BLOCKS. While the uncertainty of both is above
MOST_UNCERTAINTY, the last known estimate stays, and `age` counts for how long. After lost positions, and after late
forces in a row, the force that acted is unknown: the sums start anew.

**Accelerations.** If the device senses them, they give the mass once more, without a second difference of positions:

    a[n] = (f - b0 v[n] - k0 x[n] + hand) / m + noise,      f: the force that acts at the instant of a[n]

Both sides are differenced twice over HAND_S, in which a hand's push changes little. That removes the sensor's offset,
too. The friction is fitted. All that is left is taken for noise, so the data give its size. The blocks are short. If
the latest two contradict those before, a grip has changed: the motion before it is forgotten, the positions' too.

Positions and accelerations are weighed by their variances. No statistics show a wrong scale of the sensor. So SCALE
adds to the uncertainty of the accelerations, and so does a distance to the positions that both uncertainties do not
explain. A wrong scale therefore moves the estimate by less than the uncertainty of the positions. After a grip, until
these know the mass again, it acts in full; so does a sensor that follows a force in more than a sample.
"""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import array_at, record_at
from hapsim.loop.hooks import hook, io_at, tick_at
from hapsim.loop.predictor import IN_ALL, PREDICTOR, look_ahead, observe, set_numbers, take_posted

MOST_SPAN, MOST_SLOW_SPAN = 24, 12  # samples, L and D
BLOCKS, FEWEST_BLOCKS = 8, 3
LEAST_SIGNAL = 10.0  # least energy of the motion that the forces make of the heaviest mass, over that of the noise
MOST_UNCERTAINTY = 0.1  # relative uncertainty below which the force follows
MOST_WEIGHTS = 8
_FOURTH_DIFFERENCE = 70.0  # the energy of white noise in its fourth difference, over its own
_UNEXPLAINED = 0.05  # variance of ln m if neither forces nor noise explain any motion: enough for dry friction
_TINY = 1e-300
HAND_S = 3e-3  # s, over which a hand's push changes little: the accelerations' span
_FEWEST_SENSED, _SENSED_SPANS = 2, 8  # blocks of accelerations, and spans in one
_LEAST_SENSED = 100.0  # least energy that the forces make of the heaviest mass in a block, over the mean of the rest
_CHANGED = 3.0  # standard deviations by which the latest accelerations contradict the others after a grip
SCALE = 0.01  # relative uncertainty of the scale of a sensor of acceleration
_COLOURED = 4.0  # variance of sums of filtered noise, over that of white noise of the same energy

_EACH = (schema.MAX_CHANNELS,)
_ROW = schema.MAX_CHANNELS
_MASK = 63  # of the rings' samples: more than two spans of either
_POSITION, _FORCE, _FORCE_SUM, _AREA, _MOVED, _PUSHED, _SWEPT, _RINGS = range(8)
_COUNT, _PP, _PV, _VV, _PY, _VY, _YY, _AA, _AU, _UU, _SUMS = range(11)

MASS_ESTIMATE = np.dtype(
    [
        ("log_least", np.float64, _EACH),  # of the span, ln kg
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # ln kg: the last known estimate; the least mass before the first
        ("uncertainty", np.float64, _EACH),  # relative, standard; infinite before there is an estimate
        ("age", np.int64, _EACH),  # samples since the motion last showed it
        ("explained", np.float64, _EACH),  # R²: the share of the latest motion that the forces explain
        ("span", np.int64, _EACH),  # samples, L,
        ("slow_span", np.int64, _EACH),  # and D
        ("next_span", np.int64, _EACH),  # of the next scene
        ("rounding", np.float64, _EACH),  # m², the mean square of the counts
        ("spring", np.float64, _EACH),  # k0 T², kg
        ("first_lag", np.int64),  # f[n - first_lag] has the first of the weights
        ("count", np.int64),
        ("weights", np.float64, (MOST_WEIGHTS,)),  # s²
        ("seen", np.int64),  # samples in a row whose force is known
        ("was_late", np.int64),
        ("force_sum", np.float64, _EACH),  # running sums over L samples
        ("push", np.float64, _EACH),
        ("area", np.float64, _EACH),
        ("rings", np.float64, (*_EACH, _RINGS, _MASK + 1)),
        ("sums", np.float64, (*_EACH, _SUMS)),  # of the block that is being filled
        ("block", np.int64, _EACH),  # count of filled blocks
        ("blocks", np.float64, (*_EACH, BLOCKS, _SUMS)),
        ("total", np.float64, (_SUMS,)),  # over the fitted blocks
    ],
    align=True,
)

JOINT_ESTIMATE = np.dtype(
    [(name, MASS_ESTIMATE[name]) for name in ("log_mass", "uncertainty", "age", "explained")], align=True
)


@helper
def note_sample(estimate, gap, late):
    """Counts samples whose force is known, up to this one. Call it before `estimate_mass`."""
    unknown = gap != 1 or (late and estimate.was_late)
    estimate.seen = 0 if unknown else estimate.seen + 1
    estimate.was_late = late


@helper
def estimate_mass(estimate, predictor, forces, c, position):
    """Adds a sample of a channel to the estimate. Returns ln of the mass in kg."""
    seen = estimate.seen
    estimate.age[c] += 1
    ring, sums = estimate.rings[c], estimate.sums[c]
    ring[_POSITION, seen & _MASK] = position
    first_known = 2 + estimate.first_lag + estimate.count  # from here on the forces are known
    if seen < first_known:
        return estimate.log_mass[c]
    pushed = -estimate.spring[c] * ring[_POSITION, (seen - 1) & _MASK]
    for i in range(estimate.count):
        row = (predictor.newest - (estimate.first_lag - 1 + i)) & predictor.mask
        pushed += estimate.weights[i] * forces[row * 2 * _ROW + IN_ALL + c]
    ring[_FORCE, seen & _MASK] = pushed
    if not _sum_over_span(estimate, ring, c, seen - first_known):
        return estimate.log_mass[c]
    D = estimate.slow_span[c]
    P = _difference(ring, _PUSHED, seen, D)
    V = _difference(ring, _SWEPT, seen, D)
    Y = _difference(ring, _MOVED, seen, D)
    # The same over one sample, and twice more for the positions: the noise.
    U = _difference(ring, _FORCE, seen, 1)
    A = _difference(ring, _POSITION, seen, 1) - 2.0 * _difference(ring, _POSITION, seen - 1, 1)
    A += _difference(ring, _POSITION, seen - 2, 1)
    _add(sums, P, V, Y)
    sums[_AA] += A * A
    sums[_AU] += A * U
    sums[_UU] += U * U
    if sums[_COUNT] >= 2 * (estimate.span[c] + D):
        _close_block(estimate, c)
    return estimate.log_mass[c]


@helper
def _add(sums, P, V, Y):
    sums[_COUNT] += 1.0
    sums[_PP] += P * P
    sums[_PV] += P * V
    sums[_VV] += V * V
    sums[_PY] += P * Y
    sums[_VY] += V * Y
    sums[_YY] += Y * Y


@helper
def _sum_over_span(estimate, ring, c, age):
    """Sums over L samples, `age` after the first known force. Returns whether there is enough for D differences."""
    n, L = estimate.seen, estimate.span[c]
    now, then = n & _MASK, (n - L) & _MASK
    if age == 0:
        estimate.force_sum[c] = estimate.push[c] = estimate.area[c] = 0.0
    estimate.force_sum[c] += ring[_FORCE, now]
    estimate.area[c] += 0.5 * (ring[_POSITION, now] + ring[_POSITION, (n - 1) & _MASK])
    if age >= L:
        estimate.force_sum[c] -= ring[_FORCE, then]
        estimate.push[c] -= ring[_FORCE_SUM, then]
        estimate.area[c] -= 0.5 * (ring[_POSITION, then] + ring[_POSITION, (n - L - 1) & _MASK])
    estimate.push[c] += estimate.force_sum[c]
    ring[_FORCE_SUM, now] = estimate.force_sum[c]
    ring[_AREA, now] = estimate.area[c]
    ring[_MOVED, now] = _difference(ring, _POSITION, n, L)
    ring[_PUSHED, now] = estimate.push[c]
    ring[_SWEPT, now] = estimate.area[c] - ring[_AREA, then]
    return age >= 2 * (L + estimate.slow_span[c])


@helper
def _difference(ring, kind, n, over):
    return ring[kind, n & _MASK] - 2.0 * ring[kind, (n - over) & _MASK] + ring[kind, (n - 2 * over) & _MASK]


@helper
def _close_block(estimate, c):
    """Keeps the block if the forces move the mass clearly, and estimates anew; begins the next block."""
    sums = estimate.sums[c]
    explained = sums[_AU] * sums[_AU] / sums[_UU] if sums[_UU] > 0.0 else 0.0
    noise = max((sums[_AA] - explained) / _FOURTH_DIFFERENCE, estimate.rounding[c] * sums[_COUNT]) * _noise_gain(
        estimate, c
    )
    if sums[_PP] * math.exp(-2.0 * estimate.log_most[c]) > LEAST_SIGNAL * noise:
        _keep_block(estimate, c)
        if estimate.block[c] >= FEWEST_BLOCKS and not _fit(estimate, c, min(estimate.block[c], BLOCKS)):
            _fit(estimate, c, FEWEST_BLOCKS)
    for i in range(_SUMS):
        sums[i] = 0.0


@helper
def _keep_block(estimate, c):
    newest = estimate.block[c] % BLOCKS
    for i in range(_SUMS):
        estimate.blocks[c, newest, i] = estimate.sums[c, i]
    estimate.block[c] += 1


@helper
def _fit(estimate, c, count):
    """Estimates from the latest `count` blocks. Returns whether the mass is known now."""
    if count < 2:
        return False
    blocks, newest, total = estimate.blocks[c], estimate.block[c] + BLOCKS - 1, estimate.total
    for k in range(_SUMS):
        total[k] = 0.0
        for i in range(count):
            total[k] += blocks[(newest - i) % BLOCKS, k]
    samples, VV = total[_COUNT], max(total[_VV], _TINY)
    in_P, in_Y = total[_PV] / VV, total[_VY] / VV  # of the velocity
    P, Y = total[_PP] - in_P * total[_PV], total[_YY] - in_Y * total[_VY]
    product = total[_PY] - in_P * total[_VY]
    estimate.explained[c] = 0.0
    if not (P > 0.0 and product > 0.0):
        return False
    inverse = product / P
    left = max(Y - inverse * product, 0.0)
    estimate.explained[c] = 1.0 - left / Y
    white = (total[_AA] - 2.0 * inverse * total[_AU] + inverse * inverse * total[_UU]) / _FOURTH_DIFFERENCE
    noise = min(max(white, estimate.rounding[c] * samples) * _noise_gain(estimate, c), left)
    friction = in_Y - inverse * in_P  # -b0 T/m; the sums are exact up to its square
    scatter = 0.0
    for i in range(count):
        one = blocks[(newest - i) % BLOCKS]
        residual = one[_PY] - inverse * one[_PP] - friction * one[_PV]
        residual -= in_P * (one[_VY] - inverse * one[_PV] - friction * one[_VV])
        scatter += residual * residual * count / (count - 1.0)
    scatter += _COLOURED * left / samples * P
    # If the rest is noise and a hand that the scene answers, 1/m is (Y - noise) / product.
    log_distance = 0.5 * math.log((Y - noise) / (inverse * product))
    variance = scatter / (product * product) + log_distance * log_distance + 0.25 * friction**4
    uncertainty = math.sqrt(variance + _UNEXPLAINED * (left - noise) / Y)
    log_mass = -math.log(inverse) - log_distance
    least, most = estimate.log_least[c], estimate.log_most[c]
    if not (uncertainty < MOST_UNCERTAINTY and least - 3.0 * uncertainty < log_mass < most + 3.0 * uncertainty):
        return False
    estimate.log_mass[c] = min(max(log_mass, least), most)
    estimate.uncertainty[c] = uncertainty
    estimate.age[c] = 0
    return True


@helper
def _noise_gain(estimate, c):
    """Returns the energy of white position noise in Y over its own: gain of (1, -2, 1) over L, and again over D."""
    L, D = estimate.span[c], estimate.slow_span[c]
    return 70.0 if L == D else 28.0 if L == 2 * D else 36.0


@helper
def take_spans(estimate):
    """Restarts the channels whose spans another scene changes."""
    for c in range(_ROW):
        if estimate.next_span[c] != estimate.span[c]:
            estimate.span[c] = estimate.next_span[c]
            estimate.slow_span[c] = min(estimate.span[c], MOST_SLOW_SPAN)
            _restart(estimate, c)


@helper
def _restart(estimate, c):
    """Forgets a channel's motion up to now."""
    estimate.block[c] = estimate.seen = 0
    for i in range(_SUMS):
        estimate.sums[c, i] = 0.0


@helper
def _add_acceleration(sensed, estimate, predictor, forces, c, moved):
    """Adds a sample to the estimate `sensed`. `estimate`: by positions, which has the sample; `moved`: T² a, m."""
    seen, D, ring, positions = estimate.seen, sensed.span[c], sensed.rings[c], estimate.rings[c]
    sensed.age[c] += 1
    acted = -sensed.spring[c] * positions[_POSITION, seen & _MASK]
    for i in range(sensed.count):
        row = (predictor.newest - (sensed.first_lag - 1 + i)) & predictor.mask
        acted += sensed.weights[i] * forces[row * 2 * _ROW + IN_ALL + c]
    ring[_FORCE, seen & _MASK], ring[_MOVED, seen & _MASK] = acted, moved
    if seen < 2 * D + 2 + sensed.first_lag + sensed.count:
        return
    P, Y = _difference(ring, _FORCE, seen - 1, D), _difference(ring, _MOVED, seen - 1, D)
    V = 0.5 * (_difference(positions, _POSITION, seen, D) - _difference(positions, _POSITION, seen - 2, D))
    sums = sensed.sums[c]
    _add(sums, P, V, Y)
    if sums[_COUNT] >= _SENSED_SPANS * D:
        left = sums[_YY] - sums[_PY] * sums[_PY] / max(sums[_PP], _TINY)
        if sums[_PP] * math.exp(-2.0 * sensed.log_most[c]) * sums[_COUNT] > _LEAST_SENSED * left:
            _keep_block(sensed, c)
            _fit_accelerations(sensed, estimate, c)
        for i in range(_SUMS):
            sums[i] = 0.0


@helper
def _fit_accelerations(sensed, estimate, c):
    """Estimates from all kept blocks, or from the latest if they contradict these: a grip has changed, and what was
    before it is forgotten."""
    is_known = _fit(sensed, c, min(sensed.block[c], BLOCKS))
    log_mass, uncertainty = sensed.log_mass[c], sensed.uncertainty[c]
    if sensed.block[c] > _FEWEST_SENSED and _fit(sensed, c, _FEWEST_SENSED):
        if uncertainty < math.inf and abs(sensed.log_mass[c] - log_mass) > _CHANGED * sensed.uncertainty[c]:
            estimate.uncertainty[c] = math.inf
            sensed.block[c] = 0
            _restart(estimate, c)
        elif is_known:
            sensed.log_mass[c], sensed.uncertainty[c] = log_mass, uncertainty


@helper
def _weigh(joint, estimate, sensed, c):
    """Sets the estimate by positions and accelerations, each with its weight. A distance beyond their uncertainties is
    taken for an error of the accelerations."""
    of_positions, distance = estimate.uncertainty[c] ** 2, sensed.log_mass[c] - estimate.log_mass[c]
    doubt = max(sensed.uncertainty[c] ** 2 + SCALE * SCALE, distance * distance - of_positions)
    share = 1.0 / (1.0 + doubt / of_positions) if doubt < math.inf else 0.0
    log_mass = estimate.log_mass[c] + share * distance
    joint.log_mass[c] = min(max(log_mass, estimate.log_least[c]), estimate.log_most[c])
    joint.uncertainty[c] = math.sqrt(share * doubt) if share > 0.0 else estimate.uncertainty[c]
    joint.age[c] = min(estimate.age[c], sensed.age[c])
    joint.explained[c] = (estimate if of_positions < math.inf else sensed).explained[c]


SLEW_S, LEAST_SLEW = 0.05, 25  # s, samples: for a factor e of the mass

ADAPTIVE = np.dtype(
    [
        ("adapts", np.int64, _EACH),  # 1: an estimate sets this channel's force
        ("log_least", np.float64, _EACH),  # ln kg: the span of masses,
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # and the mass for which the force is computed
        ("slew", np.float64),  # the largest change of ln m in a sample
        ("estimate", MASS_ESTIMATE),  # by positions
        ("sensed", MASS_ESTIMATE),  # by accelerations
        ("joint", JOINT_ESTIMATE),  # by both
        ("senses", np.int64),  # 1: the force follows `joint`
        ("squared_period", np.float64),  # s²
    ],
    align=True,
)

_predictor_at, _doubles_at = record_at(PREDICTOR), array_at(np.float64)
_adaptive_at = record_at(ADAPTIVE)

ADDED = 3
"""Count of a channel's last numbers: N/m, N·s/m and N that are added to the scene's force."""


@hook
def predict_adaptively(predictor, tick):
    """Replaces the measured state by the expected one, as `predict`, with the numbers for the estimated mass."""
    predictor, tick = _predictor_at(predictor), tick_at(tick)
    io = io_at(tick.io)
    adaptive = _adaptive_at(predictor.adaptive)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * 2 * _ROW)
    observe(predictor, io, tick.gap, tick.late, tick.age)
    if take_posted(predictor):
        take_spans(adaptive.estimate)
    follows = predictor.left > 0
    predictor.left -= follows
    note_sample(adaptive.estimate, tick.gap, tick.late)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            log_mass = estimate_mass(adaptive.estimate, predictor, forces, c, io.measured[c])
            step = (adaptive.joint.log_mass[c] if adaptive.senses else log_mass) - adaptive.log_mass[c]
            adaptive.log_mass[c] += min(max(step, -adaptive.slew), adaptive.slew)
            span = adaptive.log_most[c] - adaptive.log_least[c]
            set_numbers(predictor, c, (adaptive.log_mass[c] - adaptive.log_least[c]) / span * (predictor.rows - 1))
        elif follows:
            set_numbers(predictor, c, 0.0)
    look_ahead(predictor, io)
    return 0


@hook
def read_accelerations(predictor, tick):
    """Estimates the mass from the accelerations, too. Call it after `predict_adaptively`."""
    predictor, io = _predictor_at(predictor), io_at(tick_at(tick).io)
    adaptive = _adaptive_at(predictor.adaptive)
    forces = _doubles_at(predictor.forces, (predictor.mask + 1) * 2 * _ROW)
    for c in range(io.channels):
        if adaptive.adapts[c]:
            moved = io.acceleration[c] * adaptive.squared_period
            _add_acceleration(adaptive.sensed, adaptive.estimate, predictor, forces, c, moved)
            _weigh(adaptive.joint, adaptive.estimate, adaptive.sensed, c)
    return 0


@hook
def add_difference(predictor, tick):
    """Adds the difference to the force for the estimated mass: the scene's links are those for the least mass."""
    predictor, io = _predictor_at(predictor), io_at(tick_at(tick).io)
    numbers = _doubles_at(predictor.numbers, _ROW * predictor.width)
    for c in range(io.channels):
        dK = (c + 1) * predictor.width - ADDED
        io.asked[c] += numbers[dK + 2] - numbers[dK] * io.measured[c] - numbers[dK + 1] * io.velocity[c]
    return 0
