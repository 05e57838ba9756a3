"""The mass by a sensor of acceleration: as exact as its noise allows, known soon after a grip, and no worse than by the
positions if its scale is wrong."""

from __future__ import annotations

import math
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.loop.adaptive import predict_adaptively, read_accelerations
from hapsim.loop.exchange import LOOP
from hapsim.prediction.correction import Rendering, rendered
from hapsim.recording.trace import Trace
from hapsim.running import Excitation, correction_setup, run
from hapsim.running.correction_setup import LoopCorrection, predictor_for
from hapsim.scene import Scene
from tests import one_hand

Samples = NDArray[np.float64]

RATE, MASS, SCALE_TRUSTED = 1000.0, 0.3, 0.01
BLOCK, BLOCKS, SPAN = 24, 8, 3  # samples at 1 kHz
_AS_FINE = 1e-9  # N and m


def scene_of(mock: Any = None, **device: Any) -> Scene:
    """K = 2000, B = 5, a mass between 0.1 and 0.4 kg, and a sensor of acceleration."""
    own = {"mass": {"from": 0.1, "to": 0.4}, "sensors": ["acceleration"], "correction": "adaptive"} | device
    return one_hand.scene_of({"touch": one_hand.touch(2000.0, 5.0)}, device=own, mock=mock)


@cache
def rendering() -> Rendering:
    return rendered(scene_of())


class Ticks:
    """The hooks of a loop without a device: it sends the given forces, whatever it reads."""

    def __init__(self, of: Rendering | None = None, senses: bool = True, by_positions: bool = True) -> None:
        self.loop = loop = new_record(LOOP)
        loop.io.channels, loop.io.accelerations, loop.io.force_scale[0] = 1, 1, _AS_FINE
        loop.tick.io, loop.tick.gap, loop.tick.age = address_of(loop.io), 1, 1
        self.correction = LoopCorrection(loop, of or rendering(), SimpleNamespace(position_scale=(_AS_FINE,)))  # type: ignore[arg-type]
        self.hooks = [predict_adaptively, read_accelerations] if senses else [predict_adaptively]
        if not senses:
            self.correction._adaptive.senses = 0
        if not by_positions:
            self.correction._adaptive.estimate.rounding[:] = math.inf  # no motion is more than their noise

    def run(self, positions: Samples, accelerations: Samples, forces: Samples) -> tuple[float, float]:
        """Reads m and m/s², and answers with N. Returns (kg, its standard uncertainty in kg) after the last sample."""
        io, addresses = self.loop.io, (address_of(self.loop.predictor), address_of(self.loop.tick))
        counts = np.rint(forces / _AS_FINE).astype(np.int64)
        for x, a, f in zip(positions, accelerations, counts, strict=True):
            io.measured[0], io.acceleration[0] = x, a
            for hook in self.hooks:
                hook(*addresses)
            io.force_counts[0] = f
        masses = self.correction.masses(1)
        return masses["estimated_mass_kg"][0] or 0.0, masses["estimated_mass_uncertainty_kg"][0] or 0.0


def known(ticks: Ticks, *given: Samples) -> tuple[float, float]:
    """(kg, its relative uncertainty) at the end."""
    mass, uncertainty = ticks.run(*given)
    return mass, uncertainty / mass


def pushed(forces: Samples, stiffness: float = 0.0) -> tuple[Samples, Samples]:
    """Positions (m) and accelerations (m/s²) of MASS with 1 N·s/m and a spring, whose force of sample n acts from n + 1
    on."""
    rate = np.array([[0.0, 1.0, 0.0], [-stiffness / MASS, -1.0 / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]])
    moves, state = expm(rate / RATE), np.zeros(3)
    positions, accelerations = np.empty_like(forces), np.empty_like(forces)
    for n, state[2] in enumerate([0.0, *forces[:-1]]):
        positions[n], accelerations[n] = state[0], rate[1] @ state
        state = moves @ state
    return positions, accelerations


def some_forces(samples: int, seed: int = 1) -> Samples:
    """2.5 N to either side, the same in every BLOCK samples."""
    block = np.repeat(np.random.default_rng(seed).permutation([-2.5, 2.5] * 4), BLOCK // 8)
    return np.tile(block, samples // BLOCK + 1)[:samples]


@pytest.mark.thorough
def test_the_spread_is_what_the_noise_of_the_sensor_makes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The slope of a regression on a known force: var = p R p / (p p)², with R of noise that is differenced twice."""
    forces, noise, seeds = some_forces(13 * BLOCK), 0.5, 120
    acting = np.concatenate([[0.0], forces[:-1]])
    p = (acting[2 * SPAN :] - 2.0 * acting[SPAN:-SPAN] + acting[: -2 * SPAN])[-BLOCK * BLOCKS :]
    lags = np.abs(np.subtract.outer(np.arange(p.size), np.arange(p.size)))
    R = 6.0 * (lags == 0) - 4.0 * (lags == SPAN) + 1.0 * (lags == 2 * SPAN)
    expected = noise * MASS * math.sqrt(p @ R @ p) / (p @ p)
    random = np.random.default_rng(2)
    monkeypatch.setattr(correction_setup, "predictor_for", cache(predictor_for))  # the same for every seed
    masses, stated = zip(
        *(
            known(
                Ticks(by_positions=False),
                0.0 * acting,
                acting / MASS + 9.81 + noise * random.standard_normal(acting.size),
                forces,
            )
            for _ in range(seeds)
        ),
        strict=True,
    )
    off = np.log(np.array(masses) / MASS)
    assert abs(np.mean(off)) < 4.0 * expected / math.sqrt(seeds)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(expected, rel=4.0 / math.sqrt(2.0 * seeds))
    by_noise = math.sqrt(np.median(stated) ** 2 - SCALE_TRUSTED**2)
    assert expected < by_noise < 3.0 * expected


@pytest.mark.parametrize(("mass", "scale"), [(0.4, 0.98), (0.1, 1.02)])
def test_a_mass_at_an_end_of_the_span_is_known_with_a_scale_that_puts_it_outside(mass: float, scale: float) -> None:
    forces = some_forces(400)
    sensed = scale * np.concatenate([[0.0], forces[:-1]]) / mass
    found, uncertainty = known(Ticks(by_positions=False), 0.0 * forces, sensed, forces)
    assert found == pytest.approx(mass)
    assert uncertainty == pytest.approx(SCALE_TRUSTED, rel=0.01)


def test_without_the_sensor_nothing_is_added_to_the_loop() -> None:
    """So that nothing more is compiled, either."""
    for sensors in ((), ("acceleration",)):
        hooks = Ticks(rendered(scene_of(sensors=sensors))).correction.hooks
        assert (read_accelerations in [hook.function for hook in hooks]) == bool(sensors)


@pytest.mark.parametrize("scale", [0.6, 0.97, 1.03, 1.5, 2.5])
@pytest.mark.parametrize("noise", [1e-6, 1e-5])
def test_a_wrong_scale_costs_less_than_the_uncertainty_of_the_positions(scale: float, noise: float) -> None:
    forces = some_forces(1000)
    positions, accelerations = pushed(forces)
    random = np.random.default_rng(3)
    read = positions + noise * random.standard_normal(forces.size)
    sensed = scale * accelerations + 0.05 * random.standard_normal(forces.size)
    by_positions, uncertainty = known(Ticks(senses=False), read, sensed, forces)
    both, together = known(Ticks(), read, sensed, forces)
    assert by_positions == pytest.approx(MASS, rel=3.0 * uncertainty)
    assert abs(math.log(both / by_positions)) < uncertainty
    assert together < 1.001 * uncertainty


def run_pushed(mock: dict[str, Any], duration: float, **device: Any) -> Trace:
    """Pushes 2.5 N for 8 ms every 75 ms. The positions are too noisy to show the mass, unless `mock` has other ones."""
    scene = scene_of({"mass": MASS, "noise": 2e-4, "seed": 1} | mock, **device)
    return run(
        scene, duration=duration, transport="loopback", excitation=Excitation(0, 2.5, 8, 75, start=0, first=False)
    )


def estimated(trace: Trace) -> tuple[float, float]:
    """(kg, its relative uncertainty)"""
    (mass,), (uncertainty,) = trace.report.estimated_mass_kg, trace.report.estimated_mass_uncertainty_kg
    assert mass is not None
    assert uncertainty is not None
    return mass, uncertainty / mass


def test_positions_that_are_too_noisy_show_no_mass() -> None:
    assert estimated(run_pushed({}, 1.0, sensors=()))[1] > 0.1


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("age", [0, 1])
@pytest.mark.parametrize(
    ("delay", "hold"), [(0.0, "zoh"), (0.4, "zoh"), (1.0, "zoh"), (2.3, "zoh"), (1.0, "ramp"), (0.6, "ramp")]
)
def test_the_force_is_the_one_that_acts_at_the_instant_of_the_acceleration(delay: float, hold: str, age: int) -> None:
    mass, uncertainty = estimated(run_pushed({}, 1.0, delay=delay, hold=hold, acceleration_age=age))
    assert mass == pytest.approx(MASS, rel=0.003)
    assert uncertainty < 1.5 * SCALE_TRUSTED


def test_an_impulse_is_over_at_the_sample_and_shows_no_mass() -> None:
    assert estimated(run_pushed({}, 1.0, hold="impulse"))[1] > 0.1


@pytest.mark.parametrize("stiffness", [0.0, 20_000.0])
def test_friction_and_spring_of_the_device_act_too(stiffness: float) -> None:
    """The velocity is the difference of two positions: b0 T / 4 m, 0.001, of the force that begins at the sample."""
    forces = some_forces(400)
    ticks = Ticks(rendered(scene_of(stiffness=stiffness)), by_positions=False)
    mass, uncertainty = known(ticks, *pushed(forces, stiffness), forces)
    assert mass == pytest.approx(MASS, rel=0.001)
    assert uncertainty == pytest.approx(SCALE_TRUSTED, rel=0.01)


@pytest.mark.parametrize("masses", [(0.1, 0.38), (0.38, 0.1), (0.3, 0.25)])
def test_a_grip_is_known_after_the_next_push(masses: tuple[float, float]) -> None:
    """The grip is at 1 s, in the tail of a push; the next two are at 1.05 s and 1.125 s."""
    mock = {"mass": masses[0], "noise": 1e-6, "acceleration_noise": 0.05, "grips": ((1.0, masses[1]),)}
    with_sensor, without = (run_pushed(mock, 1.125, **which) for which in ({}, {"sensors": ()}))
    mass, uncertainty = estimated(with_sensor)
    assert mass == pytest.approx(masses[1], rel=0.03)
    assert abs(mass - masses[1]) < 3.0 * uncertainty * mass
    assert estimated(without)[0] != pytest.approx(masses[1], rel=0.1)


def test_a_sensor_that_is_slow_to_follow_a_force_is_overruled_by_the_positions() -> None:
    """It reads a heavier mass, and no statistics show it."""
    slow = {"acceleration_noise": 0.05, "acceleration_bandwidth": 300.0}
    alone, beside = (estimated(run_pushed(slow | more, 1.0, acceleration_age=1)) for more in ({}, {"noise": 1e-5}))
    assert alone[0] > 1.1 * MASS
    assert beside[0] == pytest.approx(MASS, rel=3.0 * beside[1])
    assert beside[1] < 0.02


def test_a_late_force_is_not_compared_in_place_of_the_one_that_acted() -> None:
    mass, uncertainty = estimated(run_pushed({"misses": 0.05}, 2.0))
    assert mass == pytest.approx(MASS, rel=0.003)
    assert uncertainty < 1.1 * SCALE_TRUSTED


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("seed", range(3, 5))
def test_whatever_disturbs_the_hand_is_in_the_uncertainty(bench: Any, seed: int) -> None:
    """Dry friction, a hand that pushes slowly, one that knocks."""
    without, found = (bench.estimated(seed, 1.5, 1e-5, sensor) for sensor in (None, 0.05))
    assert abs(found["off"]) < 3.0
    assert found["uncertainty_kg"] < 0.8 * without["uncertainty_kg"]
