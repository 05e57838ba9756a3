"""Links with a scale between two hands, in theory: as a plain link between other masses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hapsim.prediction import predict
from hapsim.scene import Scene, parse_scene
from hapsim.theory import Network
from hapsim.theory.network.margins import ChangedLink, margins_of
from hapsim.theory.network.rest_poles import motions_at_rest
from hapsim.theory.sample import loop
from tests.networks import network_of


def network(second: Any = None, **changed: Any) -> Network:
    """Two hands on a link, the first also on a spring to the ground."""
    own = {"channel_mass": [0.2, 0.3], "channel_friction": [1.0, 2.0], "delay": 1.3, "sampling": "average"}
    links = {"ends": [[0, 1], [0, -1]], "stiffness": [2000.0, 300.0], "damping": [5.0, 1.0], "second": second}
    return network_of(**own | links | changed)


def poles(of: Network) -> Any:
    return np.sort_complex(np.linalg.eigvals(loop(of).change))


SCALES = [(0.03, 0.2), (1.0, 0.2), (1.0, 6.0), (30.0, 1.0), (0.5, 0.7)]


@pytest.mark.parametrize(("ratio", "gain"), SCALES)
def test_a_scaled_link_has_the_poles_and_margins_of_a_plain_one_on_another_mass(ratio: float, gain: float) -> None:
    """x2' = r x2 and f2 = g r F make m2 x2'' = f2 the motion of the mass m2/(g r²) on the plain link."""
    other = gain * ratio**2
    scaled = network([[ratio, ratio * gain], [1.0, 1.0]])
    plain = network(channel_mass=[0.2, 0.3 / other], channel_friction=[1.0, 2.0 / other])
    found, expected = (poles(one) for one in (scaled, plain))
    kept = np.abs(1.0 + expected) > 1e-3  # of the memories, whose eigenvectors coincide, a half of the digits is right
    np.testing.assert_allclose(found[kept], expected[kept], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        [tuple(one) for one in margins_of(scaled).links], [tuple(one) for one in margins_of(plain).links], rtol=1e-7
    )
    assert motions_at_rest(scaled) == motions_at_rest(plain) == (0, 0)
    free = [replace(one, stiffness=np.array([2000.0, 0.0]), damping=np.array([5.0, 0.0])) for one in (scaled, plain)]
    assert [motions_at_rest(one) for one in free] == [(1, 0), (1, 0)]


def test_the_margins_by_crossings_are_those_of_a_search() -> None:
    scaled = network([[0.03, 0.006], [1.0, 1.0]])
    for link, margin in enumerate(margins_of(scaled).links):
        for quantity, factor in enumerate(margin):
            ((low, high),) = ChangedLink(scaled, link, quantity).ranges_searched(unstable=False)
            assert (low, high) == (1.0, pytest.approx(factor, rel=1e-6))


@pytest.mark.parametrize("second", [[[1.0, 1.0]], [[1.0], [1.0]], [[np.nan, 1.0], [1.0, 1.0]]])
def test_weights_that_do_not_fit_are_refused(second: Any) -> None:
    with pytest.raises(ValueError, match="second"):
        network(second)


ACROSS = """version: 1
rate: 1000
devices:
  left: {mass: 0.2, friction: 1}
  right: {mass: 0.3, friction: 1.5, motion: rotary}
modules:
  a: {type: device, of: left, channel: 0}
  b: {type: device, of: right, channel: 0}
  tie: {type: viscoelastic, between: [a, b], stiffness: 2000, damping: 5, ratio: 0.5 m/rad, gain: {force: 0.2}}
"""


@pytest.mark.parametrize("turned", [False, True])
def test_hands_across_devices_feel_the_plain_tie_of_the_other_masses(turned: bool) -> None:
    """A turned link has K r², B r² and the inverse scales at its new first end."""
    text = ACROSS
    if turned:
        text = text.replace("[a, b]", "[b, a]").replace("stiffness: 2000, damping: 5", "stiffness: 100, damping: 0.25")
        text = text.replace("0.5 m/rad", "2 rad/m").replace("force: 0.2", "force: 5")
    found = predict(parse_scene(text)).parts[0].over_phases
    other = 0.2 * 0.5**2
    plain = ACROSS.replace(", ratio: 0.5 m/rad, gain: {force: 0.2}", "").replace(", motion: rotary", "")
    plain = plain.replace("mass: 0.3, friction: 1.5", f"mass: {0.3 / other}, friction: {1.5 / other}")
    expected = predict(parse_scene(plain)).parts[0].over_phases
    for each, of in ((found.desired_tie, expected.desired_tie), *zip(found.tie, expected.tie, strict=True)):
        np.testing.assert_allclose(each, of, rtol=1e-6)
    assert found.desired_tie.k == pytest.approx(2000.0)


def felt_alone(scene: Scene) -> tuple[float, float]:
    ((k,),), ((b,),) = (getattr(predict(scene).parts[0].felt, name) for name in ("k", "b"))
    return float(k), float(b)


def test_a_hand_feels_its_share_and_lever_of_a_link_to_a_held_hand() -> None:
    scene, other = parse_scene(ACROSS), 0.2 * 0.5**2
    alone = """{version: 1, rate: 1000, device: {mass: %r, friction: %r}, modules: {h: {type: device, channel: 0},
        g: {type: ground}, tie: {type: viscoelastic, between: [h, g], stiffness: %r, damping: %r}}}"""
    right = felt_alone(parse_scene(alone % (0.3, 1.5, 2000 * other, 5 * other)))
    for held in (scene.with_others_held("right"), scene.at_port("right")):
        assert felt_alone(held) == pytest.approx(right, rel=1e-9)
    assert felt_alone(scene.at_port("left")) == pytest.approx(felt_alone(parse_scene(alone % (0.2, 1.0, 2000, 5))))
