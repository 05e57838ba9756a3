"""The way of a servo once its host is silent: the C firmware in virtual time, beside the bound of PROTOCOL.md."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from random import Random
from typing import Any

import pytest

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, armed_format, frame_to_device
from firmware_protocol.vectors import DEVICES

SERVO = {"name": "servo"} | DEVICES["servo"]
BRAKING, SPEED_LIMIT, HOLD = 10, 1000, 500  # counts per sample each sample, counts per sample, samples
WIRE = armed_format(1, schema.ADMITTANCE)


def force(sample: int, command: int, time_to_live: int) -> str:
    return f"bytes {frame_to_device(WIRE, schema.FORCE, sample % 4096, time_to_live, [0, command]).hex()}"


def arm(watchdog: int) -> str:
    return f"bytes {frame_to_device(SETUP, schema.ARM, watchdog, schema.ADMITTANCE, [schema.SCHEMA_HASH]).hex()}"


def commands_of(answers: list[str]) -> list[int | None]:
    """The command of each answer of the harness; None without torque."""
    last = [answer.split()[-1] for answer in answers]
    return [None if word == "none" else int(word) for word in last]


@pytest.mark.parametrize("seed", range(8))
def test_a_servo_whose_host_dies_rests_within_the_bound_then_holds_and_lets_go(
    seed: int, harness: Callable[..., Any]
) -> None:
    chance = Random(seed)
    speed = chance.choice([1, -1]) * chance.randint(1, SPEED_LIMIT)
    lives, watchdog = chance.randint(0, 60), chance.randint(2, 60)
    lines = [arm(watchdog)]
    for n in range(20):
        lines += [force(n, speed * (n + 1), lives), "tick"]
    braking = abs(speed) // BRAKING + 2
    answers = harness(SERVO)([*lines, *["tick"] * (min(lives, watchdog) + watchdog + braking + HOLD + 10)])
    went = commands_of(answers[len(lines) :])
    last, bound = 20 * speed, speed**2 / (2 * BRAKING) + abs(speed) * (min(lives, watchdog) + 1)
    moved = [abs(place - last) for place in went if place is not None]
    assert max(moved) <= bound
    assert max(moved) >= bound - 2 * abs(speed) - BRAKING  # it brakes no harder than it has to
    steps = [abs(b - a) for a, b in pairwise(moved)]
    assert max((a - b for a, b in pairwise(steps)), default=0) <= BRAKING + 1
    assert went[-1] is None
    at_rest = [place for place in went if place == went[len(moved) - 1]]
    assert len(at_rest) <= HOLD + 1 + watchdog + 1  # from its rest on, or from the latching
    assert answers[-1].startswith("2 ")


@pytest.mark.parametrize("lost", [1, 3, 10])
def test_lost_frames_are_bridged_at_the_speed_of_before(lost: int, harness: Callable[..., Any]) -> None:
    lines = [arm(100)]
    for n in range(60):
        lines += [] if 20 <= n < 20 + lost else [force(n, 50 * (n + 1), 20)]
        lines += ["tick"]
    ticks = [at for at, line in enumerate(lines) if line == "tick"]
    answers = harness(SERVO)(lines)
    assert commands_of([answers[at] for at in ticks]) == [50 * (n + 1) for n in range(60)]


def test_a_device_without_torque_ignores_commands(harness: Callable[..., Any]) -> None:
    answers = harness(SERVO)([force(0, 50, 9), "tick", arm(2), *["tick"] * 510, force(3, 50, 9), "tick"])
    commands = commands_of(answers)
    assert commands[:3] == [None, None, 0]
    assert commands[-3:] == [None] * 3
