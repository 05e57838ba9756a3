"""`hapsim frames`: a capture as people and scripts read it, and a port that is listened to."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import time
import tty
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.description import Description, Servo, to_registers
from firmware_protocol.frames import SETUP, armed_format, frame_to_device, frame_to_host

Hapsim = Callable[..., Any]
WIRE = armed_format(2, schema.MOTION_BITS)


def in_counts(word: int) -> list[int]:
    return np.array([word], np.uint32).astype(np.int32).tolist()


def conversation() -> bytes:
    """Describing, arming with velocities, an exchange, a damaged position, a fault."""
    device = Description(
        "a device", 1000.0, 7, 2047, (1e-6, 2e-6), (0.5, 0.25), (10.0, 10.0), (1e-3, 1e-3), (0.01, 0.02), sensors=1
    )
    registers = to_registers(device).tolist()
    asked = [2, *range(schema.REG_CHANNEL, schema.REG_CHANNEL + 16), *(schema.REG_MORE + n for n in (0, 1, 16, 17))]
    said = b"".join(
        frame_to_device(SETUP, schema.DESCRIBE, n, 0, [0])
        + frame_to_host(SETUP, schema.DESCRIPTION, n, in_counts(registers[n]))
        for n in asked
    )
    arm = frame_to_device(SETUP, schema.ARM, 100, schema.MOTION_BITS, in_counts(schema.SCHEMA_HASH))
    position = frame_to_host(WIRE, schema.POSITION, 0, [100, -100, 7, 0, 300, -5])
    damaged = bytes([position[0], position[1] ^ 4, *position[2:]])
    latched = [schema.LATCHED | schema.HOST_QUIET << 8, 0, 0, 0, 0, 0]
    return (
        said
        + arm
        + frame_to_host(SETUP, schema.STATUS, 0, [schema.ARMED])
        + position
        + frame_to_device(WIRE, schema.FORCE, 0, 20, [4, -4])
        + damaged
        + frame_to_host(WIRE, schema.STATUS, 1, latched)
    )


def in_admittance() -> bytes:
    servo = Servo((1.0, 2.0), (20.0, 20.0), (50.0, 50.0), (1.0, 1.0))
    device = Description("a servo", 1000.0, 1, 2047, (1e-6, 2e-6), (0.5, 0.25), (10.0, 10.0), sensors=18, servo=servo)
    registers = to_registers(replace(device, hand_force_scale=(0.01, 0.02), hand_force_range=(50.0, 50.0))).tolist()
    wire = armed_format(2, schema.ADMITTANCE)
    return (
        b"".join(
            frame_to_host(SETUP, schema.DESCRIPTION, n, in_counts(registers[n]))
            for n in (schema.REG_CHANNELS, 32, 33, 34, 35, 40, 41, 42, 43, *range(164, 176), 180, 181)
        )
        + frame_to_device(SETUP, schema.ARM, 100, schema.ADMITTANCE, in_counts(schema.SCHEMA_HASH))
        + frame_to_host(wire, schema.POSITION, 5, [100, -100, 300, -5])
        + frame_to_device(wire, schema.FORCE, 5, 20, [0, 0, 101, -99])
    )


def test_hand_forces_and_position_commands_are_printed_in_si(hapsim: Hapsim, tmp_path: Path) -> None:
    (path := tmp_path / "servo.bin").write_bytes(in_admittance())
    text = hapsim("frames", path).out
    for part in (
        "hand forces too, position commands too, watchdog",
        "sample 5: 100 counts (0.0001 m), -100 counts (-0.0002 m); 300 counts (3 N), -5 counts (-0.1 N)",
        "answers 5, lives 20 samples: 0 counts (0 N), 0 counts (0 N)",
        "; to 101 counts (0.000101 m), -99 counts (-0.000198 m)",
        "register 171 (braking of channel 0, high word)",
        "register 172 (bandwidth_hz of channel 0)",
    ):
        assert part in text, text
    position, force = hapsim("frames", path, "--json").document["entries"][-2:]
    assert force["command_m"] == pytest.approx([1.01e-4, -1.98e-4])
    assert position["hand_force_N"] == pytest.approx([3.0, -0.1])


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    path = tmp_path / "capture.bin"
    path.write_bytes(conversation())
    return path


def test_a_capture_is_printed_field_by_field_in_si_once_the_device_has_described_itself(
    hapsim: Hapsim, capture: Path
) -> None:
    told = hapsim("frames", capture)
    assert (told.status, told.err) == (0, "")
    for part in (
        "register 2 (channels) = 2",
        "register 43 (force_scale of channel 1, high word) = 1070596096 (0x3fd00000)",
        "paced by device, velocities too, accelerations too, watchdog 100 samples, schema 314a417f (ours)",
        "sample 0: armed",
        "sample 0: 100 counts (0.0001 m), -100 counts (-0.0002 m); 7 counts (0.007 m/s), 0 counts (0 m/s); "
        "300 counts (3 m/s²), -5 counts (-0.1 m/s²)",
        "acceleration_scale of channel 1, high word",
        "answers 0, lives 20 samples: 4 counts (2 N), -4 counts (-1 N)",
        "refused: 32 bytes; the check is wrong: damaged, or of another schema: 02 a4 02 64",
        "sample 1: latched, fault 1: the host was quiet",
        "23 frames from the host, 24 from the device; refused 32 bytes: 1 check.",
    ):
        assert part in told.out
    assert "armed, 2 channels, velocities, accelerations" in told.out


def test_digital_words_are_printed_behind_everything_else(hapsim: Hapsim, tmp_path: Path) -> None:
    wire, path = armed_format(1, schema.WITH_WORDS | schema.WITH_VELOCITY | schema.WITH_LINE), tmp_path / "words.bin"
    path.write_bytes(
        frame_to_device(SETUP, schema.ARM, 100, schema.WITH_WORDS, in_counts(schema.SCHEMA_HASH))
        + frame_to_host(wire, schema.POSITION, 0, [100, 7, *in_counts(0x80000001)])
        + frame_to_device(wire, schema.FORCE, 0, 20, [4, 5, 6, 256])
    )
    arm, position, force = hapsim("frames", path, "--json").document["entries"]
    assert (arm["inputs"], arm["outputs"], arm["lines"]) == (True, True, False)
    assert (position["inputs"], position["velocity_m_s"], force["outputs"]) == (0x80000001, [None], 256)
    assert force["line_counts"] == [[0, 5, 0, 6]]
    told = hapsim("frames", path).out
    for part in (
        "paced by device, inputs too, outputs too, watchdog",
        "armed, 1 channel, velocities, inputs, lines, outputs",
        "sample 0: 100 counts; 7 counts; inputs 0x80000001",
        "4 counts; line k 0, b 5, low 0, high 6 counts; outputs 0x00000100",
    ):
        assert part in " ".join(told.split())


def test_as_json_it_is_one_document(hapsim: Hapsim, capture: Path) -> None:
    document = hapsim("frames", capture, "--json", "--hex").document
    assert document["source"] == str(capture)
    assert document["counters"]["refused"] == {"check": 1, "short": 0, "form": 0, "garbage": 0, "unfinished": 0}
    assert (document["counters"]["from_host"], document["counters"]["from_device"]) == (23, 24)
    position, force, refused, status = document["entries"][-4:]
    assert (position["from"], position["type"], position["number"]) == ("device", "POSITION", 0)
    assert position["position_m"] == pytest.approx([1e-4, -2e-4])
    assert position["velocity_m_s"] == pytest.approx([7e-3, 0.0])
    assert position["acceleration_m_s2"] == pytest.approx([3.0, -0.1])
    assert (force["force_N"], force["time_to_live_samples"]) == ([2.0, -1.0], 20)
    assert (refused["refused"], refused["bytes"]) == ("check", 32)
    assert (status["state"], status["fault"]) == ("latched", schema.HOST_QUIET)
    whole = conversation()
    for entry in (position, force, status):
        data = bytes.fromhex(entry["hex"])
        assert whole[entry["offset"] :][: len(data)] == data
    alone = hapsim("frames", capture, "--json", "--from", "device").document
    assert (alone["counters"]["from_host"], alone["counters"]["from_device"]) == (0, 24)


def test_what_cannot_be_decoded_is_a_sentence(hapsim: Hapsim, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.touch()
    other = tmp_path / "other.zip"
    with zipfile.ZipFile(other, "w") as file:
        file.writestr("sample.npy", bytes(300))
    cut = tmp_path / "cut.zip"
    cut.write_bytes(other.read_bytes()[:-30])
    for words, sentence in (
        ((cut,), "a zip file that was cut short, or damaged at its end: get a whole copy"),
        ((other,), "found a zip file without frames_from_device.bin, expected a report file of hapsim"),
        ((empty,), "found no bytes: the capture is empty"),
        ((empty, "--json"), "found no bytes: the capture is empty"),
        ((tmp_path,), "found a directory, expected a capture"),
        ((tmp_path / "none",), "neither a file nor a port"),
        ((empty, "--from", "me"), "--from: found 'me', expected host, device or both"),
    ):
        assert sentence in hapsim("frames", *words).refusal


def test_what_is_no_capture_is_refused_whole(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_text("nothing of this is a frame\n")
    told = hapsim("frames", path)
    assert told.status == 0
    assert "0 frames from the host, 0 from the device; refused 27 bytes: 1 unfinished. Nothing in it is a" in told.out
    assert told.out.endswith("a frame: is it raw bytes of the wire?\n")


def test_a_capture_of_one_side_has_no_frame_of_the_others(hapsim: Hapsim, tmp_path: Path) -> None:
    path = tmp_path / "host"
    path.write_bytes(frame_to_device(SETUP, schema.DESCRIBE, 2, 0, [0]))
    assert "raw bytes" not in hapsim("frames", path).out
    told = hapsim("frames", path, "--from", "device").out
    assert "Nothing in it is a frame of the device: is it raw bytes of the wire?" in told


@pytest.mark.parametrize("full", [True, False])
def test_an_output_that_cannot_be_written_is_not_the_captures_fault(
    hapsim: Hapsim, capture: Path, monkeypatch: pytest.MonkeyPatch, full: bool
) -> None:
    capture.write_bytes(conversation() * 50)  # more than is kept back before it is written
    near, far = os.pipe()
    os.close(near)
    output = os.open("/dev/full", os.O_WRONLY) if full else os.dup(far)
    os.close(far)
    with io.TextIOWrapper(io.FileIO(output, "w"), write_through=True) as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        answer = hapsim("frames", capture)
    told = "hapsim: the output cannot be written: No space left on device\n"
    assert (answer.status, answer.err) == ((2, told) if full else (0, ""))


def test_standard_input_may_be_a_pipe(hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch) -> None:
    near, far = os.pipe()
    os.write(far, conversation())
    os.close(far)
    with os.fdopen(near, "rb") as stream:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(stream))
        assert "23 frames from the host" in hapsim("frames", "-").out


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """A port: the descriptor of its far end, and its path."""
    near, far = os.openpty()
    for end in (near, far):
        tty.setraw(end)
    os.set_blocking(near, False)
    yield near, os.ttyname(far)
    for end in (near, far):
        os.close(end)


def test_a_port_is_listened_to_until_an_interrupt_and_nothing_is_sent(
    hapsim: Hapsim, terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapsim.cli import frames_command

    near, path = terminal
    received = threading.Event()
    monkeypatch.setattr(frames_command, "text_of", lambda entry: received.set() or str(entry["time_s"]))

    def play() -> None:
        while not received.is_set():  # what comes before the port is open is thrown away
            os.write(near, frame_to_host(SETUP, schema.STATUS, 0, [0]))
            time.sleep(0.02)
        signal.raise_signal(signal.SIGINT)

    player = threading.Thread(target=play)
    player.start()
    told = hapsim("frames", path)
    player.join()
    assert told.status == 0
    assert "0 frames from the host, " in told.out
    assert float(told.out.split()[0]) >= 0.0  # when it came
    with pytest.raises(BlockingIOError):
        os.read(near, 1)
