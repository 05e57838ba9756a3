"""`hapsim measure --methods`: the paragraph has the measured values, and what it cannot know it leaves out."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import hapsim
from hapsim.cli.methods import paragraph, rows
from hapsim.scene import parse_scene

Hapsim = Callable[..., Any]

SCENE = """
version: 1
rate: 2 kHz
device: {clock: lockstep, mass: 200 g, friction: 1, delay: 1, correction: poles}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2 N/mm, damping: 5}
"""


def test_a_paragraph_states_how_the_hand_felt_what_was_measured(hapsim: Hapsim, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(SCENE, encoding="utf-8")
    answer = hapsim("measure", tmp_path / "a.yaml", "--methods", "--json")
    text, measured = answer.document["methods"], answer.document["measured"]
    k, unsure = (float(one) for one in re.search(r"felt k = ([\d.]+) ± (\S+) N/mm", text).groups())  # type: ignore[union-attr]
    assert abs(1e3 * k - measured["k"]) <= 1e3 * unsure
    assert 1e3 * unsure == pytest.approx(measured["k_uncertainty"], rel=0.5)
    for words in (
        "simulated device, which no person held. It sampled positions at 2000 Hz, in virtual time",
        "1 sample period after its position (each force acts, constant, until the next one)",
        "asked for k = 2 N/mm, b = 0.006 N·s/mm, the device's own spring and friction included, with the correction",
        "the correction 'poles'.",
        "for a mass of 200 g. Predicted without that run [1]: k = 2 N/mm",
        f"In that run 0 of {answer.document['ticks']} forces were late.",
    ):
        assert words in text, words
    printed = hapsim("measure", tmp_path / "a.yaml", "--methods").words
    assert "It sampled positions at 2000 Hz" in printed
    assert "poles" in printed
    assert "Florens" in printed


def test_a_motion_of_no_pair_and_a_device_on_a_port_are_stated_as_such() -> None:
    scene = parse_scene(SCENE)
    measurement, prediction = hapsim.measure(scene), hapsim.predict(scene)
    unlike = replace(measurement, dominant=False)
    assert "No single spring and damper describes what the hand 'hand' felt." in paragraph(prediction, unlike, 0)
    report = replace(measurement.trace.report, virtual_time=False, deadline_misses=3)
    slow = replace(measurement, trace=replace(measurement.trace, report=report))
    on_port = hapsim.predict(parse_scene(SCENE.replace("clock: lockstep", "clock: host, port: /dev/ttyACM0")))
    assert "on a device. It sampled positions at 2000 Hz, paced by the host" in paragraph(on_port, slow, 0)
    assert f"In that run 3 of {report.ticks} forces were late." in paragraph(on_port, slow, 0)
    assert dict(rows(on_port, slow, 0))["device"] == "/dev/ttyACM0"
