"""Scenes that a program changes by path, and their texts."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hapsim
from hapsim.errors import HapsimError, UsageError
from hapsim.running.live_parameters import by_part
from hapsim.scene.shipped import shipped_scenes
from hapsim.scene.varied import Varied
from tests import thorough

FIRST = hapsim.load_scene("first_touch")


def test_changes_are_named_by_path_or_nested_as_in_a_file_and_may_have_units() -> None:
    both = (
        {"touch.stiffness": "2.5 N/mm", "device.delay": 0, "mock.hand.stiffness": 3},
        {"touch": {"stiffness": 2500}, "device": {"delay": 0.0}, "mock": {"hand": {"stiffness": 3}}},
        {"touch": {"stiffness": 2500.0}, "device.delay": 0, "mock.hand": {"stiffness": "3 N/m"}},
    )
    one, *others = (FIRST.changed(changes) for changes in both)
    assert [other.document for other in others] == [one.document] * 2
    assert (one.modules["touch"].stiffness, one.device.delay) == (2500.0, 0.0)  # type: ignore[union-attr]
    assert one.path is None
    assert FIRST.modules["touch"].stiffness == 2000.0  # type: ignore[union-attr]
    assert one.changed({"device.travel": ["-5 mm", "5 mm"]}).device.travel == (-0.005, 0.005)
    assert one.changed({"device.travel": ["-5 mm", "5 mm"]}).changed({"device.travel": None}).device.travel is None
    assert one.changed({}).document == one.document == one.changed({"touch": {}}).document


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"touch.stifness": 1}, "'touch.stifness', expected a parameter of .*; did you mean 'touch.stiffness'"),
        ({"touch": {"stifness": 1}}, "'touch.stifness', expected a parameter"),
        ({"tuch": {}}, "'tuch', expected a parameter"),
        ({"touch": 5}, "'touch', expected a parameter"),
        ({"touch.type": "spring"}, "'touch.type', expected a value: .* so change the file$"),
        ({"touch.stiffness": 1, "touch": {"stiffness": 2}}, "touch.stiffness: found it twice"),
        ({"touch.stiffness": "2 N"}, r"^touch.stiffness: found 2 N, expected a stiffness \(N/m\)"),
        ({"touch.stiffness": -1}, "^touch.stiffness: found -1, expected a number >= 0"),
        ({"touch.stiffness": float("nan")}, "^touch.stiffness: found"),
        ({"touch.stiffness": object()}, "^touch.stiffness: found"),
        ({"device.delay": 1e9}, "^device.delay: found"),
        ({"rate": "1 kHz", "substeps": 0}, "^substeps: found 0"),
        (3, "found 3, expected paths and values"),
    ],
)
def test_what_a_file_could_not_have_is_refused_with_its_path(changes: dict[str, object], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        FIRST.changed(changes)


def _misspelt(path: str, chance: random.Random) -> str:
    at = chance.randrange(len(path))
    return path[:at] + chance.choice(("", path[at] * 2, "q")) + path[at + 1 :]


@settings(deadline=None, max_examples=thorough.points(40, 80))
@given(st.integers(0, 10**6))
def test_no_misspelt_path_and_no_impossible_value_passes(seed: int) -> None:
    chance = random.Random(seed)
    scene = hapsim.load_scene(chance.choice(sorted(shipped_scenes())))
    known = Varied(scene).known
    path = chance.choice(known)
    wrong = _misspelt(path, chance)
    if wrong not in known:
        with pytest.raises(UsageError) as caught:
            scene.changed({wrong: 1.0})
        assert wrong in str(caught.value)
    if path.endswith(".port"):  # any text
        return
    with pytest.raises(HapsimError) as other:
        scene.changed({path: chance.choice((1e300, -1e300, "no such value", "3 bananas", [[[]]], {"a": 1}))})
    assert path.partition(".")[0] in str(other.value) or "found" in str(other.value)


def test_an_unknown_unit_of_a_noise_has_an_example() -> None:
    with pytest.raises(HapsimError, match=r"unknown unit 'V', expected a force \(N rms\), such as 10 mN rms"):
        hapsim.load_scene("admittance").changed({"mock.force_sensor.noise": "3 V"})


def test_the_text_of_a_scene_is_that_scene() -> None:
    for name in shipped_scenes():
        scene = hapsim.load_scene(name)
        text = scene.to_yaml()
        assert hapsim.parse_scene(text).document == scene.document, name


def test_what_python_prints_of_a_scene_and_its_results_is_one_line() -> None:
    prediction = hapsim.predict(FIRST)
    assert repr(FIRST) == str(FIRST) == "<Scene without a file: 3 modules, 1 channel, 1000 Hz>"
    assert repr(prediction).endswith("at 1000 Hz: stable; hand feels 2080.44 N/m, 3.02077 N·s/m>")
    knob = repr(hapsim.predict("knob_24"))
    assert "N·m/rad" in knob


def test_a_copy_with_a_misspelt_key_is_refused() -> None:
    with pytest.raises(UsageError, match=r"found the key 'substep' of Scene, .*; did you mean 'substeps'"):
        FIRST.model_copy(update={"substep": 2})
    with pytest.raises(UsageError, match=r"found the key 'mas' of Device, .*; did you mean 'mass'"):
        FIRST.device.model_copy(update={"mas": 2.0})
    assert FIRST.model_copy(update={"substeps": 2}).substeps == 2


@pytest.mark.parametrize(
    ("changes", "by_parts"),
    [
        ({"touch.stiffness": 5.0, "touch": {"damping": 2.0}}, {"touch": {"stiffness": 5.0, "damping": 2.0}}),
        ({"touch": {"damping": 2.0}, "touch.stiffness": 5.0}, {"touch": {"stiffness": 5.0, "damping": 2.0}}),
        ({"mock.hand.force": 3.0, "mock": {"hand": {"mass": 1.0}}}, {"mock.hand": {"force": 3.0, "mass": 1.0}}),
        ({"touch.stifness": 5.0}, {"touch": {"stifness": 5.0}}),
        ({"tuch": {"stiffness": 5.0}, "no": 4}, {"tuch": {"stiffness": 5.0}, "no": 4}),
    ],
)
def test_live_changes_are_nested_or_named_by_path(changes: dict[str, object], by_parts: dict[str, object]) -> None:
    assert by_part(changes, FIRST) == by_parts


def test_coordinates_of_a_ground_in_the_plane_are_parts_of_their_own() -> None:
    disc = hapsim.load_scene("disc")
    for changes in ({"post.x": {"position": 1.0}}, {"post.x.position": 1.0}, {"post": {"x": {"position": 1.0}}}):
        assert by_part(changes, disc) == {"post.x": {"position": 1.0}}
