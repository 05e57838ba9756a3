"""The compiled callback on a simulated sound card: its ratio, its purity, its gaps, its latency."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated_card import BLOCK, SimulatedCard, sinad_db

from hapsim.loop.histogram import histogram_of


def sine(hz: float, size: float = 0.5):
    return lambda t: size * np.sin(2.0 * np.pi * hz * t)


def largest_step(values: NDArray[np.float32]) -> float:
    return float(np.abs(np.diff(values, axis=0)).max())


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("card_hz", "seed"), [(44100, 1), (48000, 2), (96000, 1), (48000, 1)])
def test_after_15_s_the_ratio_is_within_1_ppm_and_its_steps_are_small(card_hz: int, seed: int, figures: Any) -> None:
    """Clocks 80 ppm apart; positions and blocks up to 50 µs late. With 48 kHz the blocks come in almost whole periods
    of the device, so that its steps of 48 frames beat with them within seconds."""
    card = SimulatedCard(sine(1000.0), card_hz=card_hz, device_ppm=-30.0, card_ppm=50.0, jitter_s=5e-5, seed=seed)
    ratios: list[float] = []
    card.run(20.0, lambda: ratios.append(float(card.record.ratio)))
    seconds = card_hz / BLOCK
    off = 1e6 * (np.array(ratios) / card.true_ratio - 1.0)
    settled = np.abs(off[round(15.0 * seconds) :]).max()
    assert settled < 1.0
    figures.most("sound: ratio of the clocks, ppm off after 15 s", settled)
    assert np.abs(np.diff(off[round(0.5 * seconds) :])).max() < 100.0  # ppm from block to block: 0.2 cents
    assert card.record.underruns == 0


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("rates", "card_hz"),
    [
        ((1000.0, 48), 44100),
        ((1000.0, 48), 48000),
        ((1000.0, 44), 48000),
        ((1000.0, 44), 96000),
        ((4410.0, 10), 44100),
        ((4410.0, 10), 48000),
        ((3000.0, 5), 96000),
        ((3000.0, 5), 44100),
        ((1000.0, 300), 96000),
    ],
)
def test_a_sine_of_1_khz_stays_one(rates: tuple[float, int], card_hz: int, figures: Any) -> None:
    """At least 90 dB over noise, images and distortion, between any two rates and with clocks that are apart."""
    device_hz, substeps = rates
    card = SimulatedCard(sine(1000.0), device_hz=device_hz, substeps=substeps, card_hz=card_hz, card_ppm=50.0)
    played = card.run(4.0)[-card_hz // 2 :, 0]
    sinad = sinad_db(played, 1000.0 / card_hz)
    assert sinad > 90.0
    figures.most(f"sound: noise and distortion of 1 kHz at {card_hz} Hz, dB", -sinad)
    assert np.abs(played).max() == pytest.approx(0.5, rel=1e-3)


def test_a_gap_fades_out_and_in_and_is_counted() -> None:
    """60 samples of the device come late, all at once: as where the loop was held up."""
    card = SimulatedCard(sine(200.0), card_hz=44100)
    begin = card.run(2.0)
    smooth = largest_step(begin[-BLOCK * 100 :])
    card.skipped = set(range(2100, 2160))
    played = card.run(1.0)[:, 0]
    assert card.record.underruns == 1
    assert card.record.lost == 0
    silent = np.abs(played) < 1e-4
    assert silent.reshape(-1, BLOCK).all(axis=1).sum() > 10  # blocks
    # The last value decays by 1/133 a frame, and the sound fades in within 441.
    assert largest_step(played) < smooth + 0.5 * (1.0 / 132.0 + 1.0 / 441.0)
    assert largest_step(begin[: BLOCK * 100]) < smooth + 0.5 / 441.0
    assert sinad_db(played[-8000:], 200.0 / 44100) > 60.0  # it sounds again


def test_it_fades_out_when_it_is_asked_to() -> None:
    card = SimulatedCard(sine(200.0), card_hz=44100)
    smooth = largest_step(card.run(1.0)[-BLOCK * 100 :])
    card.record.quiet = 1
    played = card.run(0.5)
    assert largest_step(played) < smooth + 0.5 / 441.0
    assert np.abs(played[1000:]).max() == 0.0
    assert card.record.underruns == 0


def test_the_delay_is_what_is_asked_for_or_what_is_needed() -> None:
    """Measured by a click: the scene's value jumps at 1 s of the device's clock."""
    for latency_s, expected_s in ((0.014, 0.012), (0.0, 0.0056)):
        card = SimulatedCard(lambda t: np.where(t >= 1.0, 0.5, 0.0), card_hz=44100, latency_s=latency_s)
        played = card.run(2.0)[:, 0]
        assert np.flatnonzero(played > 0.25)[0] / 44100 - 1.0 == pytest.approx(expected_s, abs=2e-4)
        latency = histogram_of(card.record.latency, 1e-9).quantile(0.5)
        assert latency == pytest.approx(expected_s + 0.002, rel=0.07)  # the card's own 2 ms, in bins of 6 %
        assert card.record.underruns == 0


def test_frames_that_are_overwritten_are_counted_and_the_newest_are_played() -> None:
    card = SimulatedCard(sine(200.0), card_hz=44100)
    card.run(1.0)
    card._block += 3 * 44100 // BLOCK  # the card stops for 3 s, and the ring holds 1.4
    played = card.run(1.0)[:, 0]
    assert card.record.lost > 0
    assert sinad_db(played[-8000:], 200.0 / 44100) > 60.0


@pytest.mark.parametrize(("channels", "outputs"), [(1, 2), (2, 2), (3, 2), (2, 4)])
def test_one_channel_plays_everywhere_and_several_each_in_its_place(channels: int, outputs: int) -> None:
    levels = np.array([0.5, -0.25, 0.125])[:channels]
    card = SimulatedCard(lambda t: np.tile(levels, (len(t), 1)), channels=channels, outputs=outputs)
    last = card.run(0.5)[-1]
    expected = [levels[0]] * outputs if channels == 1 else [*levels, *[0.0] * outputs][:outputs]
    assert last == pytest.approx(expected, abs=1e-5)


def test_a_clock_far_from_what_it_declares_harms_nothing() -> None:
    """A card that loses a fifth of its time: gaps, but nothing beyond the memory of a chunk is read."""
    card = SimulatedCard(sine(200.0), card_hz=44100, card_ppm=-2e5)
    played = card.run(5.0)
    assert card.record.slope <= 1.05 * card.record.nominal
    assert card.record.room >= 64 * 1.051 * card.record.nominal + 2 * card.record.half + 1
    assert np.abs(played).max() < 0.55
    assert card.record.underruns > 0
