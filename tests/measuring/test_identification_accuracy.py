"""Identification beside prediction: two independent roads to the same pole, with every interface and damper."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import with_configuration

import hapsim
from hapsim.dampers import DAMPERS
from hapsim.holds import HOLDS
from hapsim.measuring.measure_trace import Measurement, measure_trace
from hapsim.running import run
from hapsim.scene import WITH_CUTOFF
from hapsim.theory import Configuration
from hapsim.theory.interface import SAMPLINGS
from tests import thorough

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
#: Scenes of a hand on one spring and damper; the others are played where the tick is tested.
RINGING = [
    "first_touch",
    "paper_6_1_no_delay",
    "paper_6_2_one_sample",
    "paper_6_3_real_damping",
    "sensed_velocity",
    "sprung_device",
    "zero_order_hold",
]
MASS, RATE = 0.2, 1000.0
COMBINATIONS = list(
    itertools.product(("zoh", "impulse"), ("ideal", "average"), (0.0, 0.37, 1.0, 1.5, 2.0), (0.0, 0.05))
)
# 40 in all; HAPSIM_POINTS=200 makes it 8000, in half an hour.
POINTS_EACH = thorough.points(1, 1)


def random_target(rng: np.random.Generator, friction: float) -> tuple[float, float]:
    """(k, b) with an eigenfrequency of 0.5 to 80 Hz; one in five within 1e-3 to 1e-9 of critical damping."""
    frequency = RATE * 10 ** rng.uniform(-2.5, -0.3)
    if rng.random() < 0.2:
        ratio = 1.0 + rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(-9, -3)
    else:
        ratio = 10 ** rng.uniform(-3, 0.3)
    return MASS * frequency**2, max(2.0 * ratio * MASS * frequency, 1e-3 * friction)


def damped_target(rng: np.random.Generator, spring: float) -> tuple[float, float]:
    """(k, b) of a device with a spring of its own, damped little to much."""
    frequency = RATE * 10.0 ** rng.uniform(-2.0, -0.5)
    k = spring + MASS * frequency**2
    return k, 2.0 * 10.0 ** rng.uniform(-3.0, -0.2) * np.sqrt(k * MASS)


def measured_in_memory(configuration: Configuration, k: float, stiffness: float, damping: float) -> Measurement:
    """A ring-down of a millimetre or less, recorded at 1 pm per count."""
    velocity = min(5e-4 * np.sqrt(k / MASS), 1.0)
    limit = float(max(1e-3, 2.0 * (stiffness * 1e-3 + damping * velocity)))
    recorded: Any = {"velocity": float(velocity), "quantum": 1e-12, "force_limit": limit}
    return measure_trace(run(with_configuration(configuration, stiffness, damping, **recorded), duration=4.0), MASS)


def can_be_written(stiffness: float, damping: float) -> bool:
    """The scene's format has no negative stiffness or damping."""
    return bool(np.isfinite(stiffness) and stiffness >= 0 and damping >= 0)


def test_at_a_picometre_every_pole_lies_within_four_of_the_uncertainties_stated(figures: Any) -> None:
    rng = np.random.default_rng(20)
    errors, ratios = [], []
    for hold, sampling, delay, normalised_friction in COMBINATIONS:
        configuration = Configuration(
            mass=MASS, rate=RATE, friction=normalised_friction * MASS * RATE, delay=delay, hold=hold, sampling=sampling
        )
        found = 0
        while found < POINTS_EACH:
            k, b = random_target(rng, configuration.friction)
            stiffness, damping = configuration.simulated(k, b)
            if not can_be_written(stiffness, damping):
                continue
            found += 1
            measured = measured_in_memory(configuration, k, stiffness, damping)
            errors.append(np.min(np.abs(measured.pole - configuration.dominant_poles(stiffness, damping))))
            off_k, off_b = abs(measured.k - k), abs(measured.b - b)
            uncertainties = measured.pole_uncertainty, measured.k_uncertainty, measured.b_uncertainty
            ratios.append(np.divide((errors[-1], off_k, off_b), uncertainties))
            if max(ratios[-1]) >= 4.0:
                print("beyond four uncertainties:", configuration, k, b, ratios[-1])
    worst = np.max(ratios, axis=0)
    figures.note(
        f"{len(errors)} points: pole error median {np.median(errors):.1e}, 99 % {np.quantile(errors, 0.99):.1e}, "
        f"worst {np.max(errors):.1e}; in stated uncertainties, worst of pole {worst[0]:.2f}, k {worst[1]:.2f}, "
        f"b {worst[2]:.2f}, root mean square {np.sqrt(np.mean(np.square(ratios))):.2f}"
    )
    assert len(errors) >= len(COMBINATIONS)
    assert np.median(errors) < 1e-9
    assert np.max(worst) < 4.0
    # Nor are they stated larger than they are: their squares average to about one.
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.3


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize("spring", [0.0, 0.001, 0.02])
@pytest.mark.parametrize("damper", DAMPERS)
def test_with_every_damper_and_a_spring_in_the_device_what_is_measured_is_what_is_predicted(
    damper: str, spring: float, figures: Any
) -> None:
    """Every hold and sampling, each with one of the delays."""
    rng = np.random.default_rng([int(1e4 * spring), *map(ord, damper)])
    own: Any = {
        "stiffness": spring * MASS * RATE**2,
        "damper": damper,
        "cutoff": 90.0 if damper in WITH_CUTOFF else None,
    }
    for at, (hold, sampling, delay) in enumerate(itertools.product(HOLDS, SAMPLINGS, (0.0, 0.37, 1.0))):
        c = Configuration(mass=MASS, rate=RATE, friction=0.05, delay=delay, hold=hold, sampling=sampling, **own)
        K = B = -1.0
        while not can_be_written(K, B):
            k, b = damped_target(rng, c.stiffness)
            K, B = c.simulated(k, b)
        if (at + at // 3 + int(1e3 * spring)) % 3:
            continue
        measured = measured_in_memory(c, k, K, B)
        assert measured.dominant, (c, K, B, measured.reason)
        error = abs(measured.pole - c.dominant_poles(K, B)[0])
        assert error < min(4.0 * measured.pole_uncertainty, 1e-7), (c, K, B)
        assert measured.k == pytest.approx(k, rel=1e-6)
        assert measured.b == pytest.approx(b, rel=1e-6)
        figures.most("pole off by, with every damper", error)
        figures.most("k off by, relative, with every damper", abs(measured.k / k - 1.0))
        figures.most("b off by, relative, with every damper", abs(measured.b / b - 1.0))


def felt_and_measured(name: str, K: float, B: float, seconds: float | None, **mock: float) -> tuple[Any, Measurement]:
    """Returns what is predicted and measured of a shipped scene with this stiffness and damping, in virtual time."""
    document = hapsim.load_scene(name).model_dump(exclude_none=True)
    document["device"]["clock"] = "lockstep"
    document["modules"]["touch"] |= {"stiffness": K, "damping": B}
    document["mock"] = document.get("mock", {}) | mock
    scene = hapsim.Scene.model_validate(document)
    return hapsim.predict(scene).felt[0], hapsim.measure(scene, duration=seconds)


@pytest.mark.parametrize(
    ("name", "stiffness", "damping"),
    [
        ("paper_6_3_real_damping", 10.5, 0.0765),
        ("paper_6_3_real_damping", 24.5, 0.0855),
        ("paper_6_3_real_damping", 31.5, 0.1035),
        ("paper_6_3_real_damping", 38.5, 0.1215),
        ("paper_6_1_no_delay", 270.0, 0.825),
    ],
)
def test_half_a_second_of_an_overdamped_hand_is_enough(name: str, stiffness: float, damping: float) -> None:
    """Friction slows the hand, and a model without it needs false poles as slow as the hand's: order and friction have
    to be found together. The last motion ends within a few samples; the long quiet after it shows no pole."""
    felt, measured = felt_and_measured(name, stiffness, damping, 0.5)
    assert measured.k == pytest.approx(felt.k, rel=1e-4)
    assert abs(measured.k - felt.k) < 4.0 * measured.k_uncertainty < 1e-3 * felt.k
    assert abs(measured.b - felt.b) < 4.0 * measured.b_uncertainty < 1e-3 * felt.b


@pytest.mark.parametrize(
    ("stiffness", "damping", "misses", "seconds"),
    [
        (11.185284003473013, 0.08596513958602373, 0.05805815294206283, 4.0),
        (1.255936173777772, 0.10221576789790093, 0.07719174232668076, 1.9574698199437228),
    ],
)
def test_of_two_poles_that_are_alike_one_is_seen(
    stiffness: float, damping: float, misses: float, seconds: float
) -> None:
    """A fit to a record in pieces may have a pole next to one of the hand's. Either suffices."""
    felt, measured = felt_and_measured("paper_6_3_real_damping", stiffness, damping, seconds, misses=misses)
    assert abs(measured.k - felt.k) < 4.0 * measured.k_uncertainty < 0.02 * felt.k


@pytest.mark.parametrize(("stiffness", "damping"), [(0.0, 5.0), (0.0, 0.0), (5.4e-5, 16.4)])
def test_without_a_spring_there_is_no_stiffness(stiffness: float, damping: float) -> None:
    """The hand stays where it stops: that pole is at 1, and no constant stands in for it."""
    felt, measured = felt_and_measured("first_touch", stiffness, damping, None)
    assert measured.k == pytest.approx(felt.k, abs=1e-6)
    assert measured.b == pytest.approx(felt.b, rel=1e-6)


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("name", RINGING)
def test_every_shipped_scene_is_felt_as_predicted(name: str) -> None:
    """Pole within 1e-6, k and b within 1e-5, and all within four of the uncertainties stated."""
    scene = hapsim.load_scene(CONFIGS / f"{name}.yaml")
    scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
    felt, measured = hapsim.predict(scene).felt[0], hapsim.measure(scene)
    error = min(abs(measured.pole - pole) for pole in felt.poles)
    assert error < min(1e-6, 4 * measured.pole_uncertainty)
    for value in ("k", "b"):
        found, predicted = getattr(measured, value), getattr(felt, value)
        assert found == pytest.approx(predicted, rel=1e-5)
        assert abs(found - predicted) < 4 * getattr(measured, f"{value}_uncertainty")
