"""A scene's sound in a run: rendered in virtual time, played on a card, and what happens without one."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from ctypes.util import find_library
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_sound_wav import read

from hapsim.errors import RecordError, UsageError
from hapsim.running import requirements, run, start
from hapsim.scene import parse_scene
from hapsim.sound import wav

SCENE = """
version: 1
rate: 1000
substeps: 48
device: {{clock: {clock}, mass: 0.2, friction: 1.0}}
mock: {{initial: {{velocity: 0.1}}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}}
"""
EAR = "sound: {ear: {from: hand, of: position, gain: 150.0}}\n"


def scene_of(clock: str = "lockstep", sound: str = EAR) -> Any:
    return parse_scene(SCENE.format(clock=clock) + sound, "test.yaml")


def test_in_virtual_time_every_step_is_written_and_two_renders_are_the_same(tmp_path: Path) -> None:
    """2 s are 96 000 frames, of which the ring holds 65 536: the loop waits for the file."""
    paths = tmp_path / "a.wav", tmp_path / "b.wav"
    traces = [run(scene_of(), duration=2.0, sound_file=path) for path in paths]
    report = traces[0].report
    assert (report.ticks, report.sound_frames, report.lost_sound_frames, report.underruns) == (2000, 96_000, 0, 0)
    parameters, values = read(paths[0])
    assert (parameters.framerate, parameters.nframes) == (48_000, 96_000)
    position = traces[0].position[:, 0]  # of every 48th step
    assert np.abs(values[47::48, 0] - 150.0 * position).max() < 3e-7
    assert np.abs(values).max() > 0.1
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_what_a_full_disk_leaves_is_kept_and_the_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wav, "_MOST_BYTES", 30_000)
    warnings: list[str] = []
    with pytest.raises(RecordError, match="ended normally after 2000 ticks, but the sound file is") as error:
        run(scene_of(), duration=2.0, sound_file=tmp_path / "a.wav", on_warning=warnings.append)
    assert len(read(tmp_path / "a.wav")[1]) == 10_000
    assert error.value.trace.report.lost_sound_frames == 86_000
    assert len(warnings) == 1


@pytest.mark.parametrize(
    ("scene", "options", "message"),
    [
        (scene_of(sound=""), {"sound_file": "a.wav"}, "the scene has no sound: expected pick-ups"),
        (scene_of(), {"sound": True}, "sound is not played in virtual time"),
        (scene_of(), {"sound_file": "a.mp3"}, "a.mp3: found the ending '.mp3', expected .wav"),
        (scene_of().model_copy(update={"rate": 1e8}), {"sound_file": "a.wav"}, "a WAV file of 1 channel.* has 1 to 14"),
        (scene_of(), {"sound_file": "none/a.wav"}, "there is no directory"),
        (scene_of("device"), {"sound": True, "latency_s": 2.0}, "latency: found 2 s, expected 0 to 500 ms"),
        (scene_of("device"), {"sound": True, "volume_db": 60.0}, "volume: found 60 dB, expected at most 40 dB"),
    ],
)
def test_what_cannot_be_played_is_refused(scene: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        start(scene, **options)


def test_a_larger_scene_whose_steps_do_not_fit_is_not_adopted(monkeypatch: pytest.MonkeyPatch) -> None:
    with start(scene_of("device")) as session:
        now = session.scene
        monkeypatch.setattr(requirements, "tick_seconds", lambda *_: 1e-4)
        with pytest.raises(UsageError, match=r"substeps: found 48, whose steps take 4\.8 ms here"):
            session.adopt(scene_of("device", EAR.replace("of: position", "of: velocity")))
        assert session.scene is now


class Card:
    """A module sounddevice with one stereo card at 48 kHz, whose callback a thread calls as long as `works`."""

    def __init__(self, *names: str) -> None:
        self.works = True
        self.blocks = 0
        device = {"hostapi": 0, "max_output_channels": 2, "default_samplerate": 48000.0}
        device |= {"default_low_output_latency": 0.005}
        card = self

        class Stream:
            latency = 0.005

            def __init__(self, kind: str, **options: Any) -> None:
                assert kind == "output"
                assert options["wrap_callback"] is None
                self._call = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_uint64] * 6)(options["callback"])
                self._player, self._channels, self._ends = options["userdata"], options["channels"], threading.Event()

            def start(self) -> None:
                threading.Thread(target=self._play, daemon=True).start()

            def _play(self) -> None:
                out = np.zeros(256 * self._channels, np.float32)
                while not self._ends.wait(256 / 48000.0):
                    if card.works:
                        self._call(0, out.ctypes.data, 256, 0, 0, self._player)
                        card.blocks += 1

            def abort(self) -> None:
                self._ends.set()

            close = abort

        module: Any = types.ModuleType("sounddevice")
        module._StreamBase, module.PortAudioError, module._initialized = Stream, OSError, 1
        module._ffi = types.SimpleNamespace(cast=lambda _kind, value: value)
        module._exit_handler = module._initialize = module._terminate = lambda: None
        module.query_devices = lambda: [device | {"name": name} for name in names]
        module.query_hostapis = lambda: ({"name": "ALSA"},)
        module.default = types.SimpleNamespace(device=(-1, 0))
        self.module = module


@pytest.fixture
def with_card(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Card]:
    def insert(*names: str) -> Card:
        card = Card(*names)
        monkeypatch.setitem(sys.modules, "sounddevice", card.module)
        return card

    return insert


def test_it_plays_during_the_loop(with_card: Callable[..., Card], tmp_path: Path) -> None:
    """Sound plays next to the loop. The number of gaps on a busy machine does not matter here."""
    with_card("HDA Intel")
    report = run(scene_of("device"), duration=0.5, sound=True, sound_file=tmp_path / "a.wav", latency_s=0.03).report
    assert report.sound_frames >= 48 * report.ticks
    assert len(read(tmp_path / "a.wav")[1]) == report.sound_frames
    assert report.sound_latency_s is not None
    assert report.sound_latency_s[0] > 0.01
    assert report.resampling_ppm is not None


def test_a_lost_card_is_silent_and_nothing_else_happens(with_card: Callable[..., Card]) -> None:
    card, warnings = with_card("HDA Intel"), list[str]()
    with start(scene_of("device"), sound=True, on_warning=warnings.append) as session:
        while card.blocks == 0:
            time.sleep(0.01)
        card.works = False
        while not warnings:
            assert not session.wait(0.01)
        ticks = session.progress().ticks
        while session.progress().ticks < ticks + 100:
            assert not session.wait(0.01)
    assert session.trace.report.ending == "stopped"
    assert warnings == [
        "HDA Intel: the sound card has taken nothing for 1 s, and is silent from here on. The scene goes on"
    ]


def test_a_card_that_is_gone_when_the_device_comes_back_does_not_end_the_run(with_card: Callable[..., Card]) -> None:
    with_card()
    warnings: list[str] = []
    run(scene_of("device"), duration=0.1, sound=True, resumes=True, on_warning=warnings.append)
    assert "no sound card" in warnings[0]
    assert "The scene continues without sound" in warnings[0]


@pytest.mark.parametrize(
    ("names", "wanted", "message"),
    [
        ((), "", "no sound card: PortAudio finds nothing to play on"),
        (("HDA Intel", "USB Audio"), "HDA Intle", "found no 'HDA Intle'; did you mean 'HDA Intel'"),
        (("HDA Intel", "USB Intel"), "intel", r"fits several: 0 \(HDA Intel, ALSA\), 1 \(USB Intel, ALSA\)"),
    ],
)
def test_a_card_that_is_not_there_is_named(
    with_card: Callable[..., Card], names: tuple[str, ...], wanted: str, message: str
) -> None:
    with_card(*names)
    with pytest.raises(UsageError, match=message):
        start(scene_of("device"), sound=True, sound_device=wanted)


def test_without_sounddevice_or_portaudio_both_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(UsageError, match=r"sounddevice, which is not installed.*hapsim\[sound\].*libportaudio2"):
        start(scene_of("device"), sound=True)
    monkeypatch.delitem(sys.modules, "sounddevice")
    (tmp_path / "sounddevice.py").write_text("raise OSError('PortAudio library not found')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        UsageError, match=r"no PortAudio \(PortAudio library not found\).*hapsim\[sound\].*libportaudio2"
    ):
        start(scene_of("device"), sound=True)


def test_the_command_lists_cards_and_writes_files(
    hapsim: Callable[..., Any], with_card: Callable[..., Card], tmp_path: Path
) -> None:
    with_card("HDA Intel", "USB Audio")
    (device, _) = json.loads(hapsim("sound", "--json").out)["devices"]
    assert (device["name"], device["outputs"], device["rate_hz"], device["is_default"]) == ("HDA Intel", 2, 48e3, True)
    assert "USB Audio" in hapsim("sound").out
    scene, file = tmp_path / "scene.yaml", tmp_path / "a.wav"
    scene.write_text(SCENE.format(clock="lockstep") + EAR)
    command = "run", scene, "--duration", "0.5", "--sound-file", file
    answer = hapsim(*command)
    assert f"Sound: {file}" in answer.out.replace("\n", "")
    assert "24000" in answer.out
    assert "the file exists; --overwrite replaces it" in hapsim(*command).sentence
    assert json.loads(hapsim(*command, "--overwrite", "--json").out)["sound_files"] == [str(file)]
    assert "--volume needs --sound" in hapsim(*command, "--volume", "-6").sentence


JACK = {"JACK_DEFAULT_SERVER": "hapsim_test", "JACK_NO_START_SERVER": "1"}


@pytest.fixture
def jack(tmp_path: Path) -> Iterator[dict[str, str]]:
    """The environment of a sound server without a card."""
    if shutil.which("jackd") is None or find_library("portaudio") is None:
        pytest.skip("jackd or libportaudio2 is not installed (Debian: jackd2, libportaudio2)")
    command = ["jackd", "-n", JACK["JACK_DEFAULT_SERVER"], "--no-realtime", "-d", "dummy", "-r", "44100", "-p", "128"]
    with (tmp_path / "jack.log").open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as server:
        try:
            yield os.environ | JACK
        finally:
            server.terminate()


@pytest.mark.thorough
def test_a_second_on_a_sound_server(jack: dict[str, str], tmp_path: Path) -> None:
    """PortAudio itself plays, in a process of its own, since it can be loaded only once."""
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE.format(clock="device") + EAR)
    command = [sys.executable, "-m", "hapsim"]
    for _ in range(100):
        listed = subprocess.run([*command, "sound", "--json"], env=jack, capture_output=True, text=True, check=True)
        if json.loads(listed.stdout)["devices"]:
            break
        time.sleep(0.05)
    command += ["run", str(scene), "--duration", "1", "--sound", "--json"]
    answer = subprocess.run(command, env=jack, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    report = json.loads(answer.stdout)
    assert report["sound_frames"] >= 48 * report["ticks"]
    assert report["lost_sound_frames"] == 0
    assert report["sound_latency_s"][0] > 0.003
