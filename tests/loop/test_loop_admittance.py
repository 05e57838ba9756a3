"""The loop in admittance: the mass that it simulates, what it commands, and where the mass stands still."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
from loop_rig import frame, scripted, served

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.description import Servo
from hapsim.compiling.native import address_of
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.hooks import TICK
from hapsim.loop.simulated_mass import ADMITTANCE, advance_masses, place_masses, write_commands
from hapsim.running import run
from tests.admittance_scenes import scene_of, written_out

SPRING = {"touch": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 500.0, "damping": 0.5}}
SERVO = {"bandwidth": 80.0, "damping": 0.7}


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(
    ("device", "hand"),
    [
        ({"delay": 0.0}, {"damping": 1.0}),
        ({"delay": 1.0}, {"force": 0.5, "position": 2e-4}),
        ({"delay": 2.4, "simulated_damping": 8.0}, {"damping": 0.5}),
        ({"delay": 1.0, "servo": SERVO, "simulated_damping": 20.0}, {"mass": 0.02}),
        ({"delay": 0.3, "servo": SERVO, "simulated_damping": 20.0}, {"damping": 1.0}),
    ],
)
@pytest.mark.parametrize("links", [{}, SPRING], ids=["alone", "spring"])
def test_the_device_moves_as_the_loop_written_out(device: Any, hand: Any, links: Any) -> None:
    """To a few roundings of the positions: 1e-9 m, of which the hand makes 2e-6 N."""
    scene = scene_of(links, device=device, hand=hand)
    trace = run(scene, duration=0.3, unstable=True)
    own = {"stiffness": 500.0, "damping": 0.5} if links else {}
    expected = written_out(scene, trace.sample.size, **own)
    assert np.ptp(expected["position"]) > 5e-4
    np.testing.assert_allclose(trace.position[:, 0], expected["position"], atol=5e-9, rtol=0)
    np.testing.assert_allclose(trace.command[:, 0], expected["command"], atol=5e-9, rtol=0)
    far = 5e-9 * (2000.0 + 4e6 * hand.get("mass", 0.0) + 2e3 * hand.get("damping", 0.0))
    np.testing.assert_allclose(trace.sensed["hand_force"][:, 0], expected["hand_force"], atol=far, rtol=0)


def ticked(*ticks: dict[str, int]) -> tuple[list[float], list[float]]:
    """Returns the place of the mass at each tick, and its commands, if 1 N pushes it: T²/M = 1 m/N, no damping. The
    device goes on for 10 samples, and then brakes by 1 m in a sample, each sample."""
    own, io, tick = new_record(ADMITTANCE), new_record(IO_BUFFER), new_record(TICK)
    tick.address, tick.io = address_of(tick), address_of(io)
    io.address, io.channels = tick.io, 1
    io.payload = int(tick.io) + IO_BUFFER.fields["command_payload"][1]
    io.position_scale[0], io.force_scale[0], own.mobility[0] = 1.0, 1.0, 1.0
    io.hand_force[0] = 1.0
    own.lives, own.braking[0] = 10, 1.0
    places, commands = [], []
    for number, one in enumerate(ticks):
        tick.number, tick.gap, tick.unsent, tick.withheld = number, 1, 0, 0
        for name, value in one.items():
            tick[name] = value
        io.measured[0] = 0.0
        for hook in (place_masses, advance_masses, write_commands):
            assert _call(hook, address_of(own), tick.address) == 0
        places.append(float(io.measured[0]))
        commands.append(float(io.command_counts[0]))
    return places, commands


def _call(hook: Any, own: int, tick: int) -> int:
    return int(ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_uint64, ctypes.c_uint64)(hook.address())(own, tick))


def test_the_mass_advances_with_each_command_that_leaves() -> None:
    assert ticked({}, {}, {}, {}) == ([0.0, 1.0, 3.0, 6.0], [1.0, 3.0, 6.0, 10.0])


def test_after_a_command_that_never_left_it_goes_on_at_its_speed_as_the_device_does() -> None:
    assert ticked({}, {}, {"unsent": 1}, {}) == ([0.0, 1.0, 2.0, 4.0], [1.0, 3.0, 4.0, 7.0])


def test_over_lost_positions_it_goes_on_at_the_speed_of_the_last_commands() -> None:
    assert ticked({}, {}, {"gap": 5}, {}) == ([0.0, 1.0, 11.0, 14.0], [1.0, 3.0, 14.0, 18.0])


def test_once_the_time_to_live_is_over_it_brakes_as_the_device_does() -> None:
    assert ticked({}, {}, {"gap": 11}, {}) == ([0.0, 1.0, 22.0, 24.0], [1.0, 3.0, 24.0, 27.0])
    assert ticked({}, {}, {"gap": 40}, {}) == ([0.0, 1.0, 22.0, 23.0], [1.0, 3.0, 23.0, 25.0])


def test_answers_that_never_left_do_not_prolong_the_time_to_live() -> None:
    late = {"gap": 6, "unsent": 1}
    assert ticked({}, {}, {"gap": 6}, late) == ([0.0, 1.0, 13.0, 22.0], [1.0, 3.0, 16.0, 23.0])


def test_a_position_too_late_for_an_answer_lets_it_begin_anew_at_rest_where_the_device_is() -> None:
    assert ticked({}, {}, {"withheld": 1}, {}) == ([0.0, 1.0, 0.0, 1.0], [1.0, 3.0, 1.0, 3.0])


def test_a_force_frame_has_zeros_for_forces_and_counts_of_the_device_s_zero_for_commands() -> None:
    """1000 counts of 1e-3 N push 0.2 kg for 1 ms: 5 counts of 1e-6 m."""
    sensed = {"hand_force_scale": (1e-3,), "hand_force_range": (10.0,), "sensors": 0b10010}
    servo = Servo((1.0,), (100.0,), (0.0,), (1.0,))
    script = [frame(n, 70_000, hand_force=(1000,)) for n in range(3)]
    scene = scene_of(device={"origin": 0.05, "simulated_damping": 0.0, "speed_limit": 1.0})
    with scripted(script, scene=scene, servo=servo, **sensed) as (there, device):
        trace = run(there, duration=0.003, unstable=True)
    assert [one.argument for one in device.arms] == [
        schema.LOCKSTEP | schema.WITH_FORCE | schema.WITH_COMMANDS,
    ]
    assert [one.counts for one in device.forces] == [(0, 70_005), (0, 70_015), (0, 70_030)]
    assert [one.counts for one in device.farewells] == [(0, 0)]
    np.testing.assert_allclose(trace.command[:, 0], [0.020005, 0.020015, 0.02003], rtol=1e-12)
    np.testing.assert_allclose(trace.sensed["hand_force"][:, 0], 1.0, rtol=1e-12)


@pytest.mark.parametrize("way", ["paced", "terminal"])
def test_it_is_the_same_loop_in_real_time_and_over_a_terminal(way: str) -> None:
    """The mock in memory waits for a host that is late; over a terminal time is virtual."""
    if way == "paced":
        scene = scene_of(device={"clock": "device"})
        trace = run(scene, duration=0.1, transport="paced", unstable=True)
    else:
        scene = scene_of()
        with served(scene) as (there, _):
            trace = run(there, duration=0.1, unstable=True)
    expected = written_out(scene, trace.sample.size)
    np.testing.assert_allclose(trace.position[:, 0], expected["position"], atol=5e-9, rtol=0)
    np.testing.assert_allclose(trace.position[2:, 0], trace.command[:-2, 0], atol=1e-12, rtol=0)
