"""`identify_transmission` finds motor, transmission and handle of known mocks, and says what it cannot see."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from transmissions import Device, errors, identified, random_device

from hapsim.errors import HapsimError, UsageError
from hapsim.measuring.converters import Converters
from hapsim.measuring.identify_transmission import identify_transmission
from hapsim.measuring.transmission_fit import Fitter, Plant, Sides, TransmissionFit, response
from hapsim.measuring.transmission_play import MeasuredResponse, Spectra
from hapsim.running.run import run_to_end
from hapsim.scene import Scene
from tests import thorough

DEVICES = thorough.points(1, 4)
BELT = Device(
    mass=0.15,
    motor_mass=0.05,
    resonance_hz=123.3,
    damping_ratio=0.03,
    friction=1.0,
    lag=2e-4,
    coulomb=0.05,
    noise=0.0,
    quantum=2e-6,
    seed=0,
)
SHORT = {"force": 2.5, "travel": 0.005, "duration": 13.0, "transport": "loopback"}


def answer_to_a_pulse(plant: Plant, sides: Sides, rate: float, hold: str, samples: int) -> np.ndarray:
    """Position (samples,) after a force of 1 N in sample 0, from the equations of motion in SI units, step by step:
    the referee of the response. States: motor, its velocity, handle, its velocity, lagging force."""
    m, M, k, c = plant.motor, plant.handle, plant.belt, plant.damping
    change = np.zeros((6, 6))
    change[0, 1] = change[2, 3] = 1.0
    change[1, :5] = np.array([-k, -c, k, c, 1.0]) / m
    change[3, :4] = np.array([k, c, -k - plant.stiffness, -c]) / M
    rubbed, inertia = (1, m) if sides.friction == "motor" else (3, M)
    change[rubbed, rubbed] -= plant.friction / inertia
    change[4, 4:] = np.array([-1.0, 1.0]) / plant.lag
    fine = 400
    step = expm(change / (rate * fine))
    times = (np.arange(samples * fine) + 0.5) / fine - plant.delay  # in samples, from where the pulse begins to act
    ramp = np.clip(np.minimum(times, 2.0 - times), 0.0, 1.0)
    forces = np.where((times > 0.0) & (times < 1.0), 1.0, 0.0) if hold == "zoh" else ramp
    state, positions = np.zeros(6), np.zeros(samples)
    for i, force in enumerate(forces):
        if i % fine == 0:
            positions[i // fine] = state[0 if sides.sensor == "motor" else 2]
        state[5] = force
        state = step @ state
    return positions


def losing(share: float) -> Any:
    """A run whose record lacks this share of its rows, drawn at random."""

    def run(scene: Any, **options: Any) -> Any:
        trace, rng = run_to_end(scene, **options), np.random.default_rng(1)
        kept = rng.random(trace.sample.size) >= share
        rows = {one.name: getattr(trace, one.name) for one in fields(trace)}
        rows = {name: rows[name][kept] for name in rows if np.shape(rows[name])[:1] == kept.shape}
        return replace(trace, **rows)

    return run


@pytest.mark.parametrize(
    ("sensor", "friction", "hold", "delay"),
    [("motor", "motor", "zoh", 1.0), ("handle", "motor", "zoh", 0.25), ("motor", "handle", "ramp", 1.5)],
)
def test_the_response_is_that_of_the_equations_of_motion(sensor: Any, friction: Any, hold: str, delay: float) -> None:
    rate, samples, sides = 1000.0, 300, Sides(sensor, friction)
    plant = Plant(
        handle=0.1, friction=15.0, stiffness=4000.0, lag=3e-4, delay=delay, motor=0.05, belt=3e4, damping=12.0
    )
    positions = answer_to_a_pulse(plant, sides, rate, hold, samples)
    assert abs(positions[-1]) < 1e-6 * np.max(np.abs(positions))
    frequency = np.array([5.0, 37.0, 120.0, 340.0, 480.0])
    expected = np.exp(-2j * np.pi * np.outer(frequency, np.arange(samples)) / rate) @ positions
    found = response(plant, sides, frequency, rate, Converters(hold, "ideal"))
    # The referee holds a ramp constant over its fine steps.
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.max(np.abs(expected)))


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("kind", ["motor", "handle", "none"])
def test_random_devices_are_found(kind: str, figures: Any) -> None:
    """A few of `tools/bench/transmissions`, in half the time: of six heavy ones one may be lost in its counts."""
    count = DEVICES if kind == "motor" else max(DEVICES // 3, 1)
    found, undecided = [], 0
    for seed in range(1, 1 + count):
        device = random_device(seed)
        try:
            one = identified(device, kind, seconds=25.0)
        except UsageError:
            undecided += 1
            continue
        assert one.fit.masses == (1 if kind == "none" else 2)
        if kind != "none":
            assert one.fit.best.sides.sensor == kind
        off = errors(device, one)
        assert not abs(off.stiffness) > 0.03
        assert abs(off.lag) < 1e-5 or abs(off.lag_scaled) < 4.0
        found.append(off)
    assert undecided <= count // 6
    if kind == "motor":
        stiffness, lag = np.max(np.abs(found), axis=0)[:2]
        figures.note(f"{count} transmissions identified: stiffness off by {stiffness:.1e}, lag by {1e6 * lag:.1f} µs")


@pytest.mark.thorough
def test_a_ride_that_dry_friction_slows_grows_strong_nevertheless() -> None:
    """At first it weighs the device at two or half of its mass."""
    device = random_device(9029)
    found = identified(device, "motor", seconds=13.0)
    assert found.push_n > 3.5
    assert found.fit.best.plant.belt == pytest.approx(device.stiffness, rel=0.03)


@pytest.mark.thorough
def test_a_resonance_beyond_half_the_rate_is_found() -> None:
    device = BELT._replace(resonance_hz=616.0)
    found = identify_transmission(device.scene("motor"), **SHORT)
    assert found.fit.masses == 2
    assert (found.fit.delay_found, found.fit.play) == (False, None)
    assert found.fit.best.plant.resonance_hz == pytest.approx(616.0, rel=0.01)
    assert found.fit.best.plant.belt == pytest.approx(device.stiffness, rel=0.03)


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("resonance", [334.0, 666.0])
@pytest.mark.parametrize(("damping", "noise"), [(1.0, 1e-3), (0.05, 0.1)], ids=["apart", "alike"])
def test_a_resonance_is_separate_from_its_image_or_both_have_names(
    resonance: float, damping: float, noise: float
) -> None:
    """A fit that begins at an image ends at the better one. Both fit where noise hides the damping."""
    motor = Plant(0.15, 1.0, 0.0, 0.0, 1.0).with_belt(0.4, resonance)
    motor = motor._replace(damping=damping * motor.damping)
    sides, keeps, rng = Sides("motor", "motor"), Converters("zoh", "ideal"), np.random.default_rng(0)
    frequency = np.arange(6.0, 470.0, 2.0)
    clean = response(motor, sides, frequency, 1000.0, keeps)
    drawn = rng.standard_normal((2, 8, frequency.size))
    moved = clean * (1.0 + noise * (drawn[0] + 1j * drawn[1]))
    spectra = Spectra(1000, frequency, moved, np.ones_like(moved), np.abs(moved) ** 2, np.zeros(frequency.size, bool))
    fitter = Fitter(MeasuredResponse(spectra, np.arange(frequency.size)), 1000.0, keeps)
    for begin in (motor, motor.image(1000.0 - resonance), motor.image(1000.0 + resonance)):
        two, image = fitter.resolve_image(fitter.fit(begin, sides))
        if noise < 0.01:
            assert image is None
            assert two.plant.resonance_hz == pytest.approx(resonance, rel=1e-3)
            continue
        assert image is not None
        fit = TransmissionFit(
            1000.0, fitter.one_mass(Plant(0.15, 1.0, 0.0, 0.0, 1.0), sides), two, True, 500.0, False, 1.0, None, image
        )
        assert fit.masses == 0
        assert all(f"{one.plant.resonance_hz:.4g} Hz" in fit.verdict()[0] for one in (two, image))
        assert {round(one.plant.resonance_hz, -1) for one in (two, image)} == {330.0, 670.0}


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("declared", "true", "device"),
    [(2.0, 1.0, BELT), (1.4, 2.0, BELT), (1.0, 1.5, BELT._replace(quantum=1e-8, coulomb=0.0))],
)
def test_another_delay_than_the_declared_one_is_found(declared: float, true: float, device: Device) -> None:
    scene = device.scene("motor", delay=true)
    changed = scene.model_copy(update={"device": scene.device.model_copy(update={"delay": declared})})
    found = identify_transmission(changed, **SHORT)
    assert (found.fit.masses, found.fit.delay_found) == (2, True)
    assert found.fit.best.plant.delay == pytest.approx(true, abs=0.0 if device is BELT else 1e-3)
    lag, stiffness = found.estimates["motor_lag"], found.estimates["stiffness"]
    assert abs(lag.value - device.lag) < 2.0 * lag.uncertainty < 4e-5
    assert abs(stiffness.value - device.stiffness) < 2.0 * stiffness.uncertainty < 0.06 * device.stiffness
    one, two = (replace(each, squares=5.0 * each.freedom) for each in (found.fit.one, found.fit.two))
    unexplained = replace(found, fit=replace(found.fit, one=one, two=two))
    assert (unexplained.fit.masses, unexplained.estimates) == (0, {})
    assert f"no whole delay near {declared:g} samples" in unexplained.fit.verdict()[0]


@pytest.mark.thorough
def test_a_sensor_at_the_handle_does_not_separate_stiffness_and_motor() -> None:
    scene = BELT.scene("handle")
    unknown = scene.model_copy(update={"device": scene.device.model_copy(update={"transmission": None})})
    apart, together = (identify_transmission(one, **SHORT) for one in (scene, unknown))
    assert apart.sees_motor
    assert not together.sees_motor
    assert together.estimates.keys().isdisjoint({"stiffness", "motor_mass", "antiresonance_hz"})
    assert apart.estimates.keys().isdisjoint({"motor_mass", "handle_mass"})
    assert apart.estimates["mass"].value == pytest.approx(BELT.mass, rel=0.01)
    assert apart.estimates["stiffness"].value == pytest.approx(BELT.stiffness, rel=0.03)
    for found in (apart, together):
        assert found.estimates["resonance_hz"].value == pytest.approx(BELT.resonance_hz, rel=0.01)


def with_play(device: Device, backlash: float) -> Scene:
    scene = device.scene("motor")
    belt = scene.mock.transmission.model_copy(update={"backlash": backlash})
    return scene.model_copy(update={"mock": scene.mock.model_copy(update={"transmission": belt})})


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("resonance", "backlash"), [(60.0, 1e-4), (60.0, 3e-4), (123.0, 1e-5)])
def test_play_is_seen_at_the_lines_that_nothing_excites(resonance: float, backlash: float) -> None:
    device = BELT._replace(resonance_hz=resonance)
    fit = identify_transmission(with_play(device, backlash), **SHORT).fit
    assert fit.play is not None
    assert fit.masses == 0
    assert backlash / 4.0 < fit.play.size < 1.5 * backlash
    assert fit.two.plant.belt / device.stiffness == pytest.approx(fit.play.share, abs=0.15)
    assert fit.verdict()[0].startswith("Cannot tell the transmission, because motor and handle have play")


def test_a_motion_that_play_makes_irregular_does_not_repeat() -> None:
    with pytest.raises(UsageError, match=r"does not repeat: .* Backlash"):
        identify_transmission(with_play(BELT, 3e-4), **SHORT)


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("device", "options", "words"),
    [
        (BELT._replace(coulomb=0.5), {"force": 0.3}, "position has not changed by one count"),
        (BELT._replace(quantum=1e-5), {"travel": 1e-4}, r"moved the device by .* counts of 10 µm.*--travel"),
        (
            BELT._replace(mass=2.0, motor_mass=1.0, resonance_hz=390.0, quantum=2e-5, noise=1e-5),
            {},
            r"is lost in the position's counts of 20 µm\. Allow more travel",
        ),
        (BELT, {"duration": 5.0}, "duration: found 5 s, expected at least 13 s"),
    ],
    ids=["stuck", "no travel", "hidden", "too short"],
)
def test_what_cannot_be_identified_has_a_reason(device: Device, options: dict[str, float], words: str) -> None:
    with pytest.raises(HapsimError, match=words):
        identify_transmission(device.scene("motor"), **SHORT | options)


def test_a_motor_with_crossed_wires_is_refused() -> None:
    """The ride shows it, since a soft belt may swing against the pushes."""

    def crossed(scene: Any, **options: Any) -> Any:
        trace = run_to_end(scene, **options)
        trace.force_counts[:] *= -1
        return trace

    scene = BELT.scene("motor")
    with pytest.raises(HapsimError, match="disagree in sign"):
        identify_transmission(scene, run=crossed, **SHORT)


@pytest.mark.thorough
def test_a_host_that_loses_some_positions_finds_the_transmission_too() -> None:
    found = identify_transmission(BELT.scene("motor"), **SHORT, run=losing(0.01))
    assert found.fit.masses == 2
    assert found.fit.two.plant.belt == pytest.approx(BELT.stiffness, rel=0.03)


def test_a_host_that_loses_many_positions_gets_the_reason() -> None:
    with pytest.raises(UsageError, match="only 0 of 4 excitations were recorded with at least 95% of their positions"):
        identify_transmission(BELT.scene("motor"), **SHORT, run=losing(0.2))


@pytest.mark.thorough
def test_dry_friction_that_takes_most_of_the_force_is_no_motor_with_the_wrong_sign() -> None:
    assert identified(random_device(76), "none", seconds=13.0).fit.masses < 2
