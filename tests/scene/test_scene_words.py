"""Inputs and outputs of a scene: bits of the digital words by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from firmware_protocol import schema
from hapsim.errors import SceneError
from hapsim.prediction.timing import parts_on_wire
from hapsim.scene import parse_scene
from hapsim.scene.mock_limits import MOST_CHANGES, mock_refusal
from tests.word_scenes import WORDS, without_words


def test_names_stand_for_bits() -> None:
    scene = parse_scene(WORDS)
    masks = {name: one.mask for name, one in (*scene.inputs.items(), *scene.outputs.items())}
    assert masks == {"touch": 1, "grip": 1 << 31, "code": 0xFF00, "led": 8, "hit": 4}
    assert [name for name, one in scene.outputs.items() if one.is_set_by_programs] == ["code", "led"]
    assert parts_on_wire(scene) == schema.WITH_WORDS
    assert parts_on_wire(without_words(scene)) == 0


@pytest.mark.parametrize("as_array", [int, lambda word: np.array([word], np.uint32)], ids=["a word", "an array"])
def test_values_are_read_from_words(as_array: Callable[[int], int]) -> None:
    scene = parse_scene(WORDS)
    found = scene.word_values(as_array(1 << 31), as_array(0x1234 | 1 << 31))
    assert {name: int(np.ravel(value)[0]) for name, value in found.items()} == {
        "inputs.touch": 0,
        "inputs.grip": 0,  # inverted
        "outputs.code": 0x12,
        "outputs.led": 0,
        "outputs.hit": 1,
    }
    on = scene.word_values(as_array(1), as_array(0))
    assert on["inputs.touch"] == on["inputs.grip"] == 1


def test_a_scene_goes_through_its_document() -> None:
    scene = parse_scene(WORDS)
    assert parse_scene(scene.to_yaml()) == scene
    assert scene.document["outputs"]["hit"] == {"bit": 2, "when": "wall"}


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("touch: {bit: 0}", "touch: {bit: 31}", "bit: found bit 31, which touch has; expected one that no other"),
        ("touch: {bit: 0}", "touch: {bit: 32}", "bit: found 32, expected a whole number from 0 to 31"),
        ("touch: {bit: 0}", "touch: {}", "touch: 'bit' is missing, expected a whole number from 0 to 31"),
        ("inverted: true", "inverted: 1", "inverted: found 1, expected true or false"),
        ("inputs:\n", "inputs: [touch]\n_:\n", "expected a mapping from names to inputs, such as touch: {bit: 0}"),
        ("[8, 15]", "[15, 8]", "bits: found [15, 8], expected the lower bit first: [8, 15]"),
        ("[8, 15]", "[8, 32]", "expected a list of 2 whole numbers from 0 to 31"),
        ("[8, 15]", "[0, 3]", "bit: found bit 3, which code has; expected one that no other of the outputs has"),
        ("led: {bit: 3}", "led: {bit: 3, bits: [4, 5]}", "bits: found bit and bits, expected one of the two"),
        ("led: {bit: 3}", "led: {}", "led: found no bit, expected bit: a number from 0 to 31, or bits"),
        ("when: wall", "when: wal", "when: found 'wal', expected the name of a module of this scene; did you mean"),
        ("when: wall", "of: wal", "of: found 'wal', expected the name of a module of this scene; did you mean"),
        ("when: wall", "when: wall, of: wall", "of: found when and of, expected one of the two"),
        ("bit: 2, when", "bits: [4, 5], when", "bits: found several bits of an output that is 0 or 1"),
        ("{touch: [0.5", "{tuch: [0.5", "tuch: found no such input, expected the name of one of the scene's inputs"),
        ("{touch: [0.5", "{touch: [-0.5", "touch[0]: found -0.5 s, expected a time from the start on"),
        ("1200 ms]", "400 ms]", "touch[1]: found 400 ms, expected a number > 0.5 s"),
        ("  wall: {", "  outputs: {", "outputs: found a module called outputs in a scene with outputs"),
    ],
)
def test_what_is_wrong_is_reported_with_its_line(old: str, new: str, expected: str) -> None:
    assert WORDS.count(old) == 1
    with pytest.raises(SceneError) as caught:
        parse_scene(WORDS.replace(old, new), "s.yaml")
    assert expected in str(caught.value)
    assert str(caught.value).startswith("s.yaml:")


def test_an_input_that_nothing_uses_is_allowed() -> None:
    assert (
        parse_scene(WORDS.replace("touch: {bit: 0}", "touch: {bit: 0}\n  spare: {bit: 7}")).inputs["spare"].mask == 128
    )


def test_the_mock_takes_a_thousand_changes_of_its_inputs() -> None:
    times = ", ".join(f"{0.1 * i:.1f}" for i in range(MOST_CHANGES))
    full = WORDS.replace("[0.5, 1200 ms]", f"[{times}]")
    assert mock_refusal(parse_scene(full)) == ""
    assert "found 1001 times, expected at most 1000" in mock_refusal(
        parse_scene(full.replace("{touch: [", "{grip: [1], touch: ["))
    )
