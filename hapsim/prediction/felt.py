"""What one lone hand feels: k, b and what is beside them, of a loop as the scene and its correction have it."""

from __future__ import annotations

import contextlib
import math
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

import numpy as np

from hapsim.prediction.correction import CORRECTIONS, Rendering, felt_error, stable_masses
from hapsim.prediction.linear import LinearScene, hand_of
from hapsim.prediction.types import Felt, Limits, Robustness
from hapsim.scene.choices import WITH_SENSOR
from hapsim.theory import Configuration, frequency_and_ratio
from hapsim.theory.correction import PredictedLoop, StatePredictor, as_read

_PLAIN = 0.01  # an error of what is felt that is worth a correction


def robustness_of(felt: Felt) -> Robustness:
    """What a hand meets beside k and b, by this prediction."""
    c, element = felt.configuration, (felt.stiffness, felt.damping)
    predictor = as_read(c) if felt.predictor is None else felt.predictor
    loop = PredictedLoop(c, predictor)
    with np.errstate(all="ignore"):  # beyond all numbers nothing is stable
        return Robustness(
            steady_stiffness=loop.steady_stiffness(*element) + c.stiffness,
            noise_gain=loop.noise_gain(*element),
            stable_masses=stable_masses(lambda true: loop._replace(plant=true), c, element),
        )


def felt_by(rendering: Rendering, linear: LinearScene, name: str) -> Felt:
    """What a lone hand feels; under a predictor in its loop, of the device as it is declared."""
    scene = rendering.seen
    felt = _felt_of(name, scene.device_points[name].channel, *hand_of(scene, linear, name))
    port = next((port for port in rendering.ports if port.name == name), None)
    if port is None or rendering.kind is None or not rendering.kind.predicts or felt.stiffness == felt.damping == 0.0:
        return felt
    return felt_of_predictor(felt, port.declared, rendering.predictor_of(port), (felt.stiffness, felt.damping))


def felt_of_predictor(
    felt: Felt, device: Configuration, predictor: StatePredictor, element: tuple[float, float]
) -> Felt:
    """`felt` of this device with a force that answers this predictor's state."""
    loop = PredictedLoop(device, predictor)
    poles = loop.poles(*element)
    k, b = (float(value) for value in loop.equivalent(*element))
    frequency, ratio = swing(device.mass, k, b)
    radius = float(abs(poles[0]))
    return replace(
        felt,
        configuration=device,
        stiffness=element[0],
        damping=element[1],
        k=k,
        b=b,
        frequency_hz=frequency,
        damping_ratio=ratio,
        dominant=math.isfinite(k),
        stable=radius < 1.0,
        spectral_radius=radius,
        poles=tuple(complex(pole) for pole in poles),
        reason="" if math.isfinite(k) else "the slowest poles are not those of a spring and damper",
        predictor=predictor,
    )


def correction_for(felt: Felt) -> str:
    """The simplest correction with which this hand would feel its stiffness and damping as they are written; "" where
    it does so within a hundredth without one, and where none makes it so."""
    device = felt.configuration
    k, b = felt.stiffness + device.stiffness, felt.damping + device.friction
    if felt.predictor is not None or not felt_error((np.array(felt.k), np.array(felt.b)), (k, b), device.mass) > _PLAIN:
        return ""
    for name in ("poles",) if device.spring_lag else ("poles", "predictor"):
        if np.isfinite(CORRECTIONS[name].seen_by_theory(device).simulated(k, b)).all():
            return name
    return ""


def swing(mass: float, k: float, b: float) -> tuple[float, float]:
    """Eigenfrequency in Hz and damping ratio."""
    frequency, ratio = frequency_and_ratio(mass, k, b)
    return float(frequency), float(ratio)


def felt_at_rate(felt: Felt, rate_hz: float) -> Felt:
    """What the same hand feels where the device samples at `rate_hz` while the loop takes it to sample at the rate of
    `felt`: the loop makes a velocity of a step with the period that it believes in, so a damper is stronger by as much
    as the true period is longer, and a filter's cutoff lower. A velocity that the device senses is what it is."""
    if felt.predictor is not None:
        device = replace(felt.configuration, rate=rate_hz)
        return felt_of_predictor(felt, device, felt.predictor, (felt.stiffness, felt.damping))
    slower = felt.configuration.rate / rate_hz
    cutoff = felt.configuration.cutoff
    configuration = replace(felt.configuration, rate=rate_hz, cutoff=None if cutoff is None else cutoff / slower)
    damping = felt.damping if felt.configuration.damper in WITH_SENSOR else felt.damping * slower
    return _felt_of(felt.name, felt.channel, configuration, felt.stiffness, damping)


def _felt_of(name: str, channel: int, configuration: Configuration, stiffness: float, damping: float) -> Felt:
    return replace(_of_element(configuration, stiffness, damping), name=name, channel=channel)


@lru_cache(1024)  # hands that are alike, and regions in which one feels the same
def _of_element(configuration: Configuration, stiffness: float, damping: float) -> Felt:
    element = stiffness, damping
    k, b = (float(value) for value in configuration.equivalent(*element))
    frequency, ratio = swing(configuration.mass, k if k > 0.0 else math.nan, b)
    passive = None
    with contextlib.suppress(ValueError):  # the condition is not derived
        passive = bool(configuration.is_passive(*element))
    return Felt(
        name="",
        channel=0,
        configuration=configuration,
        stiffness=stiffness,
        damping=damping,
        k=k,
        b=b,
        frequency_hz=frequency,
        damping_ratio=ratio,
        dominant=math.isfinite(k) and math.isfinite(b),
        stable=bool(configuration.is_stable(*element)),
        spectral_radius=float(configuration.spectral_radius(*element)),
        poles=tuple(complex(pole) for pole in configuration.poles(*element)),
        passive=passive,
        limits=Limits(configuration, stiffness, damping),
        linear_limit=float(configuration.linear_stiffness_limit(damping)),
        reason=str(configuration.why_no_equivalent(*element)),
    )


def felt_document(felt: Felt) -> dict[str, Any]:
    """Returns what one hand feels, as a JSON document: k (N/m), b (N·s/m), its configuration and robustness."""
    values = asdict(replace(felt, predictor=None))
    configuration = values.pop("configuration")
    values.pop("predictor")
    hand = {name: configuration[name] for name in ("mass", "friction", "delay", "hold", "sampling", "damper", "cutoff")}
    return values | hand | {"device_stiffness": configuration["stiffness"]} | robustness_of(felt)._asdict()
