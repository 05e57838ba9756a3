"""Scenes of several devices: what is predicted together, what alone, and what depends on the phase of the clocks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim import predict
from hapsim.errors import UsageError
from hapsim.prediction import surely_shaken_by
from hapsim.prediction.predict_ports import PortsPrediction, sections_of
from hapsim.scene import Scene, parse_scene
from hapsim.theory.network.phases import moving_ports
from tests.port_scenes import two_devices

THREE = """
version: 1
rate: 1000
devices:
  left: {mass: [0.2, 0.1], friction: [1, 1], delay: 1.5}
  right: {mass: 0.3, friction: 2, sampling: average}
  third: {mass: 0.3, friction: 2}
leader: right
modules:
  a: {type: device, of: left, channel: 0}
  w: {type: device, of: left, channel: 1}
  b: {type: device, of: right, channel: 0}
  c: {type: device, of: third, channel: 0}
  g: {type: ground}
  m: {type: mass, mass: 0.05}
  n: {type: mass, mass: 0.1}
  wall: {type: viscoelastic, between: [w, g], stiffness: 500, damping: 2}
  own: {type: viscoelastic, between: [c, g], stiffness: 700, damping: 2}
  spring: {type: viscoelastic, between: [a, m], stiffness: 1000, damping: 3}
  other: {type: viscoelastic, between: [m, b], stiffness: 1000, damping: 3}
  alone: {type: viscoelastic, between: [n, g], stiffness: 100, damping: 1}
"""


def prediction_of(scene: Scene, **options: Any) -> PortsPrediction:
    found = predict(scene, **options)
    assert isinstance(found, PortsPrediction)
    return found


def changed(name: str, **values: object) -> Scene:
    return two_devices().changed({f"{name}.{key}": value for key, value in values.items()})


class TestSections:
    def test_links_join_devices_directly_and_over_masses(self) -> None:
        assert sections_of(parse_scene(THREE)) == {
            ("left",): {"w", "wall"},
            ("third",): {"c", "own"},
            ("left", "right"): {"a", "b", "m", "n", "spring", "other", "alone"},
        }

    def test_hands_that_nothing_ties_feel_what_their_device_alone_predicts(self) -> None:
        whole = prediction_of(parse_scene(THREE), with_margins=False)
        for name, port in (("w", "left"), ("c", "third")):
            alone = predict(parse_scene(THREE).with_others_held(port), with_margins=False)
            here, there = (next(one for one in every.felt if one.name == name) for every in (whole, alone))
            assert (here.k, here.b) == pytest.approx((there.k, there.b), rel=1e-12)

    def test_what_belongs_to_one_section_is_asked_of_it(self) -> None:
        whole = prediction_of(parse_scene(THREE), with_margins=False)
        with pytest.raises(UsageError, match="by `sections`: left, third, left and right"):
            _ = whole.poles
        assert whole.sections["third",].poles


class TestOverPhases:
    def test_two_hands_on_one_spring(self) -> None:
        whole = prediction_of(two_devices(), with_margins=False)
        found = whole.parts[0].over_phases
        assert found is not None
        assert found.tie is not None
        assert [one.k for one in found.tie] == pytest.approx([2177.511, 2180.764], abs=5e-4)
        assert [one.b for one in found.tie] == pytest.approx([2.50485, 2.50494], abs=5e-6)
        assert [one.together_per_s for one in found.tie] == pytest.approx([-4.9814, -4.9751], abs=5e-5)
        assert found.desired_tie == pytest.approx((2000.0, 5.5, -5.0), rel=1e-9)
        assert whole.stable

    def test_on_the_hosts_clock_they_are_one_device(self) -> None:
        hosts = {name: {"mass": 0.2, "friction": 1.0, "clock": "host"} for name in ("left", "right")}
        (part,) = prediction_of(two_devices(devices=hosts), with_margins=False).parts
        found = part.over_phases
        assert found is not None
        assert found.tie is not None
        for one in found.tie:
            assert (one.k, one.b) == pytest.approx((2167.891401723, 2.492382018), abs=5e-9)

    def test_each_device_keeps_its_own_delay_hold_and_sampling(self) -> None:
        (*_, across) = prediction_of(parse_scene(THREE), with_margins=False).every
        clocks = across.network.clocks
        assert clocks is not None
        assert [(one.delay, one.sampling) for one in clocks.interfaces] == [(1.5, "ideal"), (1.0, "average")]
        assert clocks.port == (0, 1, 1, 1)  # a and b; the leader moves both masses

    def test_a_longer_delay_of_one_device_costs_half_of_what_it_costs_of_both(self) -> None:
        def b(**delays: float) -> float:
            scene = two_devices().changed({f"{port}.delay": delay for port, delay in delays.items()})
            found = prediction_of(scene, with_margins=False).parts[0].over_phases
            assert found is not None
            assert found.tie is not None
            return found.tie[0].b

        none, one, both = b(), b(left=1.5), b(left=1.5, right=1.5)
        assert none - one == pytest.approx(0.5 * (none - both), rel=0.02)

    def test_a_part_without_a_pair_has_the_reason(self) -> None:
        found = prediction_of(parse_scene(THREE), with_margins=False).parts[-1].over_phases
        assert found is not None
        assert found.tie is None
        assert found.reason
        assert np.isnan(found.k[0]).all()


class TestStability:
    def test_the_verdict_is_that_of_the_worst_phase(self) -> None:
        for stiffness, is_stable in ((3440.0, True), (3445.0, False)):
            scene = changed("spring", stiffness=stiffness)
            whole = prediction_of(scene, with_margins=False)
            assert whole.stable is is_stable
            assert (surely_shaken_by(scene) is None) is is_stable
            assert (whole.verdict == "stable") is is_stable

    def test_contacts_across_devices_are_judged_in_each_state(self) -> None:
        for stiffness, is_stable in ((1000.0, True), (5000.0, False)):
            contact = {"type": "buffer", "between": ["a", "b"], "stiffness": stiffness}
            whole = prediction_of(two_devices(modules=two_devices().document["modules"] | {"contact": contact}))
            assert whole.every[0].states.count == 2
            assert whole.stable is is_stable

    def test_hands_of_one_port_in_a_state_have_its_clock_alone(self) -> None:
        document = two_devices().document["modules"]
        document["spring"] = {"type": "buffer", "between": ["a", "b"], "stiffness": 2000.0, "damping": 5.0}
        document |= {"g": {"type": "ground"}, "wall": {"type": "spring", "between": ["a", "g"], "stiffness": 100.0}}
        whole = prediction_of(two_devices(modules=document), with_margins=False)
        assert whole.every[0].states.count == 2
        assert whole.every[0].states.unjudged == 0

    def test_a_motion_that_surely_grows_is_found(self) -> None:
        scene = parse_scene(f"{THREE}  hold: {{type: viscoelastic, between: [m, g], stiffness: 100, damping: 1}}")
        assert surely_shaken_by(scene) is None
        assert surely_shaken_by(scene.changed({"spring.stiffness": 1e5})) is not None

    def test_at_a_port_the_others_are_held_still(self) -> None:
        found = predict(two_devices().at_port("left"), with_margins=False)
        assert (found.k, found.b) == pytest.approx((2080.439463958, 3.020774022), abs=5e-9)

    def test_too_many_masses_are_refused_in_words(self) -> None:
        modules = two_devices().document["modules"] | {
            "string": {"type": "string", "masses": 250, "mass": 0.1, "stiffness": 1000.0, "damping": 0.1},
            "bow": {"type": "spring", "between": ["b", "string.3"], "stiffness": 10.0},
        }
        with pytest.raises(UsageError, match="tie across left and right: too many to predict"):
            predict(two_devices(modules=modules))


def test_three_devices_on_one_part_have_a_grid_of_phases() -> None:
    text = THREE.replace("between: [c, g], stiffness: 700", "between: [c, m], stiffness: 700")
    (*_, across) = prediction_of(parse_scene(text), with_margins=False).every
    assert moving_ports(across.network) == [1, 2]
    assert across.stable
