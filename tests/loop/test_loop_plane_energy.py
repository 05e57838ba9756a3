"""The energy guard adds x and y of a hand, whatever the frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from loop_rig import arrive, assembled, frame, run_with_loop
from numpy.typing import NDArray
from plane_field import field_of, plane

from firmware_protocol.compiled import new_record
from hapsim.errors import GuardError
from hapsim.loop.endings import RECEIVED
from hapsim.loop.guards.energy_guard import ENERGY_EXCEEDED, ENERGY_GUARD, SCENE, _enters
from hapsim.running import run
from hapsim.running.session_options import RunOptions

ANGLES = [0.0, 0.6, math.pi / 4.0, 2.2]


def flung(angle: float, speed: float = 0.1) -> dict[str, Any]:
    return {"initial": {"velocity": [speed * math.cos(angle), speed * math.sin(angle)]}}


def test_the_energy_of_a_hand_is_that_of_its_motion_and_the_same_in_any_frame() -> None:
    given = []
    for angle in ANGLES:
        scene = plane({"friction": 0.0, "energy_limit": 1e6}, flung(angle))
        with field_of(stiffness=5000.0):
            trace, loop = run_with_loop(scene, duration=0.064, judges_energy=True)
        given.append(float(loop.record.energy_guard.given[SCENE]))
    velocity = np.hypot(*((trace.position[62] - trace.position[60]) / 0.002))
    np.testing.assert_allclose(given, given[0], rtol=1e-5)
    spring = 0.5 * 5000.0 * float((trace.position[61] ** 2).sum())
    assert given[0] + spring == pytest.approx(0.5 * 0.2 * (velocity**2 - 0.1**2) + spring, rel=0.1)


def test_a_diverging_hand_is_ended_at_one_energy_in_any_frame() -> None:
    ticks = []
    for angle in ANGLES:
        with field_of(stiffness=20_000.0), pytest.raises(GuardError, match=r"above the limit of 0\.02 J") as caught:
            run(plane({"energy_limit": 0.02, "force_limit": 200.0}, flung(angle)), duration=5.0)
        ticks.append(caught.value.trace.report.ticks)
    assert ticks == [ticks[0]] * len(ticks)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_swing_at_the_limit_is_ended_in_any_direction(angle: float) -> None:
    with (
        field_of(stiffness=20_000.0),
        pytest.raises(GuardError, match=r"swung at its limit: 16 times|shook at its limit"),
    ):
        run(plane({"energy_limit": 1e6}, flung(angle)), duration=5.0)


def led(places: NDArray[np.float64], stiffness: float, **device: Any) -> int:
    """Leads a hand over these places (m) on a spring; returns the code that ends it, or RECEIVED."""
    with field_of(stiffness=stiffness):
        loop = assembled(plane(device), options=RunOptions(judges_energy=True))
    for number, place in enumerate(places):
        now = 10**9 + number * 10**6
        code = arrive(loop, frame(number, *(int(one) for one in np.rint(place * 1e6))), now)
        if code != RECEIVED:
            return code
        loop.state.sent_ns, loop.state.unanswered = now, 0
    return RECEIVED


def glide(begin: tuple[float, float], end: tuple[float, float], seconds: float) -> NDArray[np.float64]:
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, round(1000 * seconds)))
    return np.array(begin) + share[:, None] * (np.array(end) - np.array(begin))


def test_a_hand_that_trembles_where_one_channel_reaches_its_limit_is_not_taken_for_a_swinging_scene() -> None:
    """The spring returns what it holds in y, while x crosses the limit with every tremor."""
    back = glide((0.1, 0.1), (0.1, 0.0), 3.0)
    back[:, 0] += 0.0005 * np.sin(2.0 * np.pi * 8.0 * np.arange(len(back)) / 1000.0)
    path = np.concatenate([glide((0.0, 0.0), (0.1, 0.0), 1.0), glide((0.1, 0.0), (0.1, 0.1), 1.0), back])
    assert led(path, 100.0, friction=0.01) == RECEIVED


def test_a_hand_is_credited_with_the_force_of_both_channels() -> None:
    """A spring that both channels stretch to their limits returns all that it got."""
    corner = (0.25, 0.25)
    path = np.concatenate([glide((0.0, 0.0), corner, 2.0), glide(corner, (0.0, 0.0), 2.0)])
    assert led(path, 50.0, friction=0.01) == RECEIVED
    far = (0.45, 0.45)
    path = np.concatenate([glide((0.0, 0.0), far, 2.0), glide(far, (0.0, 0.0), 2.0)])
    assert led(path, 50.0, friction=0.01) == ENERGY_EXCEEDED


@pytest.mark.parametrize(
    ("before", "now", "enters"),
    [
        ((0.0, 0.0), (9.0, 9.0), True),
        ((0.0, 0.0), (7.0, 7.0), False),
        ((9.0, 9.0), (12.0, -8.0), False),
        ((9.0, 9.0), (8.0, -12.0), True),
        ((9.0, 9.0), (-7.0, -7.0), False),
        ((7.0, 7.0), (7.0, 8.0), True),
    ],
)
def test_an_episode_begins_beyond_the_circle_of_the_limit_or_in_another_direction(
    before: tuple[float, float], now: tuple[float, float], enters: bool
) -> None:
    energy, io = new_record(ENERGY_GUARD), assembled(plane()).record.io
    energy.asked[:2], io.asked[:2] = before, now
    with np.errstate(over="ignore"):  # steps to the next channel wrap round
        assert [_enters(energy, io, c, 1.0) for c in (0, 1)] == [enters, enters]
