"""The scenes that ship with a sound sound by themselves, loud enough, at the pitches that are predicted for them."""

from __future__ import annotations

import wave
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim import run
from hapsim.prediction import partials_of
from hapsim.scene import Scene, load_scene

FOLDER = Path(__file__).parents[2] / "configs"
SECONDS = 3.2
PARTIALS = {"plucked_string": 6, "struck_membrane": 3, "bell": 7}
RINGS = slice(-44_000, None)  # frames of the last second, after the last pluck or stroke
SCENES = ("bell", "bowed_string", "guiro", "plucked_string", "struck_membrane")


def shipped(name: str) -> Scene:
    scene = load_scene(FOLDER / f"{name}.yaml")
    return scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})


@cache
def rendered(name: str) -> tuple[NDArray[np.float64], float]:
    """The frames of a scene's WAV file in virtual time, and the largest force in N."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sound.wav"
        trace = run(shipped(name), duration=SECONDS, unstable=False, sound_file=path)
        with wave.open(str(path)) as file:
            assert (file.getnchannels(), file.getsampwidth(), file.getframerate()) == (1, 3, 44_000)
            frames = np.frombuffer(file.readframes(file.getnframes()), np.uint8).reshape(-1, 3)
    counts = np.pad(frames, ((0, 0), (1, 0))).view("<i4")[:, 0]  # 24 bits in the upper ones of 32
    return counts / 2.0**31, float(np.abs(trace.asked_force).max())


def peak_near(wanted: float, sound: NDArray[np.float64], rate: float) -> float:
    """Hz, of the partial within 3 % of `wanted`, by a parabola through the logarithms of the three largest bins."""
    spectrum = np.log(np.abs(np.fft.rfft(sound * np.hanning(sound.size))))
    width = rate / sound.size
    low, high = int(0.97 * wanted / width), int(np.ceil(1.03 * wanted / width))
    i = low + int(np.argmax(spectrum[low : high + 1]))
    assert low < i < high
    assert spectrum[i] > np.log(30.0) + max(spectrum[low], spectrum[high])  # it stands out
    a, b, c = spectrum[i - 1 : i + 2]
    return float((i + 0.5 * (a - c) / (a - 2 * b + c)) * width)


def test_every_scene_with_a_sound_is_here() -> None:
    assert tuple(path.stem for path in sorted(FOLDER.glob("*.yaml")) if load_scene(path).sound) == SCENES


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("name", SCENES)
def test_a_scene_sounds_by_itself_and_peaks_near_minus_6_db(name: str) -> None:
    sound, force = rendered(name)
    assert sound.size == SECONDS * shipped(name).step_rate
    assert -9.0 < 20 * np.log10(np.abs(sound).max()) < -3.0  # the soft clip begins at -2.5
    assert 0.2 < force < 0.5 * shipped(name).device.force_limit


@pytest.mark.parametrize("name", PARTIALS)
def test_the_pitches_that_are_predicted_are_those_that_sound(name: str) -> None:
    scene = shipped(name)
    (heard,) = partials_of(scene).values()
    pitches = heard[: PARTIALS[name]]
    assert len(pitches) == PARTIALS[name]
    sound, _ = rendered(name)
    assert [peak_near(pitch, sound[RINGS], scene.step_rate) for pitch in pitches] == pytest.approx(pitches, rel=1e-3)


def test_the_bowed_string_sticks_and_slips_at_its_pitch_a_little_flat() -> None:
    sound, _ = rendered("bowed_string")
    rate = shipped("bowed_string").step_rate
    stroke = sound[int(0.5 * rate) : int(1.0 * rate)]
    spectrum = np.fft.rfft(stroke - stroke.mean(), 2 * stroke.size)
    alike = np.fft.irfft(np.abs(spectrum) ** 2)[: stroke.size]
    lags = slice(int(rate / 500), int(rate / 60))
    period = lags.start + int(np.argmax(alike[lags]))
    assert alike[period] > 0.9 * alike[0] * (1 - period / stroke.size)  # each period is as the one before
    assert 97.0 < rate / period < 98.0


def test_the_scraper_clicks_once_a_ridge() -> None:
    sound, _ = rendered("guiro")
    rate = shipped("guiro").step_rate
    loud = np.sqrt(np.convolve(sound[: int(0.15 * rate)] ** 2, np.ones(44) / 44, "same"))
    spectrum = np.abs(np.fft.rfft((loud - loud.mean()) * np.hanning(loud.size), 1 << 16))
    clicks_hz = np.argmax(spectrum) * rate / (1 << 16)
    assert clicks_hz == pytest.approx(0.33 / 0.004, rel=0.1)
