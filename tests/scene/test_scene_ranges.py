"""Ranges of live values: where a file may have them, what they become, and where they stay."""

from __future__ import annotations

import io
import json

import pytest
import yaml

from hapsim.errors import SceneError, UsageError
from hapsim.prediction import predict
from hapsim.prediction.warnings import warnings_about
from hapsim.running.changed_scene import changed
from hapsim.running.live_parameters import Parameter, parameters_of
from hapsim.scene import Scene, parse_scene, scene_schema
from hapsim.scene.load import read_scene, recorded_scene
from hapsim.scene.modules import MODULE_TYPES
from hapsim.sweeping.sweep_points import Varied

SCENE = """\
version: 1
rate: 1000
device: {{mass: 0.2, friction: 1.0}}
mock: {{hand: {{force: {force}}}}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground, position: 0}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {stiffness}, damping: 5}}
sound:
  left:  {{from: hand, of: force, gain: {gain}}}
"""
RANGED = "{value: 2 N/mm, range: [0, 5 N/mm]}"


def scene_with(stiffness: object = 2000, force: object = 0, gain: object = 1) -> Scene:
    return parse_scene(SCENE.format(stiffness=stiffness, force=force, gain=gain), "a.yaml")


def parameter(scene: Scene, name: str) -> Parameter:
    return parameters_of(scene, has_mock=True)[name]


def test_a_range_is_that_of_the_slider_and_the_value_is_what_it_is_without() -> None:
    scene = scene_with(RANGED, "{value: 1 N, range: [-2 N, 2]}", "{value: 1, range: [0.01, 10]}")
    plain = scene_with("2 N/mm", "1 N", 1)
    assert scene.model_dump() == plain.model_dump()
    assert parameter(scene, "touch.stiffness").span == (0.0, 5000.0)
    assert not parameter(scene, "touch.stiffness").is_logarithmic, "from 0 on no slider can be"
    assert parameter(scene, "left.gain").is_logarithmic, "over three decades"
    assert parameter(scene, "mock.hand.force").range == (-2.0, 2.0)
    assert parameter(scene, "touch.damping").range is None
    assert [one[:2] for one in scene.written] == [("N/m", "N/mm"), ("N·s/m", "N·s/mm")]


def test_a_position_in_the_plane_has_one_range_for_both_coordinates() -> None:
    text = """\
version: 1
rate: 1000
space: 2
device: {mass: 0.2}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground, position: {value: [0, 1 cm], range: [-2 cm, 2 cm]}}
  tie: {type: spring, between: [hand, post], stiffness: 100}
"""
    scene = parse_scene(text)
    assert [parameter(scene, f"post.{axis}.position").range for axis in "xy"] == [(-0.02, 0.02)] * 2


def test_each_live_value_of_each_type_takes_a_range_in_the_schema_and_no_other_does() -> None:
    schema = scene_schema()["$defs"]
    for model in MODULE_TYPES.values():
        fields = schema[model.__name__]["properties"]
        assert {key for key, one in fields.items() if "'range'" in str(one)} == {*model.live}, model


def test_a_range_outlives_changes_documents_records_and_sweeps() -> None:
    scene = scene_with(RANGED, "{value: 1, range: [-2, 2]}")
    beyond = changed(scene, {"touch": {"stiffness": 8000.0}})  # a value may leave it
    assert beyond.ranges == scene.ranges
    document = beyond.ranged_document
    assert document["modules"]["touch"]["stiffness"] == {"value": 8000.0, "range": [0.0, 5000.0]}
    again = [recorded_scene(json.loads(json.dumps(document)), "record", scene.written)]
    again += [read_scene(io.BytesIO(yaml.safe_dump(document).encode()), "text")]
    assert all((one.model_dump(), one.ranges) == (beyond.model_dump(), scene.ranges) for one in again)
    assert Varied(scene).scene({"touch.stiffness": 9000.0}).ranges == scene.ranges
    assert not scene_with().ranges


def test_anchors_and_merges_bring_a_range_to_each_place() -> None:
    text = SCENE.format(stiffness=f"&k {RANGED}", force=0, gain=1).replace(
        "sound:", "  other: {type: spring, between: [hand, wall], stiffness: *k}\nsound:"
    )
    assert len(parse_scene(text).ranges) == 2
    text = SCENE.format(stiffness=RANGED, force=0, gain=1).replace("touch: {", "touch: &t {")
    assert len(parse_scene(text.replace("sound:", "  twice: *t\nsound:")).ranges) == 2
    assert len(parse_scene(text.replace("sound:", "  more: {<<: *t, damping: 2}\nsound:")).ranges) == 2


@pytest.mark.parametrize(
    ("written", "place", "why"),
    [
        ("{value: 2, range: [5, 0]}", "8:83", "range: found 5 before 0, expected the least before the most; swap them"),
        ("{value: 2, range: [1, 1.0]}", "8:83", "expected two different ends"),
        ("{value: 2, range: [0]}", "8:83", "range: found a list of 1, expected [the least, the most], two numbers"),
        ("{value: 2, range: 5}", "8:83", "range: found 5, expected [the least, the most]"),
        ("{value: 2, range: [0, 5 mm]}", "8:87", "range[1]: found 5 mm, expected a stiffness (N/m), such as"),
        ("{value: 2, range: [0, 5 mN·m/deg]}", "8:87", "found 5 mN·m/deg, expected a stiffness (N/m), such as"),
        ("{value: 2, range: [-1, 5]}", "8:84", "range[0]: found -1, expected a number >= 0 (N/m)"),
        ("{value: 2, range: [0, much]}", "8:87", "range[1]: found 'much' (text), expected a number >= 0 (N/m)"),
        ("{value: -2, range: [0, 5]}", "8:73", "stiffness: found -2, expected a number >= 0 (N/m)"),
        ("{value: 2 mm, range: [0, 5]}", "8:73", "stiffness: found 2 mm, expected a stiffness (N/m)"),
        ("{value: , range: [0, 5]}", "8:72", "stiffness: found nothing, expected a number >= 0 (N/m)"),
        ("{value: 2}", "8:73", "stiffness: 'range' is missing, expected {value: a number, range: "),
        ("{range: [0, 5]}", "8:65", "stiffness: 'value' is missing, expected {value: a number, range: "),
        ("{value: 2, rnage: [0, 5]}", "8:76", "rnage: unknown key, expected value or range; did you mean 'range'?"),
    ],
)
def test_each_fault_of_a_range_is_reported_once_where_it_stands(written: str, place: str, why: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with(written)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"a.yaml:{place}: ")
    assert why in line


def test_a_range_of_a_fixed_value_is_an_error_among_others() -> None:
    text = SCENE.format(stiffness="{value: 2, range: [5, 0]}", force=0, gain=1).replace(
        "sound:", "  bob: {type: mass, mass: {value: 1, range: [0, 2]}}\n  cord: {type: sprng}\nsound:"
    )
    with pytest.raises(SceneError) as caught:
        parse_scene(text, "a.yaml")
    lines = str(caught.value).splitlines()
    assert [line.split(": ", 2)[0] for line in lines] == ["a.yaml:8:83", "a.yaml:9:35", "a.yaml:10:16"]
    assert "mass: found a range, expected the value alone: of a mass nothing can change while" in lines[1]
    for device in ("{mass: {value: 0.2, range: [0, 1]}}", "{mass: 0.2, friction: {value: 1, range: [0, 2]}}"):
        with pytest.raises(SceneError, match="found a mapping, expected a number"):
            parse_scene(SCENE.format(stiffness=1, force=0, gain=1).replace("{mass: 0.2, friction: 1.0}", device))


def test_a_value_outside_its_range_runs_and_is_warned_of() -> None:
    for stiffness, force, outside in ((RANGED, 0, ""), ("{value: 2 N/mm, range: [0, 1 N/mm]}", 0, "stiffness: found 2"),
                                      (2000, "{value: 3, range: [0, 1]}", "mock.hand.force: found 3 N,")):  # fmt: skip
        scene = scene_with(stiffness, force)
        found = [one for one in warnings_about(scene, predict(scene)) if "range" in one]
        assert [outside in one for one in found] == ([True] if outside else [])
    with pytest.raises(UsageError, match="expected a number >= 0"):
        changed(scene_with(RANGED), {"touch": {"stiffness": -1.0}})
