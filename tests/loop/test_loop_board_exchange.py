"""Lines through a whole exchange: from a position's frame to the line in the row and on the wire, past the guards."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from board_device import RATE, STEPS, BoardDevice, Line, force_of, scene_with
from loop_rig import arrive, assembled

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import frame_bytes, frame_to_host
from firmware_protocol.lines import LARGEST_BOUND, Lines, line_units, lines_of, pack_line
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.errors import UsageError
from hapsim.loop.compiled_loop import RECEIVED
from hapsim.loop.guards.energy_guard import ENERGY_EXCEEDED
from hapsim.loop.guards.sign import WRONG_SIGN
from hapsim.loop.portable import _on_force_sent as on_force_sent
from hapsim.loop.ring import FADED, LINE, SLEWED, WITHHELD
from hapsim.running.recorded_run import prediction_of
from hapsim.running.requirements import require_compatible
from hapsim.running.session_options import Excitation, RunOptions
from hapsim.scene import Scene

COUNT, NEWTON, MOST = 1e-9, 1e-6, 20.0  # m, N, and N: the device's force limit, twice the scene's
SHIFTS = (8, 8)
SPRING = {"touch": {"type": "viscoelastic", "stiffness": 2000, "damping": 5}}


def lines(window: int = STEPS) -> Lines:
    units = line_units(NEWTON / COUNT, window / (STEPS * RATE))
    return lines_of((STEPS, 1, window, 32), [units], [SHIFTS], [(32767, 65535)])


class EndedError(Exception):
    """A guard ended the loop, with this code."""


class Host:
    """A loop whose device is asked by hand."""

    def __init__(self, scene: Scene, options: RunOptions | None = None, is_port: bool = False, **more: Any) -> None:
        scales = {"position_scale": (COUNT,), "force_scale": (NEWTON,), "force_limit": (MOST,), "lines": lines()} | more
        self.loop, self.lines = assembled(scene, options=options, is_port=is_port, **scales), scales["lines"]
        self.number = -1

    def answer(self, x: float, *, kind: int = schema.POSITION, gap: int = 1, after_ms: float = 0.0) -> Line:
        """Returns the line that answers a position, from its row, and requires the frame to carry the same."""
        self.number += gap
        loop, now = self.loop, 10**9 + self.number * 10**6
        io, wire = loop.record.io, loop.wire
        data = frame_to_host(wire, kind, self.number % schema.SAMPLE_MODULUS, [round(x / COUNT)])
        if (code := arrive(loop, data, now + round(after_ms * 1e6))) != RECEIVED:
            raise EndedError(code)
        sent = bytes(io.outbox[int(io.sent.at) :][: frame_bytes(wire, to_device=True)])
        (force,) = frames_in(new_decoder(wire, to_device=True), sent)
        on_force_sent(loop.record, now)
        (self.row,) = loop.ring.drain()
        counts = [int(self.row[name][0]) for name in LINE]
        assert list(force.counts) == [int(self.row["force_counts"][0]), *pack_line(*counts)]
        of, unit = self.lines, MOST / LARGEST_BOUND
        scales = NEWTON, of.stiffness_scale[0], of.damping_scale[0], unit, unit
        return tuple(n * scale for n, scale in zip((self.row["force_counts"][0], *counts), scales, strict=True))


@pytest.mark.parametrize("delay", [1, 5])
def test_a_spring_to_a_ground_is_the_board_s_own_loop_whatever_the_delay_of_the_host(delay: int) -> None:
    host = Host(scene_with(SPRING, device={"delay": delay}))
    followed, alone = (BoardDevice(0.0, 0.1, friction=1.0, delay=delay) for _ in range(2))
    for _ in range(300):
        followed.sample(host.answer)
        alone.sample(lambda x: (-2000.0 * x, 2000.0, 5.0, -10.0, 10.0))
    assert followed.x == pytest.approx(alone.x, abs=3e-8)


@pytest.mark.parametrize("delay", [1, 2])
def test_the_force_of_a_sample_is_that_of_its_line_at_the_middle_of_the_sample(delay: int) -> None:
    host = Host(scene_with(SPRING, device={"delay": delay, "force_limit": 1.0}))
    device, x, answers, acted = BoardDevice(0.0, 0.1, friction=1.0, delay=delay), [], [], []
    for _ in range(40):
        x.append(device.sample(lambda x: answers.append(host.answer(x)) or answers[-1]))
        acted.append(float(host.row["acted_force"][0]))
    limit = 1.0 - 1e-3
    for n in range(delay + 1, 40):
        line, way = answers[n - 1 - delay], x[n] - x[n - 1]
        middle = force_of(line, 0.5 * (x[n] + x[n - 1]) - x[n - 1 - delay], way * RATE)
        assert acted[n] == pytest.approx(middle, abs=3e-4), n
    assert max(map(abs, acted)) == pytest.approx(limit, abs=2e-3)


def test_after_a_late_line_the_one_before_acts_on_and_over_lost_positions_too() -> None:
    host, answers = Host(scene_with(SPRING)), {}
    places = {n: 1e-4 * n + 1e-6 * n * n for n in range(13)}
    for n, late, gap in [*((n, n == 6, 1) for n in range(9)), (12, False, 4)]:
        kind = schema.POSITION_HELD if late else schema.POSITION
        answers[n] = host.answer(places[n], kind=kind, gap=gap)
        if n in (6, 7):  # sent at 5, it should have acted from 6 on
            acts = {6: 4, 7: 4}[n]
            middle, way = 0.5 * (places[n] + places[n - 1]), places[n] - places[n - 1]
            wanted = force_of(answers[acts], middle - places[acts], way * RATE)
            assert host.row["acted_force"][0] == pytest.approx(wanted, abs=1e-5)
    way = (places[12] - places[8]) / 4.0  # the line that answered 8 acts until the next one comes
    wanted = force_of(answers[8], 3.5 * way, way * RATE)
    assert host.row["acted_force"][0] == pytest.approx(wanted, abs=1e-5)


def test_an_excitation_moves_the_line_and_its_bounds_and_the_limit_narrows_them() -> None:
    contact = {"touch": {"type": "buffer", "stiffness": 2000}}
    excitation = Excitation(channel=0, force=4.0, ticks=1, every=1000, start=0, first=True)
    host = Host(scene_with(contact), RunOptions(excitation=excitation))
    force, k, _, low, high = host.answer(-1e-3)
    assert (force, k) == pytest.approx((2.0 + 4.0, 2000.0))
    assert (low, high) == pytest.approx((4.0, 10.0), abs=1e-3)  # the contact's 0, moved by the push
    force, k, _, low, high = host.answer(-1e-3)
    assert (force, k, low, high) == pytest.approx((2.0, 2000.0, 0.0, 10.0), abs=1e-3)
    assert low == 0.0


def test_a_withheld_line_is_zero_in_every_number() -> None:
    host = Host(scene_with(SPRING, device={"clock": "device"}))
    host.answer(1e-3)
    for _ in range(3):
        line = host.answer(1e-3, after_ms=1000.0)
    assert int(host.row["flags"]) & WITHHELD
    assert line == (0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_soft_start_ramps_every_number_of_the_line() -> None:
    host = Host(scene_with(SPRING, device={"soft_start": 0.1}))
    for n in range(101):
        force, k, b, low, high = host.answer(1e-3)
        share = (n / 100.0) ** 2 * (3.0 - 2.0 * n / 100.0)
        assert force == pytest.approx(-2.0 * share, abs=1e-5)
        assert k == pytest.approx(2000.0 * share, abs=2.0)
        assert b == pytest.approx(5.0 * share, abs=3e-3)
        assert (low, high) == pytest.approx((-10.0 * share, 10.0 * share), abs=1e-3)
        assert bool(int(host.row["flags"]) & SLEWED) == (n < 100)


def test_outside_the_travel_every_number_of_the_line_fades() -> None:
    host = Host(scene_with(SPRING, device={"travel": [-0.05, 1e-3], "travel_margin": 0.02}))
    assert host.answer(1e-3)[1:3] == pytest.approx((2000.0, 5.0))
    force, k, b, low, high = host.answer(6e-3)
    assert int(host.row["flags"]) & FADED
    assert (force, k, b) == pytest.approx((-9.0, 1500.0, 3.75), rel=1e-3)
    assert (low, high) == pytest.approx((-7.5, 7.5), abs=1e-3)


def test_from_zero_the_slew_limit_opens_the_bounds_step_by_step_and_leaves_the_spring_as_it_is() -> None:
    host = Host(scene_with(SPRING, device={"slew_limit": 500.0, "soft_start": 0.0}))
    for n in range(1, 25):
        line = host.answer(1e-3 * n)
        most = min(0.5 * n, 10.0)
        assert line == pytest.approx((-2.0 * n, 2000.0, 5.0, -most, most), abs=2e-3)
        assert bool(int(host.row["flags"]) & SLEWED) == (n < 20)


def test_after_a_host_that_stalled_the_bounds_open_from_zero_again() -> None:
    host = Host(scene_with(SPRING, device={"slew_limit": 500.0, "soft_start": 0.0}))
    for _ in range(30):
        assert host.answer(1e-3)[:2] == pytest.approx((-2.0, 2000.0))
    for n in range(1, 4):
        line = host.answer(1e-3, kind=schema.POSITION_HELD, gap=60 if n == 1 else 1)
        assert line == pytest.approx((-2.0, 2000.0, 5.0, -0.5, 0.5), abs=2e-3)
    assert host.answer(1e-3)[3:] == pytest.approx((-1.0, 1.0), abs=2e-3)  # the one before has surely arrived


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("delay", [1, 5])
@pytest.mark.parametrize("lost", [0.0, 0.1])
def test_a_stiff_spring_swings_within_its_limit_as_far_as_without_a_slew_limit(delay: int, lost: float) -> None:
    """30 000 N/m: the force changes by up to 3.9 N in a sample. Bounds of a step around the force at the reported
    position made it swing by 20 mm."""
    swings = []
    for slew in (1e4, 1e12):
        host, chance = judged(30000.0, delay=delay, slew_limit=slew, soft_start=0.0), np.random.default_rng(1)
        device = BoardDevice(1e-3, 0.0, friction=1.0, window=1, delay=delay)
        kinds = np.where(chance.random(400) < lost, schema.POSITION_HELD, schema.POSITION)
        places = [device.sample(partial(host.answer, kind=int(kind))) for kind in kinds]
        swings.append(np.ptp(places[50:150]))
    assert swings[0] == pytest.approx(swings[1], rel=0.05)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("delay", [1, 3])
def test_from_line_to_line_no_force_changes_by_more_than_the_slew_limit(delay: int) -> None:
    """Random motions of a hand on a stiff corner. With bounds a step around the last force it changed by 1.9 steps."""
    corner = {"type": "nonlinear", "force_over_distance": [[-0.01, -100], [0, 0], [0.01, 5]]}
    scene = scene_with({"corner": corner}, device={"slew_limit": 500.0, "soft_start": 0.0, "delay": delay})
    host, chance, acts, x, v, most = Host(scene), np.random.default_rng(delay), [], 0.0, 0.0, 0.0
    for _ in range(1500):
        v += chance.normal() * 0.05 - 0.05 * v
        x += v / RATE - 0.01 * x
        acts.append((host.answer(x), x))
        if len(acts) > delay + 1:
            forces = [force_of(line, x - at, v) for line, at in acts[-delay - 2 : -delay]]
            most = max(most, abs(forces[1] - forces[0]))
    assert 0.4 < most < 0.502


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize(("lost", "largest"), [(0.01, 0.502), (0.1, 0.502), (0.5, 1.01)])
def test_on_a_wire_that_loses_frames_a_line_changes_the_force_by_no_more_than_the_slew_limit(
    delay: int, lost: float, largest: float
) -> None:
    """Both ways; of half, two steps. The device reports with the next position whether a line came. 21 samples after
    the position that the last one answers it is at zero."""
    corner = {"type": "nonlinear", "force_over_distance": [[-0.01, -100], [0, 0], [0.01, 5]]}
    host = Host(scene_with({"corner": corner}, device={"slew_limit": 500.0, "soft_start": 0.0, "delay": delay}))
    chance, x, v, gap, most, came = np.random.default_rng(delay + 1), 0.0, 0.0, 1, 0.0, True
    acting, due = ((0.0,) * 5, 0.0, -1), {}
    for n in range(800):
        v += chance.normal() * 0.05 - 0.05 * v
        x += v / RATE - 0.01 * x
        kind, came = schema.POSITION if came else schema.POSITION_HELD, False
        if chance.random() < lost:
            gap += 1
        else:
            answer, gap, came = host.answer(x, kind=kind, gap=gap), 1, bool(chance.random() >= lost)
            due |= {n + delay: (answer, x, n)} if came else {}
        before = force_of(acting[0], x - acting[1], v)
        is_zero = n - acting[2] > 20  # STABILITY.md names the step from there
        acting = due.pop(n, acting)
        most = most if is_zero else max(most, abs(force_of(acting[0], x - acting[1], v) - before))
    assert 0.3 < most < largest


def test_a_stiffness_beyond_the_board_s_saturates_and_is_counted() -> None:
    few = lines_of((STEPS, 1, STEPS, 32), [line_units(NEWTON / COUNT, 1e-3)], [SHIFTS], [(256, 65535)])
    host = Host(scene_with(SPRING), lines=few)
    assert host.answer(1e-3)[:2] == pytest.approx((-2.0, 1000.0))
    assert int(host.loop.record.board_law.saturated) == 1


def test_a_scene_that_contradicts_the_board_s_registers_is_refused_with_what_to_write() -> None:
    scene = scene_with(SPRING, device={"clock": "device"})
    of = describe_mock(scene)
    require_compatible(scene, "port", of)
    assert of.lines is not None
    other = replace(of, lines=replace(of.lines, steps=5, window=5))
    with pytest.raises(
        UsageError, match=r"found board_rate: 10000, board_window: 10, .* board_rate: 5000, board_window: 5: "
    ):
        require_compatible(scene, "port", other)


def test_the_prediction_of_a_record_is_of_the_line_as_the_device_gets_it() -> None:
    scene = scene_with(SPRING)
    of = describe_mock(scene)
    assert of.lines is not None
    coarse = replace(of, lines=replace(of.lines, damping_scale=(3.0,)))  # 6 N·s/m in place of 5
    felt = [prediction_of(scene, one)["device_points"]["hand"]["b"] for one in (of, coarse)]
    assert felt[1] - felt[0] == pytest.approx(1.0, abs=0.2)


def judged(stiffness: float, damping: float = 5.0, is_port: bool = False, **device: Any) -> Host:
    """A host with all guards, before a device with friction and a window of one local step."""
    link = {"type": "viscoelastic", "stiffness": stiffness, "damping": damping}
    scene = scene_with({"touch": link}, device={"friction": 1.0, "board_window": 1} | device)
    return Host(scene, RunOptions(judges_energy=True, judges_sign=True, unstable=True), is_port, lines=lines(1))


def _reversed(line: Line, ahead: float, speed: float) -> float:
    return -force_of(line, ahead, speed)


def _reversed_at_its_place(line: Line, ahead: float, speed: float) -> float:
    return force_of((-line[0], *line[1:]), ahead, speed)


@pytest.mark.parametrize("stiffness", [2000.0, 30000.0])
@pytest.mark.parametrize("delay", [1, 5])
def test_a_motor_that_is_wired_the_wrong_way_is_stopped_within_a_centimetre(stiffness: float, delay: int) -> None:
    for follows, found_by in ((force_of, 0), (_reversed, 25), (_reversed_at_its_place, 40)):
        is_wrong, host = found_by > 0, judged(stiffness, delay=delay)
        device = BoardDevice(1e-3, 0.0, friction=1.0, delay=delay, window=1, follows=follows)
        with pytest.raises(EndedError, match=str(WRONG_SIGN)) if is_wrong else contextlib.nullcontext():
            for _ in range(200):
                device.sample(host.answer)
        assert abs(device.x) < 0.01
        assert (host.number < found_by) == is_wrong


@pytest.mark.parametrize("follows", [_reversed, _reversed_at_its_place])
def test_behind_a_port_the_soft_start_lasts_until_a_stiff_spring_of_the_wrong_sign_is_found(follows: Any) -> None:
    host = judged(30000.0, is_port=True, clock="device")
    device = BoardDevice(1e-3, 0.0, friction=1.0, window=1, follows=follows)
    with pytest.raises(EndedError, match=str(WRONG_SIGN)):
        [device.sample(host.answer) for _ in range(64)]
    assert abs(device.x) < 0.002


@pytest.mark.parametrize(("stiffness", "is_stable"), [(38000.0, True), (45000.0, False)])
def test_a_swing_that_the_board_s_own_lag_drives_is_ended_and_none_that_dies_away(
    stiffness: float, is_stable: bool
) -> None:
    """Stable below 39 894 N/m."""
    host, device = judged(stiffness), BoardDevice(0.0, 0.05, friction=1.0, window=1)
    with contextlib.nullcontext() if is_stable else pytest.raises(EndedError, match=str(ENERGY_EXCEEDED)):
        for _ in range(800):
            device.sample(host.answer)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("delay", [1, 4])
@pytest.mark.parametrize(("damping", "is_passive"), [(0.31, True), (0.0, False)])
def test_a_hand_gets_no_energy_if_friction_and_damping_dissipate_that_of_the_board_s_lag(
    damping: float, is_passive: bool, delay: int
) -> None:
    """2000 N/m, a hold and a delay of 0.1 ms: 0.3 N·s/m."""
    host, chance = judged(2000.0, damping, friction=0.0, delay=delay, force_limit=1e3), np.random.default_rng(delay)
    most, ways = -1.0, chance.normal(0.0, 1e-5, 400) + 1e-4 * np.sin(0.5 * np.arange(400))
    for x in np.concatenate([[0.0] * 8, np.cumsum(ways)]):
        host.answer(float(x))
        most = max(most, *host.loop.record.energy_guard.given)
    assert (most <= 1e-9) == is_passive
