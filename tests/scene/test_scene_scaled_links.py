"""Links with a scale between two hands: what a scene may say of them, and the weights of the energies at their ends."""

from __future__ import annotations

import pytest

from hapsim.errors import SceneError
from hapsim.scene import Scene, parse_scene
from hapsim.scene.scaled_links import energy_weights, scale_sentences

SCENE = """version: 1
rate: 1000
device: {mass: 0.2, motion: [linear, rotary, linear]}
modules:
  a: {type: device, channel: 0}
  b: {type: device, channel: 1}
  c: {type: device, channel: 2}
  g: {type: ground}
  ball: {type: mass, mass: 0.1}
  tie: {type: viscoelastic, between: [a, b], stiffness: 2000, damping: 5, gain: {force: 0.2}, ratio: 0.03 m/rad}
"""


def with_links(*links: str) -> Scene:
    return parse_scene(SCENE + "".join(f"  l{i}: {{type: viscoelastic, {one}}}\n" for i, one in enumerate(links)))


def test_a_gain_and_a_ratio_weigh_the_second_end() -> None:
    scene = with_links("between: [c, a], stiffness: 1")
    assert scene.modules["tie"].second_scale == (0.03, 0.03 * 0.2)  # type: ignore[attr-defined]
    assert scene.modules["l0"].second_scale == (1.0, 1.0)  # type: ignore[attr-defined]
    assert [*scene.scaled_links] == ["tie"]
    assert scene.units_at("tie").name("N/m") == "N/m"  # as its first end


def test_the_turned_link_has_the_units_of_its_own_first_end() -> None:
    scene = parse_scene(SCENE.replace("[a, b]", "[b, a]").replace("0.03 m/rad", "30 rad/m"))
    assert scene.units_at("tie").name("N/m") == "N·m/rad"


def test_a_hand_that_feels_a_share_has_a_weight_of_one_over_it() -> None:
    assert energy_weights(with_links()) == {"a": 1.0, "b": pytest.approx(5.0)}
    scene = with_links("between: [c, a], stiffness: 1, gain: {force: 4}", "between: [c, ball], stiffness: 1")
    weights = energy_weights(scene)  # c : a is 1 : 1/4, a : b is 1 : 5
    assert weights == pytest.approx({"c": 4.0, "ball": 4.0, "a": 1.0, "b": 5.0})


def test_without_a_scale_nothing_has_a_weight() -> None:
    scene = parse_scene(SCENE.partition("  tie")[0] + "  l: {type: spring, between: [a, g], stiffness: 1}\n")
    assert energy_weights(scene) == {}
    assert [*scale_sentences(scene)] == []


def test_a_sentence_names_what_a_gain_gives_and_takes() -> None:
    (sentence,) = scale_sentences(with_links())
    assert sentence == (
        "tie: b feels 0.2 of its force. Of each joule that a gives, b gets 0.2 J; of each that b gives, a gets 5 J. "
        "The link takes or gives the rest, and the energy guard counts the energy of b 5 times."
    )
    ratio_alone = parse_scene(SCENE.replace("gain: {force: 0.2}, ", ""))
    assert [*scale_sentences(ratio_alone)] == []
    assert energy_weights(ratio_alone) == {"a": 1.0, "b": 1.0}


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[a, b]", "[a, g]", "10:75: gain: found a gain at 'g', expected a point of type device at both ends"),
        ("[a, b]", "[ball, b]", "found a gain at 'ball', expected a point of type device at both ends"),
        ("gain: {force: 0.2}, ", "damper: centred, ", "damper: found centred with a ratio, expected damper: backward"),
        ("force: 0.2", "force: 0", "force: found 0, expected a number > 0 (1)"),
        ("force: 0.2", "", "gain: 'force' is missing, expected a number > 0 (1)"),
        ("0.03 m/rad", "30 rad/m", "found 30 rad/m, expected a length per angle (m/rad)"),
        ("0.03 m/rad", "-1", "ratio: found -1, expected a number > 0 (m/rad)"),
        ("[a, b]", "[a, c]", "ratio: found a ratio between 'a' and 'c', of one motion; expected a linear and a rotary"),
        (", ratio: 0.03 m/rad", "", "linear and rotary mixed on one link"),
        ("motion: [linear, rotary, linear]", "law: board", "gain: found a gain with device.law: board, expected"),
        ("mass: 0.2", "mode: admittance", "found a gain with device.mode: admittance, expected device.mode"),
        ("motion", "correction: predictor, motion", "found a gain with device.correction: predictor, expected"),
        ("rate: 1000", "rate: 1000\nscheme: exact", "gain: found a gain with scheme: exact, expected scheme: cordis"),
    ],
)
def test_what_does_not_go_with_a_scale_is_refused(old: str, new: str, expected: str) -> None:
    with pytest.raises(SceneError) as caught:
        parse_scene(SCENE.replace(old, new))
    assert expected in str(caught.value)


def test_two_ways_with_other_products_of_gains_are_refused() -> None:
    both = "between: [a, c], stiffness: 1, gain: {force: 2}", "between: [c, b], stiffness: 1, ratio: 1"
    with_links(*both[:1])
    agree = both[0].replace("2", "0.5"), f"{both[1]}, gain: {{force: 0.4}}"
    assert energy_weights(with_links(*agree)) == pytest.approx({"a": 1.0, "b": 5.0, "c": 2.0})
    with pytest.raises(SceneError, match="found a way between its ends with another product of gains than its own"):
        with_links(*both)
