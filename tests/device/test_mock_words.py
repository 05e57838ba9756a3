"""The mock's digital words: which sample reads an input, and from which on an output acts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.scene import parse_scene
from tests.thorough import points

New = Callable[..., Any]
SCENE = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2}
inputs: {touch: {bit: 31, inverted: true}, button: {bit: 0}}
outputs: {code: {bits: [8, 15]}}
mock: {MOCK}
modules: {hand: {type: device, channel: 0}}
"""


def host_of(new_host: New, mock: str = "{}") -> Any:
    """A host on a wire to the mock of a scene with words."""
    return type(new_host())(assemble_mock(parse_scene(SCENE.replace("{MOCK}", mock))))


def signed(word: int) -> int:
    return word - (word >> 31 << 32)


@pytest.mark.parametrize("pacing", schema.PACINGS)
def test_every_output_acts_in_the_sample_after_the_one_that_its_force_answers(new_host: New, pacing: int) -> None:
    host, words = host_of(new_host), np.random.default_rng(5).integers(0, 2**32, points(300, 5000)).tolist()
    host.arm(pacing, parts=schema.WITH_WORDS)
    for n, word in enumerate(words):
        (*_, position) = host.force(n, [0, signed(word)], now=n) + (host.sample_passes(now=n) if pacing == 0 else [])
        assert (position.number, int(host.mock.outputs)) == ((n + 1) % schema.SAMPLE_MODULUS, word)
    host.disarm()
    assert int(host.mock.outputs) == 0


def test_inputs_begin_off_and_change_at_their_times(new_host: New) -> None:
    host = host_of(new_host, "{inputs: {touch: [0.002, 4 ms], button: [0.0, 0.004]}}")
    for _ in range(2):  # and from the beginning, when it is armed again
        seen = host.arm(parts=schema.WITH_WORDS | schema.WITH_VELOCITY)[1:]
        seen += [frame for n in range(6) for frame in host.force(n)]
        assert [frame.counts[-1] & 0xFFFFFFFF for frame in seen] == [0x80000001] * 2 + [1] * 2 + [0x80000000] * 3
        host.disarm()


def test_a_word_is_as_late_as_its_force(new_host: New) -> None:
    host = host_of(new_host, "{turnaround: 0.0025}")
    host.arm(parts=schema.WITH_WORDS)
    acts = []
    for n in range(6):
        host.force(n, [0, n + 1])
        acts.append(int(host.mock.outputs))
    assert acts == [0, 0, 1, 2, 3, 4]


def test_a_mock_of_a_scene_without_words_has_none(new_host: New) -> None:
    assert new_host().arm(parts=schema.WITH_WORDS)[-1].fault == schema.WRONG_SENSING
    assert host_of(new_host).register(schema.REG_SENSORS) & schema.HAS_DIGITAL_WORD
