"""The noise of the mock's sensor."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest

from firmware_protocol import schema

sys.path.insert(0, str(Path(__file__).parent))
from bodies import body_of
from converters import T, converter_of, first_sample, sample


def noise_of(count: int, seed: int, rms: float = 1.0) -> np.ndarray:
    converter = converter_of(noise=rms, seed=seed)
    body = body_of(1.0)
    first = first_sample(body, converter)
    return np.array([first, *[sample(body, converter, T) for _ in range(count - 1)]])


def test_the_noise_has_the_mean_and_the_deviation_that_are_stated_and_is_normal_and_white() -> None:
    n = 40_000
    noise = noise_of(n, seed=20240611, rms=2.5e-6) / 2.5e-6
    assert abs(noise.mean()) < 4 / math.sqrt(n)
    assert abs(noise.std() - 1) < 4 / math.sqrt(2 * n)
    assert kstest(noise, "norm").pvalue > 1e-3
    for lag in (1, 2, 3, 7):
        assert abs((noise[lag:] * noise[:-lag]).mean()) < 4 / math.sqrt(n)


def test_the_noise_is_that_of_xorshift64_star_and_box_muller_on_every_machine() -> None:
    state, expected, mask = 0x1234567, [], 2**64 - 1

    def uniform() -> float:
        nonlocal state
        state ^= state >> 12
        state ^= (state << 25) & mask
        state ^= state >> 27
        return (((state * 2685821657736338717) & mask) >> 11) / 2**53 + 2**-53

    for _ in range(50):
        radius = math.sqrt(-2 * math.log(uniform()))
        expected.append(radius * math.cos(2 * math.pi * uniform()))
    np.testing.assert_allclose(noise_of(50, seed=0x1234567), expected, rtol=1e-12, atol=1e-12)


def noisy_run(new_host: Callable[..., Any], exchange: Callable, seed: int, samples: int = 60) -> np.ndarray:
    host = new_host(channels=3, mock={"noise": 1e-6, "seed": seed, "quantum": 1e-9})
    heard = exchange(host, [[0]] * samples)
    return np.array([frame.counts for frame in heard if frame.type == schema.POSITION])


def test_the_same_seed_gives_the_same_noise_and_another_seed_another(
    new_host: Callable[..., Any], exchange: Callable
) -> None:
    one, again, other = (noisy_run(new_host, exchange, seed) for seed in (5, 5, 6))
    assert (one == again).all()
    assert (one != other).mean() > 0.9


def test_every_channel_has_noise_of_its_own_from_the_first_sample_on(
    new_host: Callable[..., Any], exchange: Callable
) -> None:
    noise = noisy_run(new_host, exchange, seed=0, samples=2000)
    assert (noise[0] != 0).all()
    correlation = np.corrcoef(noise.T) - np.eye(3)
    assert np.abs(correlation).max() < 4 / math.sqrt(2000)
    assert noise.std(axis=0) == pytest.approx([1000.0] * 3, rel=0.1)


def test_velocities_have_normal_noise_of_their_own_as_many_periods_of_the_position_s_as_there_are_in_a_second(
    new_host: Callable[..., Any], exchange: Callable
) -> None:
    n = 4000
    host = new_host(channels=2, rate=2000.0, mock={"noise": 1e-6, "quantum": 1e-9})
    heard = exchange(host, [[0, 0]] * n, velocity=True)
    noise = np.array([frame.counts for frame in heard if frame.type == schema.POSITION])
    rms = noise.std(axis=0) * [1e-9, 1e-9, 2e-6, 2e-6]
    assert rms == pytest.approx([1e-6, 1e-6, 2e-3, 2e-3], rel=0.06)
    assert (noise[0] != 0).all()
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 4 / math.sqrt(n)
    velocity = noise[:, 2] / noise[:, 2].std()
    assert kstest(velocity, "norm").pvalue > 1e-3
    assert abs((velocity[1:] * velocity[:-1]).mean()) < 4 / math.sqrt(n)


def test_a_run_without_velocities_has_the_noise_that_it_always_had(new_host: Callable[..., Any]) -> None:
    host = new_host(mock={"noise": 1e-6, "seed": 7, "quantum": 1e-9})
    expected = noise_of(5, seed=int(host.mock.converters["seed"][0]), rms=1e-6)
    heard = host.arm()
    for n in range(4):
        heard += host.force(n)
    counts = [frame.counts[0] for frame in heard if frame.type == schema.POSITION]
    assert counts == np.rint(expected / 1e-9).tolist()


def test_noise_is_in_the_sensor_and_not_in_the_motion(new_host: Callable[..., Any], exchange: Callable) -> None:
    moving = {"initial": {"velocity": 0.3}}
    quiet, noisy = new_host(mock=moving), new_host(mock=moving | {"noise": 1e-4})
    for host in (quiet, noisy):
        exchange(host, [[2**30]] * 50)
    assert quiet.bodies.tolist() == noisy.bodies.tolist()


def test_without_noise_the_generator_stands_still() -> None:
    converter = converter_of(seed=99)
    sample(body_of(1.0), converter, T)
    assert converter.state == 0
    assert first_sample(body_of(1.0, position=0.5), converter) == 0.5
