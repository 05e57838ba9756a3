"""Slew limit of the force, and its soft start."""

from __future__ import annotations

import contextlib
import itertools
import math
from typing import Any

import numpy as np
import pytest
from loop_rig import arrive, assembled, frame, scene_of, scripted, served
from plane_field import field_of, plane

from firmware_protocol import schema
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.ring import LATE_FORCE, SLEWED
from hapsim.prediction.force_bounds import force_bounds
from hapsim.recording.trace import Trace
from hapsim.running import Excitation, run

FORCE_SCALE, RATE = 1e-3, 1000.0


def limited_to(step: int, **device: Any) -> dict[str, Any]:
    """A device whose force may change by so many counts of an assembled loop in a sample."""
    return {"slew_limit": step * FORCE_SCALE * RATE, "soft_start": 0.0, **device}


def test_no_force_differs_by_more_than_a_step_from_the_one_before() -> None:
    scene = scene_of(2, device={"slew_limit": 40.0, "force_limit": 3.0}, mock={"initial": {"velocity": 0.6}})
    pushes = Excitation(channel=1, force=2.0, ticks=3, every=25, start=10, first=True)
    trace = run(scene, duration=0.5, excitation=pushes)
    step = math.floor(40.0 / RATE / trace.force_scale[0])
    moved = np.abs(np.diff(trace.force_counts.astype(np.int64), axis=0, prepend=0))
    assert moved.max() == step
    slewed = trace.flags & SLEWED > 0
    assert trace.report.slewed_ticks == np.count_nonzero(slewed)
    assert 0 < np.count_nonzero(slewed) < slewed.size
    at_once = np.clip(
        np.rint(trace.asked_force[:, 0] / trace.force_scale[0]),
        *(side * 3.0 / trace.force_scale[0] for side in (-1, 1)),
    )
    assert np.all(slewed[np.abs(trace.force_counts[:, 0] - at_once) > 1])


def test_a_force_that_is_slow_enough_is_sent_as_it_is() -> None:
    as_it_is = run(scene_of(2), duration=0.3)
    bounded = run(scene_of(2, device={"slew_limit": 1e4}), duration=0.3)
    assert bounded.report.slewed_ticks == 0
    np.testing.assert_array_equal(bounded.force_counts, as_it_is.force_counts)


@pytest.mark.parametrize(("position", "velocity"), [(0.004, 0.0), (0.004, -0.3), (-0.02, 0.5)])
def test_the_force_ramps_up_and_never_overshoots_what_is_asked(position: float, velocity: float) -> None:
    initial = {"initial": {"position": position, "velocity": velocity}}
    trace = run(scene_of(device={"soft_start": 0.05}, mock=initial), duration=0.2)
    asked = np.clip(trace.asked_force[:, 0], -10.0, 10.0)
    u = np.minimum(trace.sample / RATE / 0.05, 1.0)
    taken_off = asked[0] * (1.0 - u * u * (3.0 - 2.0 * u))
    wanted = np.clip(asked - taken_off, np.minimum(asked, 0.0), np.maximum(asked, 0.0))
    np.testing.assert_allclose(trace.force[:, 0], wanted, rtol=0, atol=1.6 * trace.force_scale[0])  # three roundings
    assert trace.force_counts[0, 0] == 0
    assert np.all(trace.force[:, 0] * asked >= 0.0)
    np.testing.assert_array_equal(
        trace.flags & SLEWED > 0, np.abs(trace.force[:, 0] - asked) > 0.6 * trace.force_scale[0]
    )
    assert trace.report.slewed_ticks > 0


def test_where_the_first_force_is_zero_a_soft_start_changes_nothing() -> None:
    soft = run(scene_of(2, device={"soft_start": 0.1}), duration=0.3)
    np.testing.assert_array_equal(soft.force_counts, run(scene_of(2), duration=0.3).force_counts)
    assert soft.report.slewed_ticks == 0


class Host:
    """A loop whose positions the test supplies, and whose forces leave or do not. On its spring of 1000 N/m
    a micrometre asks for a count of force."""

    def __init__(self, in_plane: bool = False, **device: Any) -> None:
        keys = {"clock": "device", "force_limit": 9.0, **device}
        with field_of(stiffness=1000.0) if in_plane else contextlib.nullcontext():
            self.loop = assembled(plane(keys) if in_plane else scene_of(damping=0.0, device=keys))

    def forces(self, number: int, *counts: int, late: bool = False, sends: bool = True) -> tuple[int, ...]:
        """The forces, in counts, that answer this position; in time by the clock."""
        kind = schema.POSITION_HELD if late else schema.POSITION
        now = 10**9 + number * 10**6
        assert arrive(self.loop, frame(number, *counts, kind=kind), now) == 1
        if sends:
            self.loop.state.sent_ns, self.loop.state.unanswered = now, 0
        return tuple(self.loop.record.io.force_counts[: len(counts)].tolist())

    def receives(self, number: int, counts: int, **how: bool) -> int:
        """The force of the one channel."""
        return self.forces(number, counts, **how)[0]


FAR = -5000  # um: 5 N, 5000 counts


def test_what_the_device_holds_is_what_left_whatever_was_worked_out_meanwhile() -> None:
    loop = Host(**limited_to(100))
    assert loop.receives(0, FAR) == 100
    assert [loop.receives(number, FAR, sends=False, late=number > 1) for number in (1, 2, 3)] == [200, 200, 200]
    assert loop.receives(4, -FAR, late=True, sends=False) == 0
    assert loop.receives(5, FAR, late=True) == 200
    assert loop.receives(6, FAR) == 300


def test_lost_positions_allow_no_more_than_a_step() -> None:
    loop = Host(**limited_to(100))
    assert loop.receives(0, FAR) == 100
    assert loop.receives(9, FAR, late=True) == 100  # it is unknown whether the first came: zero, or 100
    assert loop.receives(10, FAR) == 200


def test_a_missing_position_may_have_reported_that_a_force_came_late() -> None:
    loop = Host(**limited_to(100))
    assert loop.receives(0, FAR) == 100
    assert loop.receives(2, FAR) == 100
    assert loop.receives(3, FAR) == 200


class Device:
    """Device of PROTOCOL.md, section 6, that receives forces late or not at all; in order, as from a port."""

    def __init__(self, lives: int) -> None:
        self._lives, self._on_their_way, self._free = lives, list[tuple[int, int, int]](), 0
        self._pending, self._expires, self.out = 0, -1, 0

    def sent(self, number: int, force: int, late: int) -> None:
        """The answer to a position, which comes so many samples late."""
        self._free = max(self._free, number + late)
        self._on_their_way.append((self._free, number, force))

    def tick(self, now: int) -> bool:
        """The end of a sample; whether its own answer came."""
        heard = fresh = False
        while self._on_their_way and self._on_their_way[0][0] <= now:
            _, answered, force = self._on_their_way.pop(0)
            if now - answered <= self._lives:
                self._pending, self._expires = force, answered + self._lives
                heard, fresh = True, answered == now
        self.out = self._pending if heard else 0 if now > self._expires else self.out
        return fresh


def kinds_of_trouble(chance: np.random.Generator, kind: str) -> list[tuple[bool, int | None]]:
    """Returns, for each of some samples, whether the position arrives, and the delay of its answer (None: never)."""
    if kind == "lost":
        return [(True, None)] * int(chance.integers(1, 19))
    if kind == "held up":
        count = int(chance.integers(1, 19))
        return [(True, count - at) for at in range(count)]
    if kind == "positions":
        return [(False, None)] * int(chance.integers(1, 40))
    fates = [(True, 0), (True, 1), (True, None), (False, None)]
    return [fates[at] for at in chance.integers(0, 4, int(chance.integers(1, 18)))]


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("kind", ["lost", "held up", "positions", "mixed"])
@pytest.mark.parametrize("channels", [1, 2])
def test_what_the_device_puts_out_changes_by_no_more_than_a_step(kind: str, channels: int) -> None:
    """But to zero. Whatever happens on the wire for shorter than a force lives; missing positions for longer, too."""
    loop, chance = Host(channels == 2, **limited_to(70)), np.random.default_rng(1)
    devices = [Device(int(loop.loop.control.time_to_live)) for _ in range(channels)]
    trouble: list[tuple[bool, int | None]] = []
    late, moved = False, 0
    for number in range(1200):
        if not trouble:
            trouble = kinds_of_trouble(chance, kind) + [(True, 0)] * 3
        comes, answered = trouble.pop(0)
        if comes or number == 0:
            forces = loop.forces(number, *chance.integers(-300, 300, channels).tolist(), late=late)
            for device, force in zip(devices if answered is not None else (), forces, strict=False):
                device.sent(number, force, answered or 0)
        out = [device.out for device in devices]
        fresh = [device.tick(number) for device in devices]
        late = not all(fresh)
        for device, before in zip(devices, out, strict=True):
            assert device.out == 0 or abs(device.out - before) <= 70, number
            moved += device.out != before
    assert moved > 150 * channels


def test_where_the_device_may_be_at_zero_and_may_not_zero_leaves() -> None:
    """Forces live for two samples, as at 100 Hz: three that are lost leave the device at zero, four lates do not."""
    loop = Host(**limited_to(100))
    loop.loop.record.slew.lives = 2
    assert [loop.receives(number, FAR) for number in range(51)][-1] == 5000
    assert [loop.receives(number, FAR, late=number > 51) for number in range(51, 55)] == [5000, 5000, 5000, 0]


def test_where_every_force_is_late_a_slow_force_is_tracked() -> None:
    """A slow force is followed by a step in four samples, after a time to live in which every force is late."""
    loop = Host(**limited_to(100))
    asked = [round(5000 * math.sin(number / 500)) for number in range(3000)]
    sent = [loop.receives(number, um, late=number > 0) for number, um in enumerate(asked)]
    assert max(abs(force + um) for force, um in zip(sent[60:], asked[60:], strict=True)) <= 100
    assert max(abs(after - before) for before, after in itertools.pairwise(sent)) <= 100
    ramp = [loop.receives(3000 + number, -5000, late=True) for number in range(41)]
    assert abs(ramp[40] - ramp[0]) == 1000


def test_after_its_time_to_live_a_force_rises_from_zero_again() -> None:
    loop = Host(**limited_to(1000))
    assert [loop.receives(number, FAR) for number in range(6)] == [1000, 2000, 3000, 4000, 5000, 5000]
    lives = int(loop.loop.control.time_to_live)
    for number in range(6, 6 + lives):
        assert loop.receives(number, FAR, late=number > 6, sends=False) == 5000
    assert loop.receives(6 + lives, FAR, late=True, sends=False) == 5000
    assert loop.receives(7 + lives, FAR, late=True) == 1000


def test_the_way_to_zero_is_immediate() -> None:
    scene = scene_of(damping=0.0, device={"clock": "device", **limited_to(1000)})
    with scripted([frame(n, FAR) for n in range(8)], scene=scene) as (there, device):
        run(there, duration=0.008)
    sent = [heard.counts[0] for heard in device.forces]
    assert sent == [1000, 2000, 3000, 4000, *[5000] * (len(sent) - 4)]
    assert [list(farewell.counts) for farewell in device.farewells] == [[0]]


def test_a_port_has_a_slew_limit_and_a_soft_start_and_the_mock_has_none() -> None:
    for rate, slew in ((100.0, 1000.0), (1000.0, 10_000.0), (4000.0, 10_000.0)):
        bounds = force_bounds(scene_of(rate=rate), in_hand=True)
        assert bounds == (pytest.approx(slew), max(0.05, 64.0 / rate), pytest.approx(0.2))
    assert force_bounds(scene_of(), in_hand=False) == (math.inf, 0.0, math.inf)
    named = scene_of(device={"slew_limit": 5.0, "soft_start": 0.2, "energy_limit": 0.1})
    assert force_bounds(named, in_hand=False) == force_bounds(named, in_hand=True) == (5.0, 0.2, 0.1)


@pytest.mark.parametrize("clock", ["device", "host", "lockstep"])
def test_behind_a_port_the_first_force_is_soft_but_in_virtual_time(clock: str) -> None:
    with served(scene_of(device={"clock": clock}, mock={"initial": {"position": 0.003}})) as (scene, _):
        try:
            trace: Trace | None = run(scene, duration=0.02)
        except DeviceError as error:  # a machine that is held up for a tenth of a second
            trace = error.trace
    assert abs(trace.asked_force[0, 0]) > 1.0
    assert (trace.force_counts[0, 0] == 0) == bool(trace.flags[0] & SLEWED) == (clock != "lockstep")


def test_a_step_of_less_than_a_count_is_refused() -> None:
    with pytest.raises(UsageError, match=r"slew_limit: found 0.9 N/s, .* expected at least 1 N/s"):
        assembled(scene_of(device=limited_to(0, slew_limit=0.9)))


def test_the_forces_that_a_predictor_counts_are_those_that_were_sent() -> None:
    """It finds the hand where it will be: with other forces it would be off by what they would have moved it."""
    device = {"delay": 3.0, "correction": "predictor", "force_limit": 100.0}
    initial = {"initial": {"position": 0.01}, "quantum": 1e-10}
    trace = run(scene_of(device={**device, "slew_limit": 300.0}, mock=initial), duration=0.2)
    assert trace.report.slewed_ticks > 5
    assert not np.any(trace.flags & LATE_FORCE)
    stiffness = 1000.0
    velocity = np.gradient(trace.position[:, 0], 1.0 / RATE)
    ahead = -stiffness * trace.position[3:, 0] - 2.0 * velocity[3:]
    np.testing.assert_allclose(trace.asked_force[5:-3, 0], ahead[5:], rtol=0, atol=0.05 * np.max(np.abs(ahead)))
