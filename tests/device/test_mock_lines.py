"""The mock that follows lines: against a loop written out in Python, and against the poles of that loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from firmware_protocol import schema
from firmware_protocol.lines import line_counts, pack_line
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.errors import UsageError

New = Callable[..., Any]
NM, LIMIT = 1e-9, 32767
HASH = schema.SCHEMA_HASH
REGISTERS = (schema.REG_ACCEPTED, schema.REG_REJECTED, schema.REG_HELD, schema.REG_EXPIRED, schema.REG_LIMITED)


def board(**fields: Any) -> dict[str, Any]:
    return {"law": "board", "mass": 0.2, "friction": 1.0, "clock": "lockstep"} | fields


def counters(host: Any) -> list[int]:
    host.disarm()
    return [host.register(number) for number in REGISTERS]


def test_it_describes_the_board_of_the_scene_and_what_the_bare_mass_bears(new_scene: New, new_host: New) -> None:
    scene = new_scene(device=board(board_rate=4000.0, board_delay=2, board_window=3))
    lines = describe_mock(scene).lines
    assert lines is not None
    assert (lines.steps, lines.delay, lines.window, lines.kept) == (4, 2, 3, 32)
    late = 2.5 / 4000
    assert 0.99 * 11.0 / late < lines.largest_stiffness[0] <= 11.0 / late
    assert lines.largest_stiffness[0] / 32768 < lines.stiffness_scale[0] <= lines.largest_stiffness[0] / 16383
    assert lines.largest_damping[0] / 65536 < lines.damping_scale[0] <= lines.largest_damping[0] / 32767
    assert describe_mock(new_scene()).lines is None
    assert new_host().arm(parts=schema.WITH_LINE)[-1].fault == schema.WRONG_SENSING
    assert new_host(device=board()).arm(schema.PACED_BY_HOST, parts=schema.WITH_LINE)[-1].fault == schema.WRONG_PACING
    with pytest.raises(UsageError, match="at most 1000"):
        new_host(device=board(board_rate=2e6))


class Loop:
    """One channel of the mock, written out: integers without bounds, and motion by a matrix exponential."""

    def __init__(self, host: Any, c: int, velocity: float) -> None:
        follower = host.mock.follower
        self.steps, self.delay, self.window, self.late = (
            int(follower[n]) for n in ("steps", "delay", "window", "late")
        )
        self.shifts, self.largest = follower["shifts"][c].tolist(), follower["largest"][c].tolist()
        self.limit, self.force_scale = int(follower["limit"][c]), float(host.mock.force_scale[c])
        mass, friction = float(host.mock.bodies["mass"][c]), float(host.mock.bodies["friction"][c])
        self.move = expm(np.array([[0, 1, 0], [0, -friction / mass, 1 / mass], [0, 0, 0]]) * 1e-3 / self.steps)
        self.state = np.array([0.0, velocity, 0.0])
        self.local, self.forces, self.reported = [], [0] * self.delay, [0]
        self.lines: list[tuple[int, ...]] = []

    def sample(self, line: tuple[int, ...]) -> int:
        """Moves through a sample, which this line answers: (force, k, b, low, high), as sent. Returns the position."""
        self.lines.append(line)
        for _ in range(self.steps):
            x = self.reported[-1] if len(self.local) % self.steps == 0 else round(self.state[0] / NM)
            at = (len(self.local) - self.late) // self.steps
            self.forces.append(self.force(x, at) if at >= 0 else 0)
            self.local.append(x)
            self.state[2] = self.forces[len(self.local) - 1] * self.force_scale
            self.state = self.move @ self.state
        self.reported.append(round(self.state[0] / NM))
        return self.reported[-1]

    def force(self, x: int, at: int) -> int:
        f, k, b, low, high = self.lines[at]
        k, b = max(-self.largest[0], min(k, self.largest[0])), min(b, self.largest[1])
        lower, upper = (int(math.copysign(abs(bound) * self.limit // LIMIT, bound)) for bound in (low, high))
        u = f - math.floor(k * (x - self.reported[at]) / 2 ** self.shifts[0])
        if u >= upper or u <= lower:
            return upper if u >= upper else lower
        before = len(self.local) - self.window
        moved = x - (self.local[before] if before >= 0 else self.reported[0])
        return max(lower, min(u - math.floor(b * moved / 2 ** self.shifts[1]), upper))


@pytest.mark.parametrize(
    ("steps", "delay", "window", "late"),
    [
        (10, 1, 10, 1.0),
        (10, 1, 1, 1.0),
        (4, 0, 4, 2.0),
        (1, 0, 1, 0.0),
        (10, 13, 3, 1.3),
        (5, 2, 5, 3.2),
    ],
)
def test_it_moves_as_a_loop_that_is_written_out(
    new_host: New, steps: int, delay: int, window: int, late: float
) -> None:
    device = board(board_rate=1000.0 * steps, board_delay=delay, board_window=window, delay=late)
    host = new_host(channels=2, device=device, mock={"initial": {"velocity": [0.1, -0.2]}})
    loops = [Loop(host, c, velocity) for c, velocity in enumerate((0.1, -0.2))]
    chance = np.random.default_rng(steps)
    (*_, position) = host.arm(parts=schema.WITH_LINE)
    assert position.counts == (0, 0)
    for n in range(200):
        words, lines = [], []
        for loop in loops:
            k, b = int(chance.integers(-900, 32767)), int(chance.integers(0, 3000))
            low, high = sorted(chance.integers(-LIMIT, LIMIT + 1, 2).tolist())
            force = int(chance.integers(-2 * 10**9, 2 * 10**9)) - 10 * k * loop.reported[-1]
            force = max(-(2**31), min(force, 2**31 - 1))
            words += pack_line(k, b, low, high)
            lines.append((force, k, b, low, high))
        (position,) = host.force(n, [line[0] for line in lines] + words)
        assert position.type == schema.POSITION
        expected = [loop.sample(line) for loop, line in zip(loops, lines, strict=True)]
        assert np.abs(np.subtract(position.counts, expected)).max() <= 2


def felt(host: Any, stiffness: float, damping: float, scales: tuple[float, ...]) -> tuple[float, float]:
    """Returns the k (N/m) and b (N·s/m, with the device's own) of the pole by which a hand on a spring moves."""
    k, b, low, high, fits = line_counts(stiffness, damping, -10.0, 10.0, scales, 10.0)
    assert fits
    host.arm(parts=schema.WITH_LINE)
    x, positions = 0, []
    for n in range(400):
        (position,) = host.force(
            n, [round(-stiffness * x * NM / float(host.mock.force_scale[0])), *pack_line(k, b, low, high)]
        )
        x = position.counts[0]
        positions.append(x)
    late = np.array(positions[60:], float)
    sums, *_ = np.linalg.lstsq(np.stack([late[1:-1], late[:-2]], 1), late[2:], rcond=None)
    pole = np.log(np.roots([1.0, -sums[0], -sums[1]])[0]) * 1000.0
    return 0.2 * abs(pole) ** 2, -0.4 * pole.real


@pytest.mark.parametrize("late", [0, 1, 3, 17])
@pytest.mark.parametrize(("window", "expected"), [(1, (2009.843658662, 5.727012989)), (10, (2033.138, 5.7813))])
def test_a_spring_on_the_board_is_felt_the_same_whatever_the_delay_of_the_wire(
    new_scene: New, new_host: New, late: int, window: int, expected: tuple[float, float]
) -> None:
    device = board(board_window=window, delay=late)
    lines = describe_mock(new_scene(device=device)).lines
    assert lines is not None
    host = new_host(device=device, mock={"initial": {"velocity": 0.05}})
    assert felt(host, 2000.0, 5.0, lines.scales(0)) == pytest.approx(expected, rel=5e-4)


LINE = dict(zip(("k", "b", "low", "high"), (0, 0, -LIMIT, LIMIT), strict=True))


def force_with(host: Any, n: int, force: int, time_to_live: int = 20, **line: int) -> Any:
    return host.force(n, [force, *pack_line(*(LINE | line).values())], time_to_live=time_to_live)


def pushed(host: Any) -> list[int]:
    """The forces that act or will, in counts."""
    return sorted(host.mock.follower.under_way[: int(host.mock.follower.delay) + 1, 0].tolist())


def test_bounds_zero_and_the_limit_are_exact_and_what_saturates_is_counted(new_host: New) -> None:
    host = new_host(device=board(board_rate=4000.0, mass=100.0))
    host.arm(parts=schema.WITH_LINE)
    limit = int(host.mock.follower["limit"][0])
    force_with(host, 0, 2**31 - 1)
    force_with(host, 1, 0)
    assert pushed(host) == [limit, limit]
    force_with(host, 2, -5, high=0)
    force_with(host, 3, -5, k=32767, b=65535, low=0, high=0)
    assert pushed(host) == [-5, -5]
    force_with(host, 4, 0)
    assert pushed(host) == [0, 0]
    k_most, b_most = host.mock.follower["largest"][0].tolist()
    assert counters(host) == [5, 0, 0, 0, 4 + (k_most < 32767) + (b_most < 65535)]


def test_a_low_above_a_high_is_an_error_of_form_and_feeds_no_watchdog(new_host: New) -> None:
    host = new_host(channels=2, device=board())
    host.arm(schema.PACED_BY_DEVICE, watchdog=3, parts=schema.WITH_LINE)
    for n in range(3):
        assert host.force(n, [7, 7, *pack_line(0, 0, -1, 1), *pack_line(0, 0, 1, 0)]) == []
        assert host.sample_passes()[0].type == schema.POSITION_HELD
        assert host.check_watchdog() == [] or n == 2
    host.sample_passes()
    host.check_watchdog()
    assert host.state == schema.LATCHED
    assert [host.register(number) for number in REGISTERS[:2]] == [0, 3]


def test_a_missed_sample_ends_a_negative_stiffness_and_the_time_to_live_ends_the_line(new_host: New) -> None:
    device = board(mass=100.0, board_delay=0)
    for k in (-3, 3):
        host = new_host(device=device, mock={"initial": {"velocity": 0.01}})
        shift = int(host.mock.follower["shifts"][0, 0])
        host.arm(schema.PACED_BY_DEVICE, parts=schema.WITH_LINE)
        force_with(host, 0, 5000, time_to_live=2, k=k)
        seen = []
        for _ in range(5):
            host.sample_passes()
            seen.append(pushed(host)[0])
        x = [round((n + 0.9) * 10_000) for n in range(5)]  # nm, at the last local period of a sample
        held = max(k, 0)
        expected = [5000 - math.floor(own * x[n] / 2**shift) for n, own in ((1, k), (2, held), (3, held))]
        assert seen == pytest.approx([0, *expected, 0], rel=1e-3)  # friction slows the hand
        assert abs(seen[1] - 5000) > 50


def test_an_answer_to_a_report_that_is_not_kept_has_expired(new_host: New) -> None:
    host = new_host(device=board())
    host.arm(schema.PACED_BY_DEVICE, parts=schema.WITH_LINE)
    for _ in range(40):
        host.sample_passes()
    force_with(host, 40 - 31, 1, time_to_live=255)
    force_with(host, 40 - 32, 1, time_to_live=255)
    accepted, _, _, expired, _ = counters(host)
    assert (accepted, expired) == (1, 1)


def test_noise_is_measured_anew_in_each_local_period_and_a_run_repeats(new_host: New) -> None:
    heard = []
    for _ in range(2):
        host = new_host(device=board(), mock={"noise": 1e-6})
        heard.append([host.arm(parts=schema.WITH_LINE), *(force_with(host, n, 0, k=500, b=9) for n in range(50))])
    assert heard[0] == heard[1]
    x = [frames[-1].counts[0] for frames in heard[0]]
    assert len(set(x)) > 40


def test_what_releases_ends_the_forces_under_way(new_host: New) -> None:
    for end in ("disarm", "watchdog"):
        host = new_host(device=board(board_delay=7))
        host.arm(schema.PACED_BY_DEVICE, watchdog=2, parts=schema.WITH_LINE)
        force_with(host, 0, 1000)
        host.sample_passes()
        host.sample_passes()
        assert set(pushed(host)) == {1000}
        if end == "disarm":
            host.disarm()
        else:
            host.sample_passes()
            host.check_watchdog()
        assert host.state == {"disarm": schema.IDLE, "watchdog": schema.LATCHED}[end]
        assert set(pushed(host)) == {0}
