"""The page shows the same as `hapsim check`, for the region of the hand. Nothing runs here."""

from __future__ import annotations

import math
from typing import Any

import pytest

from hapsim import predict
from hapsim.live.messages import Predict
from hapsim.live.predicted import predicted
from hapsim.running.live_parameters import parameters_of
from hapsim.scene import Scene, load_scene, parse_scene

REGIONAL = ("toggle", "button", "fader", "knob_24", "four_keys")
TWO = """
version: 1
rate: 1000
device: {mass: 0.2, friction: [1.0, 0.5], stiffness: [0, 30]}
modules:
  left: {type: device, channel: 0}
  right: {type: device, channel: 1}
  wall: {type: ground, position: 0.0}
  notch: {type: detent, between: [left, wall], shape: snap, pitch: 0.01, depth: 1.0, sharpness: 1.0, damping: 5}
  stop: {type: buffer, between: [right, wall], stiffness: 900, damping: 3}
"""


def found(scene: Scene, **asked: Any) -> dict[str, Any]:
    return predicted(scene, parameters_of(scene, has_mock=False), Predict(type="predict", **asked))


@pytest.mark.thorough(keep=10)
@pytest.mark.parametrize("name", REGIONAL)
@pytest.mark.parametrize("share", [-0.9, -0.31, 0.02, 0.4, 0.77])
def test_the_hand_is_where_it_was_sent(name: str, share: float) -> None:
    scene = load_scene(f"configs/{name}.yaml")
    low, high = scene.device.travels(scene.channels)[0]
    x = share * (min(-low, high) if math.isfinite(high - low) else 0.004)
    hands = found(scene, at=[x] * scene.channels, plane=True)["hands"]
    prediction = predict(scene, with_margins=False, at=x)
    for one, part in zip(hands, prediction.parts, strict=True):
        assert (region := part.region_here) is not None  # by the table of `check`, of a curve its rest
        assert one["region"]["low_m"] <= x <= one["region"]["high_m"]
        assert (one["region"]["low_m"], one["region"]["high_m"]) == (region.piece.low, region.piece.high)
        assert (one["K"], one["B"]) == pytest.approx((region.felt.stiffness, region.felt.damping), rel=1e-9)
        assert (one["k"], one["b"]) == pytest.approx((region.felt.k, region.felt.b), rel=1e-9, nan_ok=True)
        assert one["region"]["kind"] == region.kind


def test_each_hand_is_in_a_region_of_its_own_and_beyond_the_travel_in_the_last_one() -> None:
    scene = parse_scene(TWO)
    left, right = found(scene, at=[0.005, -0.001])["hands"]
    assert (left["region"]["kind"], right["region"]["kind"]) == ("snap", "held")
    left, right = found(scene, at=[0.01, 0.002])["hands"]
    assert (left["region"]["kind"], right["region"]["kind"], right["K"]) == ("held", "held", 0.0)
    toggle = load_scene("configs/fader.yaml")
    (_, most), *_ = toggle.device.travels(1)
    assert found(toggle, at=[most + 0.1])["hands"][0]["region"]["high_m"] == most


def test_without_a_position_it_is_where_check_takes_it_to_be() -> None:
    for name in REGIONAL:
        scene = load_scene(f"configs/{name}.yaml")
        for one, felt in zip(found(scene)["hands"], predict(scene, with_margins=False).felt, strict=True):
            assert (one["K"], one["k"], one["b"]) == pytest.approx((felt.stiffness, felt.k, felt.b), nan_ok=True)


@pytest.mark.parametrize("correction", ["none", "poles", "predictor"])
@pytest.mark.parametrize("stiffness", [0.0, 40.0])
def test_what_is_asked_for_has_what_is_the_devices_own(correction: str, stiffness: float) -> None:
    """The desired values include the device's own stiffness and friction. A correction simulates another K and B."""
    text = f"""
version: 1
rate: 1000
device: {{mass: 0.2, friction: 1.5, stiffness: {stiffness}, correction: {correction}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground, position: 0.0}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 800, damping: 4}}
"""
    (hand,) = found(parse_scene(text))["hands"]
    assert hand["asked"] == pytest.approx((800.0 + stiffness, 5.5))
    assert hand["own"] == pytest.approx((stiffness, 1.5))
    if correction != "none":
        assert (hand["k"], hand["b"]) == pytest.approx(hand["asked"], rel=1e-6)


CELLS = """
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0}
modules:
  hand: {type: device, channel: 0}
  low: {type: cell, mass: 0.05, stiffness: 2000, damping: 1.0, rest: -0.01}
  high: {type: cell, mass: 0.05, stiffness: 2000, damping: 1.0, rest: 0.01}
  floor: {type: buffer, between: [hand, low], stiffness: 500, damping: 1.0}
  pick: {type: plectrum, between: [hand, high], stiffness: 800, release: 0.002}
"""


@pytest.mark.parametrize(
    ("x", "contacts"),
    [
        (0.0, "floor is apart, pick is released; k and b are those while floor is touched and pick is gripping"),
        (-0.012, "floor is touched, pick is released; k and b are those while pick is gripping"),
        (0.011, "floor is apart, pick is gripping; k and b are those while floor is touched"),
    ],
)
def test_of_contacts_that_move_masses_their_state_is_shown_where_the_hand_is(x: float, contacts: str) -> None:
    assert found(parse_scene(CELLS), at=[x])["contacts"] == contacts
    assert found(parse_scene(CELLS))["contacts"].startswith("floor is apart, pick is released; ")  # at 0
    assert found(load_scene("configs/first_touch.yaml"), at=[x])["contacts"] == ""
