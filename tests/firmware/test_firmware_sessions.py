"""Sessions of sessions.json: told by hand from PROTOCOL.md, played by the C firmware and by the mock alike."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, frame_to_device
from firmware_protocol.make_vectors import DOCUMENT, SESSIONS, made_text
from firmware_protocol.vectors import DEVICES, STATES, sessions

TOLD = sessions()["sessions"]
NAMES = [f"{at}-{entry['section']}-{entry['device']}" for at, entry in enumerate(TOLD)]


def lines_of(step: dict[str, Any]) -> list[str]:
    """A step as lines for the harness."""
    if "bytes" in step:
        return [f"bytes {step['bytes']}"]
    if "tick" in step:
        return ["tick"] * step["tick"]
    if "pass" in step:
        return [f"pass {step['pass']}"]
    if "finds" in step:
        return [f"fault {step['finds']}"]
    if "room" in step:
        return [f"room {step['room']}"]
    if "inputs" in step:
        return [f"inputs {_words(step['inputs'])}"]
    measured = dict.fromkeys(("acceleration", "hand_force"), [0] * len(step["position"])) | step
    return [f"{name} {_words(measured[name])}" for name in ("position", "velocity", "acceleration", "hand_force")]


def _words(counts: list[int]) -> str:
    return " ".join(str(count) for count in counts)


def test_the_file_is_what_the_sessions_are_now() -> None:
    assert SESSIONS.read_text("utf-8") == made_text(SESSIONS), "run python -m firmware_protocol.make_vectors"


def test_every_session_quotes_its_section() -> None:
    document = DOCUMENT.read_text("utf-8")
    sections = dict(re.findall(r"^## (\d+)\. (.*?)(?=^## |\Z)", document, re.MULTILINE | re.DOTALL))
    sections = {number: " ".join(text.replace("|", " ").split()) for number, text in sections.items()}
    for entry in TOLD:
        quote = " ".join(entry["says"].replace("|", " ").split())
        assert quote in sections[entry["section"]], f"section {entry['section']} does not say: {entry['says']}"


def played(entry: dict[str, Any], run: Callable[[list[str]], list[str]]) -> None:
    lines, wanted = [], []
    for step in entry["steps"]:
        done = lines_of(step)
        registers = step.get("registers", {})
        lines += done + [f"register {number}" for number in registers]
        wanted.append((len(done), step, registers))
    answers = iter(run(lines))
    for at, (count, step, registers) in enumerate(wanted):
        said = ""
        for _ in range(count):
            state, _, out, *put_out = next(answers).split()
            said += out.replace("-", "")
        outputs = [step["outputs"]] if "outputs" in step else []
        commands = (step["command"] or ["none"] * len(step["force"])) if "command" in step else []
        outcome = (STATES[int(state)], said, put_out)
        expected = [str(word) for word in (*step["force"], *outputs, *commands)]
        assert outcome == (step["state"], step["out"], expected), f"step {at}: {step}"
        assert {number: int(next(answers)) for number in registers} == registers, f"step {at}: {step}"


@pytest.mark.parametrize("entry", TOLD, ids=NAMES)
def test_the_firmware_does_as_in_the_session(entry: dict[str, Any], harness: Callable[..., Any]) -> None:
    played(entry, harness({"name": entry["device"]} | DEVICES[entry["device"]]))


def asks_for_parts(entry: dict[str, Any]) -> bool:
    return any(any(step.get("velocity", ())) or "acceleration" in step for step in entry["steps"])


@pytest.mark.parametrize("entry", TOLD, ids=NAMES)
def test_a_knob_of_simplefoc_does_as_in_the_session(entry: dict[str, Any], knob: Callable[..., Any]) -> None:
    """A knob follows the session from its port to its motor, with a sketch's order of loop() and timer."""
    if entry["device"] != "plain" or asks_for_parts(entry):
        pytest.skip("a knob has one channel, senses only the position, and holds its torque")
    played(entry, knob())


@pytest.mark.parametrize("entry", TOLD, ids=NAMES)
def test_an_arduino_sketch_does_as_in_the_session(entry: dict[str, Any], sketch: Callable[..., Any]) -> None:
    """The clock makes the ticks, in loop()."""
    if entry["device"] != "plain" or asks_for_parts(entry) or any("finds" in step for step in entry["steps"]):
        pytest.skip(
            "the sketch has one channel, senses only the position, and holds its force; its sensor's faults are its own"
        )
    played(entry, sketch(in_sessions=True, PWM_TOP=1))


def test_the_hardware_watchdog_is_fed_by_the_tick_and_by_nothing_else(harness: Callable[..., Any]) -> None:
    device = {"name": "plain"} | DEVICES["plain"]
    for entry in TOLD:
        if entry["device"] == "plain":
            lines = [line for step in entry["steps"] for line in lines_of(step)]
            fed = [int(answer.split()[1]) for answer in harness(device)(lines)]
            ticks = [line == "tick" for line in lines]
            assert fed == [sum(ticks[: at + 1]) for at in range(len(lines))], entry["says"]


def test_what_a_receiver_lost_joins_no_two_pieces_to_a_frame(harness: Callable[..., Any]) -> None:
    question = frame_to_device(SETUP, schema.DESCRIBE, schema.REG_CHANNELS, 0, [0]).hex()
    run = harness({"name": "plain"} | DEVICES["plain"])
    halves = [f"bytes {question[:12]}", f"bytes {question[12:]}"]
    said = [answer.split()[2] for answer in run([*halves, halves[0], "lost", halves[1], f"bytes {question}"])]
    assert said[1] != "-"  # in two pieces, nothing lost between them
    assert said[2:5] == ["-", "-", "-"]
    assert said[5] == said[1]


@pytest.mark.parametrize("entry", TOLD, ids=NAMES)
def test_the_mock_does_as_in_the_session(entry: dict[str, Any], mock_player: Callable[..., Any]) -> None:
    if any(step.get("finds") == schema.HARDWARE for step in entry["steps"]):
        pytest.skip("the mock has no hardware that could fail")
    if entry["device"] == "servo" and any(
        step["state"] == "latched" or "acceleration" in step for step in entry["steps"]
    ):
        pytest.skip("the mock's servo stands still once it is released, and senses no motion but the position")
    player = mock_player(DEVICES[entry["device"]])
    for at, step in enumerate(entry["steps"]):
        said = player.play(step)
        outcome = (player.state, said.hex(), player.force, player.outputs, player.command)
        expected = (step["state"], step["out"], step["force"], step.get("outputs", 0), step.get("command"))
        assert outcome == expected, f"step {at}: {step}"
        registers = step.get("registers", {})
        assert {number: player.register(int(number)) for number in registers} == registers, f"step {at}: {step}"
