"""Sound files: whole to the bit, playable however their writer ended, and what a full disk leaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.sound import wav
from hapsim.sound.wav import WavFile, in_24_bits

RATE = 48000


def read(path: Path) -> tuple[wave._wave_params, NDArray[np.float64]]:
    """The header and the frames, by Python's own reader."""
    with wave.open(str(path), "rb") as file:
        parameters, data = file.getparams(), file.readframes(file.getnframes())
    values = np.zeros((len(data) // 3, 4), np.uint8)
    values[:, 1:] = np.frombuffer(data, np.uint8).reshape(-1, 3)
    return parameters, values.view("<i4")[:, 0].reshape(-1, parameters.nchannels) / 2.0**31


def noise(frames: int, channels: int) -> NDArray[np.float32]:
    return np.random.default_rng(frames).uniform(-1.0, 1.0, (frames, channels)).astype(np.float32)


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("frames", [0, 1, 3, 100_000])
def test_a_file_has_every_frame(tmp_path: Path, channels: int, frames: int) -> None:
    sound, path = noise(frames, channels), tmp_path / "sound.wav"
    file = WavFile(path, channels, RATE, pytest.fail)
    for part in np.array_split(sound, 7):
        file.put(part)
    file.finish()
    parameters, values = read(path)
    assert (parameters.nchannels, parameters.sampwidth, parameters.framerate) == (channels, 3, RATE)
    assert np.abs(values - sound).max(initial=0.0) <= 0.5 / 2**23 * 1.001 + (np.abs(sound) == 1.0).any() / 2**23
    assert values.shape == sound.shape
    assert int.from_bytes(path.read_bytes()[4:8], "little") == path.stat().st_size - 8
    assert (file.problem, file.unwritten) == ("", 0)


def test_full_scale_does_not_wrap_round() -> None:
    counts = np.frombuffer(in_24_bits(np.float32([[1.0, -1.0, 1.5, -1.5]])), np.uint8).reshape(-1, 3)
    assert counts.tolist() == [[255, 255, 127], [0, 0, 128], [255, 255, 127], [0, 0, 128]]


def test_more_than_two_channels_take_the_extensible_form(tmp_path: Path) -> None:
    path, sound = tmp_path / "sound.wav", noise(10, 5)
    file = WavFile(path, 5, RATE, pytest.fail)
    file.put(sound)
    file.finish()
    text = path.read_bytes()
    assert text[20:22] == b"\xfe\xff"
    assert int.from_bytes(text[16:20], "little") == 40
    assert text[60:64] == b"data"
    assert text[68:] == in_24_bits(sound)
    if sys.version_info >= (3, 12):  # since then it reads these
        assert read(path)[0].nchannels == 5


WRITER = """
import sys, time, numpy as np
from pathlib import Path
from hapsim.sound.wav import WavFile
file = WavFile(Path(sys.argv[1]), 1, 48000, print)
n = 0
while True:
    file.put(np.arange(n, n + 480, dtype=np.float32)[:, None] / 2**23)
    n += 480
    time.sleep(1e-3)
    if file.written > 48000:
        print("written", flush=True)
"""


def test_after_kill_9_the_file_can_be_played(tmp_path: Path) -> None:
    path = tmp_path / "sound.wav"
    with subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"written\n"
        os.kill(process.pid, signal.SIGKILL)
    values = read(path)[1][:, 0] * 2**23
    assert len(values) > 48000
    assert values.tolist() == list(range(len(values)))


def test_a_full_disk_costs_the_rest_and_one_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, room, told = os.write, 50_000, list[str]()

    def write_until_full(descriptor: int, data: Any) -> int:
        if len(data) < 100:
            return write(descriptor, data)
        left = room - os.lseek(descriptor, 0, os.SEEK_CUR)
        if left <= 0:
            raise OSError(28, "No space left on device")
        return write(descriptor, data[:left])

    monkeypatch.setattr(wav.os, "write", write_until_full)
    sound, path = noise(100_000, 1), tmp_path / "sound.wav"
    file = WavFile(path, 1, RATE, told.append)
    file.put(sound)
    file.finish()
    (warning,) = told
    assert "frames are missing from the sound file (No space left on device). The run goes on" in warning
    _, values = read(path)
    assert len(values) == (room - 44) // 3
    assert np.abs(values - sound[: len(values)]).max() < 1e-7
    assert file.unwritten == 100_000 - len(values)
    assert f"{file.unwritten} frames are missing, what was written is in {path}" in file.problem


def test_at_4_gib_the_file_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wav, "_MOST_BYTES", 3000)
    path, told = tmp_path / "sound.wav", list[str]()
    file = WavFile(path, 1, RATE, told.append)
    file.put(noise(1500, 1))
    file.finish()
    assert len(read(path)[1]) == 1000
    assert "a WAV file holds 4 GiB" in told[0]


def test_a_file_that_was_removed_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "sound.wav"
    file = WavFile(path, 1, RATE, pytest.fail)
    file.put(noise(10, 1))
    path.unlink()
    file.finish()
    assert file.problem.endswith(f"(it was removed while the scene ran): {path} does not exist")


def test_two_runs_do_not_write_one_file(tmp_path: Path) -> None:
    path = tmp_path / "sound.wav"
    file = WavFile(path, 1, RATE, pytest.fail)
    with pytest.raises(UsageError, match="another run writes its sound there"):
        WavFile(path, 1, RATE, pytest.fail)
    file.finish()
    with pytest.raises(UsageError, match="the sound cannot be written: No such file or directory"):
        WavFile(tmp_path / "none" / "sound.wav", 1, RATE, pytest.fail)
