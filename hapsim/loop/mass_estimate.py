"""The mass of the temporary hybrid system, estimated while it runs, and how far that estimate can be trusted.

What is read of a mass m that a held force f, and a hand h, push is y = x + w, with w the sensor's noise and rounding:

    y[n] - 2 y[n-1] + y[n-2] = (phi[n] + hand) / m + noise,      phi[n] = T² (sum of w_i f[n-i]) - k0 T² y[n-1]

Summed twice over L samples both sides stay exact, the motion grows with L² and the noise does not. L is half the loop's
period, at most MOST_SPAN samples. A hand pushes slowly: differences over D samples, twice, take that away. Friction,
viscous and dry, is what a velocity with a free factor explains; the same sums hold the velocity, and what it explains is
taken from the motion Y and from the forces P.

Noise in Y leaves sum(PP) / sum(PY) right, a hand's push that the scene answers leaves sum(PY) / sum(YY) right. The noise
is seen in fourth differences, where no hand moves; its share is taken from sum(YY), the mass is between the two, and
their distance is part of its uncertainty. The other parts are how far BLOCKS, stretches as long as the sums look back,
disagree, and what the residual makes of them. Only blocks in which the forces move the mass clearly more than the noise
count. Where the latest do not agree with the older ones, as after a grip, the latest alone are asked; where these do not
tell either, the estimate stays.

A sample whose force is not known, after lost positions or forces that were late in a row, begins everything anew.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.loop.predictor import IN_ALL

MOST_SPAN, MOST_SLOW_SPAN = 24, 12  # samples, L and D
BLOCKS, FEWEST_BLOCKS = 8, 3
CLEARLY = 10.0  # the energy of the motion that the forces make of the heaviest mass, over that of the noise
KNOWN = 0.1  # relative uncertainty from which on the force follows
MOST_WEIGHTS = 8
_FOURTH = 70.0  # the energy of white noise in its fourth difference, over its own
_COLOURED = 4.0  # by how much more the sums of filtered noise vary than those of white noise of the same energy

_EACH = (schema.MAX_CHANNELS,)
_ROW = schema.MAX_CHANNELS
_MASK = 63  # of the rings' samples: more than two spans of either
_POSITION, _FORCE, _FORCE_SUM, _AREA, _MOVED, _PUSHED, _SWEPT, _RINGS = range(8)
_COUNT, _PP, _PV, _VV, _PY, _VY, _YY, _AA, _AU, _UU, _SUMS = range(11)

MASS_ESTIMATE = np.dtype(
    [
        ("log_least", np.float64, _EACH),  # of the span, ln kg
        ("log_most", np.float64, _EACH),
        ("log_mass", np.float64, _EACH),  # ln kg: the last estimate that was known; the least mass before there is one
        ("uncertainty", np.float64, _EACH),  # relative, standard; infinite before there is an estimate
        ("explained", np.float64, _EACH),  # R²: the share of the latest motion that the forces explain
        ("span", np.int64, _EACH),  # samples, L,
        ("slow_span", np.int64, _EACH),  # and D
        ("noise_gain", np.float64, _EACH),  # of white noise in the position, as energy, in Y
        ("rounding", np.float64, _EACH),  # m², the mean square of the counts
        ("sprung", np.float64, _EACH),  # k0 T², kg
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
        ("block", np.int64, _EACH),  # how many were filled
        ("blocks", np.float64, (*_EACH, BLOCKS, _SUMS)),
    ],
    align=True,
)


@helper
def note_sample(estimate, gap, late):
    """Before the channels: whether the force that acted until this sample is known."""
    unknown = gap != 1 or (late and estimate.was_late)
    estimate.seen = 0 if unknown else estimate.seen + 1
    estimate.was_late = late


@helper
def estimate_mass(estimate, predictor, forces, c, position):
    """Takes one sample more of a channel, and returns ln of the mass in kg."""
    seen = estimate.seen
    ring, sums = estimate.rings[c], estimate.sums[c]
    ring[_POSITION, seen & _MASK] = position
    begins = 2 + estimate.first_lag + estimate.count  # from here on the forces are known
    if seen < begins:
        return estimate.log_mass[c]
    pushed = -estimate.sprung[c] * ring[_POSITION, (seen - 1) & _MASK]
    for i in range(estimate.count):
        row = (predictor.newest - (estimate.first_lag - 1 + i)) & predictor.mask
        pushed += estimate.weights[i] * forces[row * 2 * _ROW + IN_ALL + c]
    ring[_FORCE, seen & _MASK] = pushed
    if not _sum_over_span(estimate, ring, c, seen - begins):
        return estimate.log_mass[c]
    D = estimate.slow_span[c]
    P = _difference(ring, _PUSHED, seen, D)
    V = _difference(ring, _SWEPT, seen, D)
    Y = _difference(ring, _MOVED, seen, D)
    # The same over one sample, and twice more: there the noise is.
    U = _difference(ring, _FORCE, seen, 1)
    A = _difference(ring, _POSITION, seen, 1) - 2.0 * _difference(ring, _POSITION, seen - 1, 1)
    A += _difference(ring, _POSITION, seen - 2, 1)
    sums[_COUNT] += 1.0
    sums[_PP] += P * P
    sums[_PV] += P * V
    sums[_VV] += V * V
    sums[_PY] += P * Y
    sums[_VY] += V * Y
    sums[_YY] += Y * Y
    sums[_AA] += A * A
    sums[_AU] += A * U
    sums[_UU] += U * U
    if sums[_COUNT] >= 2 * (estimate.span[c] + D):
        _close_block(estimate, c)
    return estimate.log_mass[c]


@helper
def _sum_over_span(estimate, ring, c, age):
    """The motion over L samples and what the forces and the velocity are in it, `age` samples after the first known
    force; whether differences over D samples can be taken of them."""
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
    """Keeps the block and estimates anew, if the forces move the mass clearly in it."""
    sums = estimate.sums[c]
    explained = sums[_AU] * sums[_AU] / sums[_UU] if sums[_UU] > 0.0 else 0.0
    noise = max((sums[_AA] - explained) / _FOURTH, estimate.rounding[c] * sums[_COUNT]) * estimate.noise_gain[c]
    if sums[_PP] * math.exp(-2.0 * estimate.log_most[c]) > CLEARLY * noise:
        newest = estimate.block[c] % BLOCKS
        for i in range(_SUMS):
            estimate.blocks[c, newest, i] = sums[i]
        estimate.block[c] += 1
        if not _fit(estimate, c, min(estimate.block[c], BLOCKS)) and estimate.block[c] > FEWEST_BLOCKS:
            _fit(estimate, c, FEWEST_BLOCKS)
    for i in range(_SUMS):
        sums[i] = 0.0


@helper
def _fit(estimate, c, count):
    """Estimates from the latest blocks, so many: whether the mass is known now."""
    if count < FEWEST_BLOCKS:
        return False
    blocks, newest = estimate.blocks[c], estimate.block[c] + BLOCKS - 1
    samples = PP = PV = VV = PY = VY = YY = AA = AU = UU = 0.0
    for i in range(count):
        one = blocks[(newest - i) % BLOCKS]
        samples += one[_COUNT]
        PP += one[_PP]
        PV += one[_PV]
        VV += one[_VV]
        PY += one[_PY]
        VY += one[_VY]
        YY += one[_YY]
        AA += one[_AA]
        AU += one[_AU]
        UU += one[_UU]
    of_velocity = PV / VV if VV > 0.0 else 0.0
    P, product = PP - of_velocity * PV, PY - of_velocity * VY
    Y = YY - VY * VY / VV if VV > 0.0 else YY
    estimate.explained[c] = 0.0
    if not (P > 0.0 and product > 0.0):
        return False
    inverse = product / P
    left = max(Y - inverse * product, 0.0)
    estimate.explained[c] = 1.0 - left / Y
    white = max((AA - 2.0 * inverse * AU + inverse * inverse * UU) / _FOURTH, estimate.rounding[c] * samples)
    noise = min(white * estimate.noise_gain[c], left)
    greatest = (Y - noise) / product  # 1/m, where what is left beside the noise is a hand that the scene answers
    friction = (VY - inverse * PV) / VV if VV > 0.0 else 0.0
    scatter = 0.0
    for i in range(count):
        one = blocks[(newest - i) % BLOCKS]
        missed = one[_PY] - inverse * one[_PP] - friction * one[_PV]
        missed -= of_velocity * (one[_VY] - inverse * one[_PV] - friction * one[_VV])
        scatter += missed * missed
    scatter = scatter * count / (count - 1.0) + _COLOURED * left / samples * P
    apart = 0.5 * math.log(greatest / inverse)
    uncertainty = math.sqrt(scatter / (product * product) + apart * apart)
    log_mass = -math.log(inverse) - apart
    least, most = estimate.log_least[c], estimate.log_most[c]
    if not (uncertainty < KNOWN and least - 3.0 * uncertainty < log_mass < most + 3.0 * uncertainty):
        return False
    estimate.log_mass[c] = min(max(log_mass, least), most)
    estimate.uncertainty[c] = uncertainty
    return True


def fill_mass_estimate(record: Any, period_s: float, numerator: NDArray[np.float64], first_lag: int) -> None:
    """Sets up a MASS_ESTIMATE, except for its channels. `numerator`: how much of T²/m f[n - first_lag], and of the
    forces before it, is in the second difference of the positions at sample n."""
    record.first_lag, record.count = first_lag, len(numerator)
    record.weights[: len(numerator)] = period_s**2 * numerator


def fill_channel(
    record: Any, channel: int, span_kg: tuple[float, float], sprung_kg: float, count_m: float, half_period: float
) -> None:
    """Sets up one channel, of which nothing is known yet. `sprung_kg`: k0 T² of the device; `count_m`: m per count;
    `half_period`: of the loop, in samples."""
    record.log_least[channel], record.log_most[channel] = np.log(span_kg)
    record.log_mass[channel] = record.log_least[channel]
    record.uncertainty[channel] = math.inf
    record.sprung[channel] = sprung_kg
    record.rounding[channel] = count_m**2 / 12.0
    record.span[channel] = span = min(max(round(half_period), 1), MOST_SPAN)
    record.slow_span[channel] = slow = min(span, MOST_SLOW_SPAN)
    record.noise_gain[channel] = np.sum(np.convolve(_second_difference(span), _second_difference(slow)) ** 2)


def _second_difference(over: int) -> NDArray[np.float64]:
    taps = np.zeros(2 * over + 1)
    taps[[0, over, 2 * over]] = 1.0, -2.0, 1.0
    return taps
