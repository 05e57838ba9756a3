"""Virtual time does not depend on the transport, the machine, or earlier runs. Each transport reports a port that is
quiet, gone or full."""

from __future__ import annotations

import contextlib
import os
import tty
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import serial
from loop_rig import require_same, scene_of, served

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, frame_to_device, frame_to_host
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.record import INPUT_BYTES
from hapsim.device.mock.wire import loopback_transport
from hapsim.loop.endings import FAILED, HUNG_UP, TIMED_OUT
from hapsim.loop.portable import PortableTransport
from hapsim.loop.transport import Transport, descriptor_transport
from hapsim.running import Excitation, PeriodicExcitation, run, start

DEVICES: list[dict[str, Any]] = [
    {"delay": 1, "hold": "zoh", "sampling": "ideal"},
    {"delay": 0, "hold": "impulse", "sampling": "ideal"},
    {"delay": 2.4, "hold": "zoh", "sampling": "average", "force_limit": 0.5},
    {"sensed": True},
]


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("channels", [1, 16])
@pytest.mark.parametrize("device", DEVICES)
def test_loopback_and_pseudo_terminal_give_the_same_trace_bit_for_bit(channels: int, device: dict[str, Any]) -> None:
    damper = "sensed" if device.get("sensed") else "backward"
    device = {name: value for name, value in device.items() if name != "sensed"}
    scene = scene_of(channels, damper=damper, device=device, mock={"noise": 1e-7, "seed": 3})
    in_memory = run(scene, duration=0.3, transport="loopback")
    on_terminal = run(scene, duration=0.3, transport="terminal")
    assert in_memory.sample.tolist() == list(range(300))
    assert np.any(in_memory.force_counts[-1] != 0)
    require_same(in_memory, on_terminal)


def test_a_second_run_on_the_same_served_mock_gives_the_same_trace() -> None:
    with served(scene_of(2, mock={"noise": 1e-6})) as (scene, _):
        first, second, third = (run(scene, duration=0.2) for _ in range(3))
    require_same(first, second)
    require_same(first, third)
    require_same(first, run(scene_of(2, mock={"noise": 1e-6}), duration=0.2))


def test_the_answer_is_what_the_scene_asks_for_rounded_to_a_count() -> None:
    trace = run(scene_of(3), duration=0.2)
    np.testing.assert_allclose(trace.force, trace.asked_force, rtol=0, atol=0.5 * trace.force_scale.max())
    displaced = trace.position - 0.0
    expected = -1000.0 * displaced[1:, 0] - 2.0 * 1000.0 * np.diff(displaced[:, 0])
    np.testing.assert_allclose(trace.asked_force[1:, 0], expected, rtol=0, atol=1e-12)


def test_an_excitation_adds_to_its_channel_only_and_not_to_what_the_scene_asked() -> None:
    pushes = Excitation(channel=1, force=2.0, ticks=3, every=50, start=100, first=True)
    scene = scene_of(2, stiffness=0.0, damping=0.0)
    trace = run(scene, duration=0.2, excitation=pushes)
    pushed = trace.force[:, 1]
    assert np.flatnonzero(pushed).tolist() == [0, 1, 2, 100, 101, 102, 150, 151, 152]
    np.testing.assert_allclose(pushed[:3], 2.0, atol=1e-8)
    assert pushed[100] * pushed[150] < 0
    assert np.all(np.abs(pushed[100:]) <= 2.0 + trace.force_scale[1])
    assert not trace.force[:, 0].any()
    assert not trace.asked_force.any()


@pytest.mark.parametrize("portable", [False, True])
def test_a_periodic_excitation_begins_again_by_the_device_s_count_of_samples(portable: bool) -> None:
    forces = np.array([0.5, -0.25, 0.125, 1.0, -2.0])
    scene = scene_of(2, stiffness=300.0, damping=1.0)
    trace = run(
        scene,
        duration=0.1,
        excitation=PeriodicExcitation(1, forces),
        portable=portable,
        transport="terminal" if portable else "auto",
    )
    added = trace.force - trace.asked_force
    np.testing.assert_allclose(added[:, 1], forces[trace.sample % 5], rtol=0, atol=0.5 * trace.force_scale[1])
    np.testing.assert_allclose(added[:, 0], 0.0, rtol=0, atol=0.5 * trace.force_scale[0])


@pytest.mark.parametrize("forces", [[], [[1.0]], [np.nan]])
def test_a_periodic_excitation_is_a_row_of_finite_numbers(forces: list[float]) -> None:
    with pytest.raises(ValueError, match=r"forces: found shape .* expected finite numbers in one row"):
        PeriodicExcitation(0, np.array(forces))


@pytest.mark.parametrize(("channels", "transport"), [(1, "terminal"), (4, "terminal"), (2, "loopback")])
def test_the_portable_loop_sends_the_forces_of_the_compiled_one(channels: int, transport: Any) -> None:
    push = Excitation(channel=0, force=1.0, ticks=3, every=40, start=10, first=True)
    scene = scene_of(channels, damper="centred", mock={"noise": 1e-6})
    options = {"duration": 0.2, "transport": transport, "excitation": push}
    compiled, portable = (run(scene, portable=one, **options) for one in (False, True))
    require_same(portable, compiled)
    assert (portable.report.ending, portable.report.crc_errors) == ("done", 0)
    assert portable.report.virtual_time
    assert portable.statistics.age == compiled.statistics.age


@pytest.mark.parametrize("clock", ["device", "host"])
def test_the_portable_loop_runs_in_real_time_by_either_clock(clock: str) -> None:
    """At a rate at which neither the device's watchdog nor the loop's patience ends within a second: a busy machine."""
    trace = run(scene_of(rate=10.0, device={"clock": clock}), duration=0.3, portable=True)
    report = trace.report
    assert report.ending == "done"
    assert report.ticks + report.lost_frames >= 3 or report.duration_s > 0.3  # what ends a run, and nothing else
    assert trace.statistics.lateness.total > 0
    assert trace.statistics.exchange.total > 0


def test_parameters_of_the_portable_loop_are_live_too() -> None:
    with start(scene_of(mock={"noise": 1e-4}), transport="terminal", portable=True) as session:
        session.set({"touch0": {"stiffness": 100.0, "damping": 0.0}}, over=0.005)
        taken = session._loop.program.record.parameters
        while not session.wait(0.01):
            if int(taken.sets) == 1 and int(taken.left) == 0:
                session.stop()
    trace = session.trace
    np.testing.assert_allclose(trace.asked_force[-1], -100.0 * trace.position[-1], rtol=1e-9)


MEGABYTE = bytes(1 << 20)  # more than any unread line holds


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """(the device's end of a pseudo-terminal, the host's)"""
    near, far = os.openpty()
    for end in (near, far):
        tty.setraw(end)
        os.set_blocking(end, False)
    yield near, far
    for end in (near, far):
        with contextlib.suppress(OSError):
            os.close(end)


class Portable(PortableTransport):
    """The same line, as pyserial has it open; it gives up sooner."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(serial.Serial(os.ttyname(descriptor), timeout=0, write_timeout=0.1))


OverTerminal = type[Portable] | Callable[[int], Transport]
both = pytest.mark.parametrize("over", [descriptor_transport, Portable], ids=["descriptor", "portable"])


@both
def test_bytes_over_a_port_arrive_as_they_are_in_both_directions(terminal: tuple[int, int], over: OverTerminal) -> None:
    near, far = terminal
    transport, buffer, every = over(far), np.zeros(300, np.uint8), bytes(range(256))
    assert transport.send(every) == 0
    assert os.read(near, 1000) == every
    os.write(near, every)
    assert transport.receive(buffer, 10**9) == 256
    assert buffer[:256].tobytes() == every
    assert not buffer[256:].any()


@both
def test_bytes_beyond_the_room_come_the_next_time(terminal: tuple[int, int], over: OverTerminal) -> None:
    near, far = terminal
    transport, buffer = over(far), np.full(10, 99, np.uint8)
    os.write(near, bytes(range(15)))
    assert transport.receive(buffer[:8], 10**9) == 8
    assert buffer.tolist() == [*range(8), 99, 99]
    assert transport.receive(buffer, 10**9) == 7
    assert buffer[:7].tolist() == list(range(8, 15))


@both
@pytest.mark.parametrize("timeout_ns", [0, -1, -(10**18), 1000])
def test_a_quiet_port_times_out_and_is_read_later(
    terminal: tuple[int, int], over: OverTerminal, timeout_ns: int
) -> None:
    near, far = terminal
    transport, buffer = over(far), np.zeros(8, np.uint8)
    assert transport.receive(buffer, timeout_ns) == TIMED_OUT
    os.write(near, b"x")
    assert transport.receive(buffer, 10**9) == 1


@both
def test_a_port_whose_other_side_is_gone_has_hung_up(terminal: tuple[int, int], over: OverTerminal) -> None:
    near, far = terminal
    transport, buffer = over(far), np.zeros(8, np.uint8)
    os.close(near)
    assert transport.receive(buffer, 10**9) == HUNG_UP
    assert transport.receive(buffer, 0) == HUNG_UP
    assert transport.send(b"x") == HUNG_UP


@both
def test_a_port_that_takes_nothing_any_more_has_failed(terminal: tuple[int, int], over: OverTerminal) -> None:
    transport = over(terminal[1])
    assert transport.send(MEGABYTE) == FAILED


def test_a_descriptor_that_is_none_has_failed() -> None:
    transport = descriptor_transport(1_000_000)
    assert transport.receive(np.zeros(8, np.uint8), 10**9) == FAILED
    assert transport.send(b"x") == HUNG_UP


def test_memory_is_quiet_until_the_mock_was_asked_and_takes_no_more_than_the_mock_at_once() -> None:
    transport, buffer = loopback_transport(assemble_mock(scene_of())), np.zeros(1000, np.uint8)
    assert transport.receive(buffer, 10**9) == TIMED_OUT
    question = frame_to_device(SETUP, schema.DESCRIBE, schema.REG_VERSION, 0, [0])
    answer = frame_to_host(SETUP, schema.DESCRIPTION, schema.REG_VERSION, [schema.VERSION])
    assert transport.send(question * 2) == 0
    assert transport.receive(buffer[:5], 0) == 5
    assert transport.receive(buffer[5:], 0) == 2 * len(answer) - 5
    assert buffer[: 2 * len(answer)].tobytes() == 2 * answer
    assert transport.receive(buffer, 0) == TIMED_OUT
    assert transport.send(bytes(INPUT_BYTES + 1)) == FAILED
    assert transport.send(bytes(INPUT_BYTES)) == 0
