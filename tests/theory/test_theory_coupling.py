"""Virtual couplings beside a loop written out: hand, delayed force, coupling, and a scene with implicit steps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hapsim.errors import UsageError
from hapsim.prediction.predict import predict
from hapsim.prediction.virtual_coupling import virtual_couplings
from hapsim.scene import Scene, parse_scene
from hapsim.theory import Configuration
from hapsim.theory.coupling import Coupling, _lacks, needed_friction, stiffest_coupling, stiffest_for
from hapsim.theory.interface import lag_of
from tests import thorough
from tests.coupled_devices import Behind, judged, radius, random_behind

T = 1e-3
DEVICES = thorough.points(6, 15)


def late(delay: float, hold: str = "zoh") -> Configuration:
    """Returns a device of 1 N·s/m."""
    return Configuration(1.0, 1.0 / T, 1.0, delay, hold)


def random_hand(rng: np.random.Generator, delay: float, hold: str = "zoh") -> Configuration:
    mass, spring = 10 ** rng.uniform(-5.5, 1.0), (0.0 if rng.random() < 0.3 else 10 ** rng.uniform(0.0, 6.5))
    return Configuration(mass, 1.0 / T, 1.001, delay, hold, stiffness=spring)


@pytest.mark.parametrize(
    ("delay", "stiffness", "damping", "digits"),
    [
        (0, 2000.0, 0.0, 1e-12),
        (1, 769.800358920, 0.281766487, 1e-9),
        (2, 483.451, 0.3800, 1e-3),
        (3, 354.852, 0.4306, 1e-3),
        (4, 281.035, 0.4615, 1e-3),
    ],
)
def test_the_stiffest_coupling_for_any_hand(delay: int, stiffness: float, damping: float, digits: float) -> None:
    """Closed forms: 2 b0/T without delay; 4 b0/(3 sqrt 3 T) and (sqrt 3 - 1) kappa at one sample."""
    found = stiffest_coupling(late(delay))
    assert found == pytest.approx((stiffness, damping), rel=digits, abs=1e-12)
    assert needed_friction(found, late(delay)) == pytest.approx(1.0, rel=1e-12)
    if delay == 1:
        assert found.stiffness == pytest.approx(4.0 / (3.0 * math.sqrt(3.0) * T), rel=1e-12)
        assert found.damping == pytest.approx((math.sqrt(3.0) - 1.0) * 0.5 * found.stiffness * T, rel=1e-12)


@pytest.mark.parametrize("delay", [0, 1])
def test_the_needed_friction_has_a_closed_form(delay: int) -> None:
    for kappa in (0.1, 0.5, 2.0):
        for damping in (0.01, 0.3, 5.0):
            B = kappa + damping
            closed = max(B, kappa**2 / B)
            if delay == 1:
                closed = 4.0 * kappa**2 / B if 2.0 * kappa**2 >= B**2 else B**3 / (B**2 - kappa**2)
            assert needed_friction(Coupling(2.0 * kappa / T, damping), late(delay)) == pytest.approx(closed, rel=1e-12)


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("delay", "hold", "less"),
    # Where the share is small a mass alone does not show the whole demand: that takes a hand that moves at every image.
    [
        *((0, "zoh", 0.95), (1, "zoh", 0.88), (2, "zoh", 0.95), (3, "zoh", 0.95), (4, "zoh", 0.95)),
        *((0.3, "zoh", 0.75), (1.5, "zoh", 0.9), (0, "ramp", 0.75), (1.3, "ramp", 0.9)),
    ],
)
def test_no_hand_shakes_a_coupling_and_with_less_friction_one_does(
    delay: float, hold: str, less: float, figures: Any
) -> None:
    rng, coupling = np.random.default_rng(int(10 * delay)), stiffest_coupling(late(delay, hold))
    each = [(random_hand(rng, delay, hold), random_behind(rng)) for _ in range(500)]
    assert max(radius(hand, coupling, scene) for hand, scene in each) < 1.0 + 1e-9
    lossless = ((replace(hand, friction=less), Behind(lossless=scene.lossless)) for hand, scene in each)
    shaken = max(radius(hand, coupling, scene) for hand, scene in lossless)
    figures.note(f"coupling with {hold}, delay {delay}: with {less} of the friction {shaken:.4f}-fold a sample")
    assert shaken > 1.0 + 1e-6


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("masses", "delay", "stiffness"),
    [
        ((0.2,), 1, 6524.92),
        ((0.1, 0.4), 1, 4634.78),
        ((0.05, 2.0), 1, 3306.82),
        ((0.2,), 0, 18447.7),
        ((0.1, 0.4), 0, 13098.5),
        ((0.05, 2.0), 0, 9338.4),
    ],
)
def test_a_hand_of_known_mass_allows_more(masses: tuple[float, ...], delay: int, stiffness: float) -> None:
    hands = [Configuration(mass=mass, rate=1.0 / T, friction=1.0, delay=delay) for mass in masses]
    found = stiffest_for(hands)
    assert found is not None
    assert found.stiffness == pytest.approx(stiffness, rel=1e-5)
    rng = np.random.default_rng(7)
    for _ in range(100):
        mass = rng.uniform(min(masses), max(masses))
        assert radius(replace(hands[0], mass=mass), found, random_behind(rng)) < 1.0 + 1e-9


@pytest.mark.parametrize("number", range(DEVICES))
def test_nothing_passive_shakes_a_hand_of_known_mass_on_any_device(number: int) -> None:
    """As `tools/bench/couplings` does, with more of them."""
    *_, most = judged(number, 20)
    assert most <= 1.0 + 1e-11


def test_a_device_with_little_friction_needs_a_soft_coupling_for_what_is_slow() -> None:
    """A simulated spring behind a coupling of twice the stiffness makes the hand swing at 16 Hz."""
    hand = Configuration(mass=1.44056, rate=50_000.0, friction=0.110550, delay=3)
    assert radius(hand, Coupling(1.4715e6, 13_000.0), Behind(stiffness=13_895.0)) > 1.000001
    found = stiffest_for([hand])
    assert found is not None
    assert 7e5 < found.stiffness < 7.5e5
    shaken = max(radius(hand, Coupling(1.3 * found.stiffness, found.damping), one) for one in fine_springs(found))
    assert shaken > 1.0 + 1e-12


def fine_springs(coupling: Coupling) -> Iterator[Behind]:
    return (Behind(stiffness=share * coupling.stiffness) for share in np.geomspace(1e-6, 1.0, 1001).tolist())


def lacking(theta: Any, delay: float, hold: str) -> Any:
    """Size less real part of reading times work at most, from the Fourier series of the force and of the reading, with
    200 images on either side."""
    omega = theta[:, None] + 2.0 * np.pi * np.arange(-200, 201)
    read = (1.0 - np.exp(-1j * omega)) / (1j * omega)
    force = (read if hold == "zoh" else read**2) * np.exp(-1j * (1.0 + delay) * omega)
    w = np.sum(force * read, axis=1) * np.exp(1j * theta)  # read with the step that ended last
    return np.sqrt(np.sum(np.abs(force) ** 2, axis=1)) - np.real(w)


@pytest.mark.parametrize("hold", ["zoh", "ramp"])
@pytest.mark.parametrize("delay", [0, 0.2, 0.5, 1, 1.7, 3])
def test_the_friction_for_any_hand_is_that_of_the_images(delay: float, hold: str) -> None:
    theta = np.linspace(0.01, math.pi, 500)
    lag = lag_of(delay, hold)
    found = [_lacks(lag, one)[0] for one in theta.tolist()]
    np.testing.assert_allclose(found, lacking(theta, delay, hold), atol=2e-3)
    slopes = [_lacks(lag, one)[1] for one in theta.tolist()]
    np.testing.assert_allclose(slopes[1:-1], np.gradient(found, theta)[1:-1], atol=1e-3 * (1.0 + delay) ** 3)


@pytest.mark.parametrize("hold", ["zoh", "ramp"])
@pytest.mark.parametrize("delay", [0, 0.2, 0.5, 1, 1.7, 2, 5, 20, 60.9, 1000])
def test_the_friction_for_any_hand_covers_every_frequency(delay: float, hold: str) -> None:
    rng = np.random.default_rng(int(delay))
    theta = np.append(np.geomspace(1e-6, math.pi, 4000), np.linspace(1e-4, math.pi, int(40 * (1 + delay))))
    whole, f = divmod(delay, 1.0)
    weights = (1.0 - f, f) if hold == "zoh" else (0.5 * (1.0 - f) ** 2, 0.5 + f - f**2, 0.5 * f**2)
    lacks = sum(c * 2.0 * np.sin(0.5 * (1.0 + whole + age) * theta) ** 2 for age, c in enumerate(weights))
    if hold == "ramp":
        less = 2.0 / 3.0 * np.sin(0.5 * theta) ** 2
        lacks -= less / (1.0 + np.sqrt(1.0 - less))
    for ratio in (1.0, *(1.0 + 10 ** rng.uniform(-6.0, 3.0, 20)).tolist()):
        kappa = 10 ** rng.uniform(-3.0, 3.0)
        B, u = ratio * kappa, np.sin(0.5 * theta) ** 2
        least = lacks * (B**2 * u + kappa**2 * (1.0 - u)) / (2.0 * B * u)
        found = needed_friction(Coupling(2.0 * kappa / T, B - kappa), late(delay, hold))
        assert found == pytest.approx(least.max(), rel=1e-2)
        assert found >= least.max() * (1.0 - 1e-9)


def scene_of(device: str, modules: str = "") -> Scene:
    lines = ["  hand: {type: device, channel: 0}", "  wall: {type: ground}", modules]
    return parse_scene("\n".join(["version: 1", "rate: 1000", f"device: {{{device}}}", "modules:", *lines]))


DEVICE = "mass: 0.2, friction: 1, delay: 1"


@pytest.mark.parametrize(
    ("mass", "explicit", "proxy"),
    [(0.02, 1.229158, 0.9213203), (0.2, 1.187643, 0.9290475), (0.001, 2.050188, 0.6337533)],
)
def test_an_explicit_mass_behind_the_coupling_needs_more_friction(mass: float, explicit: float, proxy: float) -> None:
    (found,) = virtual_couplings(scene_of(DEVICE), mass)
    assert (found.needed_friction, found.is_passive_behind) == (pytest.approx(proxy, rel=1e-6), True)
    Kc, Bc = found.any_hand.coupling
    joined = f"c: {{type: viscoelastic, between: [hand, ball], stiffness: {Kc}, damping: {Bc}}}"
    (part,) = predict(scene_of(DEVICE, f"  ball: {{type: mass, mass: {mass}}}\n  {joined}")).parts
    assert part.any_hand.needed[0] == pytest.approx(explicit, rel=1e-6)


@pytest.mark.parametrize(("device", "whole"), [("delay: 1.3", 1), ("delay: 1, hold: ramp", 1), ("delay: 0.4", 0)])
def test_a_later_device_has_a_softer_coupling(device: str, whole: int) -> None:
    (found,) = virtual_couplings(scene_of(f"mass: 0.2, friction: 1, {device}"))
    (before, later) = (
        virtual_couplings(scene_of(f"mass: 0.2, friction: 1, delay: {d}"))[0] for d in (whole, whole + 1)
    )
    for of in ("any_hand", "this_hand"):
        each = [getattr(one, of).coupling.stiffness for one in (later, found, before)]
        assert each == sorted(each)
    assert (found.any_hand.needed_friction, found.is_passive_behind) == (pytest.approx(1.0, rel=1e-9), True)
    assert found.needed_friction < 1.0  # a free proxy needs less


CUP = "  cup: {type: proxy, mass: 0.02, hand: hand, stiffness: 769, damping: 0.3}\n"
BEHIND = "  it: {type: %s, between: [cup, wall], %s}"


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("modules", "passive"),
    [
        ("", True),
        (BEHIND % ("buffer", "stiffness: 9000, damping: 9"), True),
        (BEHIND % ("detent", "pitch: 0.01, depth: 1, shape: snap"), False),
        ("  it: {type: damper, between: [hand, wall], damping: 1}", False),
        ("  ball: {type: mass, mass: 1}\n  it: {type: spring, between: [cup, ball], stiffness: 9}", False),
        ("  thumb: {type: device, channel: 1}\n  it: {type: spring, between: [cup, thumb], stiffness: 9}", False),
    ],
)
def test_a_scene_with_a_proxy_is_judged(modules: str, passive: bool) -> None:
    found = virtual_couplings(scene_of(DEVICE, CUP + modules))[0]
    assert found.present is not None
    assert found.present.coupling == (769.0, 0.3)
    assert found.present.needed_friction == needed_friction(found.present.coupling, late(1))
    assert (found.is_passive_behind, found.proxy_mass) == (passive, 0.02)


def test_what_is_felt_through_a_coupling_with_nothing_behind() -> None:
    (found,) = virtual_couplings(scene_of(DEVICE, CUP))
    (one,) = predict(scene_of(DEVICE, CUP)).parts
    assert found.present is not None
    assert one.weight is not None
    assert found.present.free_mass == pytest.approx(one.weight.felt, rel=1e-9)
    assert found.present.free_b == pytest.approx(float(one.drift_damping[0]), rel=1e-9)
    assert 0.02 < found.present.free_mass < 0.022
    (knob,) = virtual_couplings(scene_of(f"{DEVICE}, motion: rotary", CUP))
    assert knob.present is not None
    assert math.isnan(knob.present.free_mass)


@pytest.mark.parametrize(
    ("scene", "mass", "sentence"),
    [
        (scene_of("mass: 0.2, friction: 1, hold: impulse"), None, "device.hold: found impulse, expected zoh or ramp"),
        (scene_of("mass: 0.2, friction: 0, delay: 1"), None, "device.friction: found 0"),
        (scene_of(f"{DEVICE}, correction: poles"), None, "device.correction: found poles, expected none"),
        (
            scene_of(DEVICE, "  hand_proxy: {type: mass, mass: 1}"),
            None,
            "found hand_proxy, which is the name of the proxy",
        ),
    ],
)
def test_what_has_no_coupling_is_named(scene: Scene, mass: float | None, sentence: str) -> None:
    with pytest.raises(UsageError) as caught:
        virtual_couplings(scene, mass)
    assert sentence in str(caught.value)
