"""Devices with a transmission and a lagging motor: theory and prediction beside a loop written out in SI units."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.prediction import predict, predict_impedance, z_width_of
from hapsim.prediction.drives import drive_sentences
from hapsim.prediction.force_bounds import fade_stiffness
from hapsim.prediction.linear import configuration_of
from hapsim.prediction.plausibility import unlikely
from hapsim.prediction.prediction import Prediction
from hapsim.prediction.virtual_coupling import virtual_couplings
from hapsim.scene import Scene, parse_scene
from hapsim.scene.varied import Varied
from hapsim.theory import Configuration, Network
from hapsim.theory.plant import Drive
from hapsim.theory.sample import hand_kicks, hands_of, loop
from tests import driven_devices, thorough
from tests.driven_devices import Device, belted, impedance, radius, random_device, transition

PLANTS = thorough.points(15, 25)
HANDS = 20


def scene_of(device: Device) -> Scene:
    return parse_scene(device.yaml)


def prediction_of(device: Device) -> Prediction:
    return predict(scene_of(device), with_margins=False)


def belt(stiffness: float, *, handle: bool) -> Device:
    """Returns the device of 0.2 kg with a motor of 50 g and a belt damped by 2 % of critical."""
    damping = 0.02 * 2.0 * math.sqrt(stiffness * 0.05 * 0.15 / 0.2)
    return Device(belt=stiffness, belt_damping=damping, motor_mass=0.05, reads_handle=handle)


@pytest.mark.parametrize(
    ("device", "k", "b", "growth", "limit"),
    [
        (belt(2e4, handle=False), 1961.260049, 2.690532, 0.995232514, 2491.521),
        (belt(2e4, handle=True), 2124.794038, 3.060636, 0.992377609, 3785.531),
        (belt(1e5, handle=False), 2055.823720, 2.950660, 0.995161324, 3898.393),
        (belt(1e5, handle=True), 2089.014853, 3.028625, 0.992457028, 3873.569),
        (Device(lag=1e-4), 2082.289678, 2.806561, None, 3648.778),
        (Device(lag=3e-4), 2084.587715, 2.374939, None, 3239.884),
        (Device(lag=1e-3), 2077.843518, 0.859202, None, 2327.368),
    ],
)
def test_what_a_hand_feels_behind_a_belt_or_a_lag(
    device: Device, k: float, b: float, growth: float | None, limit: float
) -> None:
    found = predict(scene_of(device))
    (part,) = found.parts
    assert float(part.felt.k[0, 0]) == pytest.approx(k, abs=6e-7)
    assert float(part.felt.b[0, 0]) == pytest.approx(b, abs=6e-7)
    assert growth is None or found.spectral_radius == pytest.approx(growth, abs=6e-10)
    assert found.margins[0].stiffness_factor * device.K == pytest.approx(limit, abs=6e-4)
    assert found.verdict == "stable"
    assert predict(scene_of(replace(device, K=1.001 * limit))).verdict == "unstable"


def test_random_devices_agree_with_the_loop_written_out() -> None:
    """As `tools/bench/drives` does, with 300 of them."""
    off, reasons = driven_devices.largest_errors(range(PLANTS), prediction_of)
    assert off.max() < 1e-9, off
    assert reasons < 0.1 * PLANTS


@pytest.mark.parametrize("seed", range(0, PLANTS, 5))
def test_the_impedance_is_that_of_a_hand_that_pushes_the_handle(seed: int) -> None:
    device, hertz = random_device(seed), np.array([0.7, 77.0, 310.0, 480.0])
    found = predict_impedance(scene_of(device), hertz)
    expected = [impedance(device, one) for one in hertz.tolist()]
    np.testing.assert_allclose((found.device + found.rendered)[:, 0, 0], expected, rtol=1e-8)
    alone = [impedance(replace(device, K=0.0, B=0.0), one) for one in hertz.tolist()]
    np.testing.assert_allclose(found.device[:, 0, 0], alone, rtol=1e-8)


@pytest.mark.parametrize("seed", range(0, PLANTS, 5))
def test_an_impulse_on_the_handle_moves_handle_and_motor_as_written_out(seed: int) -> None:
    device = random_device(seed)
    network = prediction_of(device).network
    state, step = hand_kicks(network), np.eye(len(loop(network).change)) + loop(network).change
    plant, flow = driven_devices.Plant(device), transition(device)
    written = np.zeros(len(flow))
    written[: len(plant.push)] = plant.push * device.mass / driven_devices.T
    bodies = [device.motor_mass, device.mass - device.motor_mass] if device.motor_mass else [device.mass]
    for _ in range(6):
        state, written = step @ state, flow @ written
        x, v, energy = hands_of(network, state)
        at = written[: len(bodies)]
        assert float(x[0, 0]) == pytest.approx(at[-1], rel=1e-9)
        assert float(v[0, 0]) == pytest.approx(written[2 * len(bodies) - 1] * driven_devices.T, rel=1e-9, abs=1e-12)
        assert float(energy[0, 0]) == pytest.approx(np.array(bodies) @ at**2, rel=1e-9)


def passive(seed: int, rng: np.random.Generator) -> Device:
    """Returns a random device with the sensor and the friction at the motor, which does not lag, on a soft wall."""
    one = random_device(seed)
    own = {"K": one.mass * rng.uniform(100.0, 3000.0), "B": one.mass * rng.uniform(0.0, 5.0), "friction": 1.0}
    belt = belted(10 ** rng.uniform(1.5, 3.0), 0.0, rng.uniform(0.1, 0.6), mass=one.mass)
    return replace(belt, delay=one.delay, hold=one.hold, **own)  # type: ignore[arg-type]


def hand(rng: np.random.Generator) -> dict[str, object]:
    """Returns masses in a row on springs and dampers, and a spring to a fixed place."""
    hung = [
        (10 ** rng.uniform(-4, 1), 10 ** rng.uniform(0, 6), 10 ** rng.uniform(-3, 1) * (rng.random() < 0.5))
        for _ in range(rng.integers(0, 4))
    ]
    return {"hung": tuple(hung), "own_spring": 10 ** rng.uniform(0, 6) * (rng.random() < 0.5)}


def test_with_the_friction_that_a_mass_needs_a_belt_is_stable_in_any_hand() -> None:
    rng, shaken = np.random.default_rng(5), 0
    for seed in range(PLANTS):
        device = passive(seed, rng)
        rigid = prediction_of(replace(device, motor_mass=0.0)).parts[0]
        any_hand = prediction_of(device).parts[0].any_hand
        needed = float(any_hand.needed[0])
        assert needed == pytest.approx(float(rigid.any_hand.needed[0]), rel=1e-9)
        enough = replace(device, friction=1.0001 * needed)
        assert prediction_of(enough).parts[0].passive
        assert max(radius(replace(enough, **hand(rng))) for _ in range(HANDS)) <= 1.0 + 1e-9  # type: ignore[arg-type]
        lacking = replace(device, friction=0.8 * needed)
        if (worst := prediction_of(lacking).parts[0].any_hand.shaking) is not None:
            held = replace(lacking, mass=lacking.mass + worst.mass, own_spring=worst.stiffness)
            assert np.abs(np.abs(driven_devices.poles(held)) - worst.growth).min() < 1e-9
            shaken += worst.growth > 1.0
    assert shaken >= 0.8 * PLANTS


@pytest.mark.parametrize(
    ("device", "reason"),
    [
        (belted(100.0, reads_handle=True), "only for a transmission with the sensor and the friction at the motor"),
        (belted(100.0, brakes_handle=True), "only for a transmission with the sensor and the friction at the motor"),
        (Device(lag=1e-3), "for a motor that lags"),
        (belted(100.0, lag=1e-3), "for a motor that lags"),
        (belted(100.0, ratio=0.05), "what the damping of the transmission adds is not derived"),
    ],
)
def test_where_passivity_is_not_derived_the_reason_is_reported(device: Device, reason: str) -> None:
    part = prediction_of(device).parts[0]
    assert part.passive is None
    assert reason in part.any_hand.not_derived


def test_a_steady_push_meets_the_belt_only_where_the_sensor_is_at_the_motor() -> None:
    for device, met in (
        (belt(2e4, handle=False), 1.0 / (1.0 / 2e4 + 1.0 / 2000.0)),
        (belt(2e4, handle=True), 2000.0),
        (replace(belt(2e4, handle=False), own_spring=300.0), 300.0 + 1.0 / (1.0 / 2e4 + 1.0 / 2000.0)),
        (Device(lag=1e-3), 2000.0),
    ):
        found = prediction_of(device).parts[0]
        assert float(found.static_stiffness[0, 0]) == pytest.approx(met, rel=1e-12)
        z = complex(impedance(device, 1e-3))
        assert -2.0 * math.pi * 1e-3 * z.imag == pytest.approx(met, rel=1e-6)


def test_two_hands_on_belts_feel_each_other_as_two_alike_do() -> None:
    """Two alike hands on one link swing against each other like one on half of it to a wall."""
    half = replace(belt(2e4, handle=False), K=500.0, B=3.0)
    text = half.yaml.replace("wall: {type: ground}", "wall: {type: device, channel: 1}")
    (part,) = predict(parse_scene(text), with_margins=False).parts
    alone = prediction_of(replace(half, K=1000.0, B=6.0)).parts[0].felt
    assert part.felt.reason == ""
    apart = np.array([1.0, -1.0]) / 2.0
    assert 2.0 * apart @ part.felt.k @ apart == pytest.approx(float(alone.k[0, 0]), rel=1e-9)
    assert 2.0 * apart @ part.felt.b @ apart == pytest.approx(float(alone.b[0, 0]), rel=1e-9)
    together = np.array([1.0, 1.0]) / 2.0
    assert 2.0 * together @ part.felt.k @ together == pytest.approx(0.0, abs=1e-6)


def test_where_several_motions_count_there_is_a_reason_and_no_pair() -> None:
    found = prediction_of(random_device(114)).parts[0]
    assert found.felt.reason.startswith("it answers a push otherwise")
    assert len(found.felt.frequencies_hz) == 2
    assert np.isnan(found.felt.k).all()


def test_poles_are_placed_through_belt_and_lag() -> None:
    for device in (belt(1e5, handle=True), Device(lag=5e-4), belt(2e4, handle=False)):
        text = device.yaml.replace("delay:", "correction: poles, delay:")
        found = predict(parse_scene(text), with_margins=False)
        felt = found.parts[0].felt
        assert (float(felt.k[0, 0]), float(felt.b[0, 0])) == pytest.approx((2000.0, 6.0), rel=1e-7)
        K, B = found.rendering.ports[0].rendered  # type: ignore[union-attr]
        assert driven_devices.felt(replace(device, K=K, B=B)) == pytest.approx((2000.0, 6.0), rel=1e-7)


@pytest.mark.thorough
def test_poles_that_no_element_places_through_the_drive_are_reported() -> None:
    text = replace(belt(1e5, handle=False), lag=1e-4).yaml.replace("delay:", "correction: poles, delay:")
    (note,) = predict(parse_scene(text), with_margins=False).rendering.notes  # type: ignore[union-attr]
    assert note.startswith("no stiffness and damping at hand places the slowest mode as desired")


def test_a_travel_margin_is_judged_with_the_belt() -> None:
    device = replace(belt(2e4, handle=False), own_spring=20.0)
    most = fade_stiffness(scene_of(device), 0)
    held = replace(device, friction=device.friction + 5.0, B=0.0)
    assert radius(replace(held, K=0.999 * most)) < 1.0 < radius(replace(held, K=1.001 * most))


def test_what_is_not_derived_for_a_drive_is_refused_in_words() -> None:
    for device, key in ((belt(2e4, handle=False), "transmission"), (Device(lag=1e-3), "motor_lag")):
        with pytest.raises(UsageError, match=rf"device\.{key}: found one, expected none"):
            virtual_couplings(scene_of(device))


def configuration(device: Device) -> Configuration:
    return configuration_of(scene_of(device), 0)


@pytest.mark.parametrize("seed", range(PLANTS))
def test_the_closed_form_of_a_driven_hand_is_that_of_the_loop_written_out(seed: int) -> None:
    device = random_device(seed)
    c, (part,) = configuration(device), prediction_of(device).parts
    k, b = c.equivalent(device.K, device.B)
    assert float(c.spectral_radius(device.K, device.B)) == pytest.approx(radius(device), abs=1e-12)
    assert (float(k), float(b)) == pytest.approx((part.felt.k[0, 0], part.felt.b[0, 0]), rel=1e-9, nan_ok=True)
    assert (c.why_no_equivalent(device.K, device.B) == "") == (part.felt.reason == "") == bool(np.isfinite(k))
    if np.isfinite(k):
        assert c.simulated(k, b) == pytest.approx((device.K, device.B), rel=1e-9)
    for end, of in ((c.stable_stiffness(device.B)[1], "K"), (c.stable_damping(device.K)[1], "B")):
        if np.isfinite(end):  # no B makes a stiff spring behind a soft belt stable
            inside, beyond = (radius(replace(device, **{of: share * float(end)})) for share in (1 - 1e-6, 1 + 1e-6))
            assert inside < 1.0 < beyond


@pytest.mark.parametrize("reads_handle", [False, True])
def test_at_the_stability_limit_some_motion_of_a_driven_hand_neither_grows_nor_decays(reads_handle: bool) -> None:
    """Also where it is the belt that swings, and not the hand."""
    device = belt(2e4, handle=reads_handle)
    K, B = configuration(device).stability_limit(np.array([5.0, 12.0, 120.0, 150.0, 400.0]))
    assert np.isfinite(K).sum() >= 2
    for one, other in zip(K[np.isfinite(K)], B[np.isfinite(K)], strict=True):
        assert radius(replace(device, K=float(one), B=float(other))) == pytest.approx(1.0, abs=1e-9)


def test_the_stiffest_walls_of_a_driven_device_are_at_the_limit() -> None:
    device = belt(2e4, handle=False)
    widths = z_width_of(scene_of(device), 0, [10.0, 100.0])
    K, B = widths["stable"].wall
    assert radius(replace(device, K=0.999 * K, B=B)) < 1.0 < radius(replace(device, K=1.01 * K, B=B))
    assert 1.1 * max(configuration(device).stable_stiffness(np.array([B - 0.2, B + 0.2]))[1]) / 1.2 < K
    assert widths["passive"].wall == z_width_of(scene_of(Device()), 0, [10.0])["passive"].wall
    assert list(z_width_of(scene_of(Device(lag=1e-3)), 0, [10.0])) == ["stable"]


@pytest.mark.parametrize("wrong", [{"sampling": "average"}, {"hold": "impulse"}, {"damper": "sensed"}, {"mass": 0.05}])
def test_a_configuration_refuses_what_is_not_derived_for_a_drive(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))} is "):
        replace(configuration(belt(2e4, handle=False)), **wrong)  # type: ignore[arg-type]


def test_the_tolerances_of_a_driven_hand_end_where_it_feels_otherwise() -> None:
    text = replace(belt(2e4, handle=False), K=1000.0).yaml.replace("delay:", "correction: poles, delay:")
    (part,) = (prediction := predict(parse_scene(text), with_margins=False)).parts
    K, B = prediction.rendering.ports[0].rendered  # type: ignore[union-attr]
    device = replace(belt(2e4, handle=False), K=K, B=B)
    (one, _) = part.tolerances()
    assert part.asked == (1000.0, 6.0)

    def off(**true: float) -> float:
        k, b = driven_devices.felt(replace(device, **true))  # type: ignore[arg-type]
        return max(abs(k / 1000.0 - 1.0), abs(b / 6.0 - 1.0))

    for name in ("mass", "friction", "delay"):
        for end in getattr(one, name):
            assert off(**{name: end}) == pytest.approx(0.05, rel=1e-3)


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (belted(6.0), "stretches it by more than 20 mm, so the motor does not hold the handle"),
        (Device(lag=0.05), "the force of a motor follows within milliseconds"),
    ],
)
def test_a_soft_belt_and_a_long_lag_are_probably_mistakes(device: Device, words: str) -> None:
    assert any(words in one for one in unlikely(scene_of(device)))


def test_a_network_refuses_drives_that_do_not_fit() -> None:
    own = {"channel_friction": [1.0], "delay": 1.0, "hold": "zoh", "sampling": "ideal", "point_mass": []}
    wall = {"ends": [[0, -1]], "stiffness": [1.0], "damping": [0.0]}
    for drives, words in (
        ([Drive(1.0, 0.0, 0.2)], "lighter than motor and handle"),
        ([Drive(), Drive()], "drives has 2 elements"),
    ):
        with pytest.raises(ValueError, match=words):
            Network(1000.0, [0.2], **own, **wall, drives=drives)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("device", "sentences"),
    [
        (Device(), []),
        (
            belt(2e4, handle=False),
            ["Transmission of hand: a motor of 0.05 kg and a handle of 0.15 kg on 20000 N/m swing .* at 116.2 Hz$"],
        ),
        (
            replace(belted(1300.0), lag=3e-4),
            [".* at 1.3 kHz, beyond half the rate: the loop sees it at 300 Hz$", ".*lags by 0.3 ms \\(0.3 samples\\)$"],
        ),
        (
            belted(3e5, reads_handle=True, brakes_handle=True),
            ["Transmission of hand: .*", "Transmission and motor lag change no digit .*"],
        ),
    ],
)
def test_check_describes_the_drive_and_reports_one_that_changes_nothing(device: Device, sentences: list[str]) -> None:
    found = [*drive_sentences(prediction_of(device))]
    assert len(found) == len(sentences)
    for sentence, pattern in zip(found, sentences, strict=True):
        assert re.match(pattern, sentence), sentence


def test_a_sweep_changes_the_belt() -> None:
    varied = Varied(scene_of(belt(2e4, handle=False)))
    changed = varied.scene({"device.transmission.stiffness": 1e5, "device.motor_lag": 1e-3})
    (drive,) = changed.device.drives(1)
    assert (drive.stiffness, drive.motor_mass, drive.lag) == (1e5, 0.05, 1e-3)
