"""The mock on a pseudo-terminal and on plain descriptors, served in real time. No test here measures time: where one
waits, it is for something that must come, and a minute's wait is a failure.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import serial

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, frame_to_device
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.firmware import prepare
from hapsim.device.mock.terminal import new_service, serve, serving
from hapsim.loop.transport import descriptor_transport

DEVICE, HOST, LOCKSTEP = schema.PACED_BY_DEVICE, schema.PACED_BY_HOST, schema.LOCKSTEP
PATIENCE_S = 60.0

New = Callable[..., Any]


class Client:
    """A plain pyserial program: opens the port, writes frames, reads up to the next zero."""

    def __init__(self, path: str, host: Any) -> None:
        self.port = serial.Serial(path, 115200, timeout=PATIENCE_S, write_timeout=PATIENCE_S)
        self.host = host  # makes and reads frames; its own mock is not the one that is served

    def write(self, frame: bytes) -> None:
        self.port.write(frame)

    def read(self) -> Any:
        data = self.port.read_until(b"\0")
        assert data.endswith(b"\0"), "the mock did not answer within a minute"
        (frame,) = self.host.read(np.frombuffer(data, np.uint8))
        return frame

    def ask(self, frame: bytes) -> Any:
        self.write(frame)
        return self.read()

    def register(self, number: int) -> int:
        answer = self.ask(self.host.frame(schema.DESCRIBE, number, 0, [0], armed=False))
        assert (answer.type, answer.number) == (schema.DESCRIPTION, number)
        return int(answer.word)

    def close(self) -> None:
        self.port.close()


@pytest.fixture
def open_client(new_host: New) -> Iterator[Callable[..., Client]]:
    with contextlib.ExitStack() as stack:

        def open_it(path: str, channels: int = 1) -> Client:
            return stack.enter_context(contextlib.closing(Client(path, new_host(channels))))

        yield open_it


def lockstep(client: Client, samples: int) -> list[Any]:
    heard = [client.ask(client.host.arm_frame()), client.read()]
    heard += [client.ask(client.host.force_frame(n, [(n % 7 - 3) * 2**27] * 16)) for n in range(samples)]
    return [*heard, client.ask(client.host.disarm_frame())]


@pytest.mark.parametrize("channels", [1, 4])
def test_a_plain_serial_program_describes_arms_exchanges_and_disarms(
    new_scene: New, new_host: New, open_client: Callable[..., Client], channels: int
) -> None:
    scene = new_scene(channels, mock={"initial": {"velocity": 0.1}})
    with serving(assemble_mock(scene)) as path:
        client = open_client(path, channels)
        assert client.register(schema.REG_VERSION) == schema.VERSION
        assert client.register(schema.REG_SCHEMA) == schema.SCHEMA_HASH
        assert client.register(schema.REG_CHANNELS) == channels
        heard = lockstep(client, 100)
        assert client.register(schema.REG_ACCEPTED) == 100
        assert client.register(schema.REG_REJECTED) == 0
        assert client.host.misread == 0
    by_hand = new_host(channels, mock={"initial": {"velocity": 0.1}})
    expected = by_hand.arm()
    for n in range(100):
        expected += by_hand.force(n, [(n % 7 - 3) * 2**27] * 16)
    assert heard == [*expected, *by_hand.disarm()]


def test_nothing_is_echoed_even_to_a_program_that_sets_nothing(new_scene: New, new_host: New) -> None:
    """The first bytes hold what a terminal that is not raw would eat or turn into something else."""
    host = new_host()
    with serving(assemble_mock(new_scene())) as path:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            # 3, 4, 10, 13, 17, 19, 26, 28: interrupt, end of file, line ends, flow control, suspend, quit.
            registers = [3, 4, 10, 13, 17, 19, 26, 28, 127]
            os.write(descriptor, b"\x03\x04\n\r\x11\x13\x1a\x1c\x7f\xff\0")
            os.write(descriptor, b"".join(host.frame(schema.DESCRIBE, number, 0, [0]) for number in registers))
            wanted = len(registers) * schema.frame_bytes(1, to_device=False)
            data = b""
            while len(data) < wanted:
                assert select.select([descriptor], [], [], PATIENCE_S)[0]
                data += os.read(descriptor, wanted)
            heard = host.read(np.frombuffer(data, np.uint8))
        finally:
            os.close(descriptor)
    assert [frame.number for frame in heard] == registers
    assert host.misread == 0


def test_the_mock_survives_that_its_client_goes_and_comes_back(
    new_scene: New, open_client: Callable[..., Client]
) -> None:
    with serving(assemble_mock(new_scene(mock={"noise": 1e-6}))) as path:
        runs = []
        for _ in range(3):
            client = open_client(path)
            runs.append(lockstep(client, 20))
            client.close()
        assert runs[0] == runs[1] == runs[2]


def test_the_mock_survives_a_client_that_leaves_in_the_middle_of_a_run(
    new_scene: New, open_client: Callable[..., Client]
) -> None:
    with serving(assemble_mock(new_scene(4))) as path:
        client = open_client(path, 4)
        assert client.ask(client.host.arm_frame()).state == schema.ARMED
        client.write(client.host.force_frame(0, [2**30] * 4)[:9])
        client.close()
        again = open_client(path, 4)
        again.write(again.host.disarm_frame(armed=True))  # behind half a frame, which has no end of its own
        while (frame := again.read()).type != schema.STATUS:
            pass
        assert frame.state == schema.IDLE
        assert again.register(schema.REG_VERSION) == schema.VERSION
        assert lockstep(again, 20)[-1].state == schema.IDLE


def test_paced_by_the_device_positions_come_by_themselves_until_the_watchdog_latches(
    new_scene: New, open_client: Callable[..., Client]
) -> None:
    with serving(assemble_mock(new_scene())) as path:
        client = open_client(path)
        assert client.ask(client.host.arm_frame(DEVICE, watchdog=8)).state == schema.ARMED
        heard = [client.read() for _ in range(10)]
        assert [(frame.type, frame.number) for frame in heard[:-1]] == [
            (schema.POSITION, 0),
            *[(schema.POSITION_HELD, n) for n in range(1, 9)],
        ]
        assert (heard[-1].type, heard[-1].state, heard[-1].fault) == (schema.STATUS, schema.LATCHED, schema.HOST_QUIET)
        assert client.register(schema.REG_FAULT) == schema.HOST_QUIET


def test_a_flood_whose_answers_are_not_read_is_survived(
    new_scene: New, new_host: New, open_client: Callable[..., Client]
) -> None:
    host = new_host()
    with serving(assemble_mock(new_scene())) as path:
        client = open_client(path)
        # 60 kB: the answers fill the pseudo-terminal, and what is beyond is lost.
        client.write(host.frame(schema.DESCRIBE, schema.REG_SCHEMA, 0, [0]) * 5000)
        client.port.timeout = 0.5
        version = host.frame(schema.DESCRIBE, schema.REG_VERSION, 0, [0])
        for _ in range(int(PATIENCE_S)):
            client.write(version)
            heard = host.read(np.frombuffer(client.port.read(65536), np.uint8))
            if (schema.DESCRIPTION, schema.REG_VERSION, (schema.VERSION,)) in heard:
                return
        pytest.fail("the mock does not answer any more")


# Stopping.


def ends(action: Callable[[], object]) -> bool:
    """Returns whether `action` ends, on a thread of its own."""
    thread = threading.Thread(target=action, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    return not thread.is_alive()


@pytest.mark.parametrize("pacing", [None, DEVICE, HOST, LOCKSTEP])
def test_the_mock_stops_when_asked_to_whatever_it_is_doing(
    new_scene: New, open_client: Callable[..., Client], pacing: int | None
) -> None:
    def serve_and_leave() -> None:
        with serving(assemble_mock(new_scene(rate=20000.0))) as path:
            client = open_client(path)
            assert client.register(schema.REG_VERSION) == schema.VERSION
            if pacing is not None:
                client.ask(client.host.arm_frame(pacing, watchdog=2000))
        paths.append(path)

    paths: list[str] = []
    assert ends(serve_and_leave)
    assert paths
    assert not [thread for thread in threading.enumerate() if thread.name == "mock device"]


def test_no_descriptor_is_left_open(new_scene: New) -> None:
    before = os.listdir("/proc/self/fd")
    for _ in range(3):
        with serving(assemble_mock(new_scene())) as path:
            assert os.path.exists(path)
    assert len(os.listdir("/proc/self/fd")) <= len(before)


def test_an_error_of_the_program_stops_the_mock_too(new_scene: New) -> None:
    with pytest.raises(ZeroDivisionError), serving(assemble_mock(new_scene())):
        raise ZeroDivisionError
    assert not [thread for thread in threading.enumerate() if thread.name == "mock device"]


# Any descriptor.


@contextlib.contextmanager
def served(mock: Any) -> Iterator[tuple[socket.socket, Any, threading.Thread]]:
    """The host's end of a pair of sockets, the service and its thread."""
    near, far = socket.socketpair()
    near.setblocking(False)
    far.settimeout(PATIENCE_S)
    prepare(mock)
    transport = descriptor_transport(near.fileno())
    service = new_service(transport)
    thread = threading.Thread(target=serve, args=(mock, service))
    thread.start()
    try:
        yield far, service, thread
    finally:
        service.stop = 1
        thread.join(PATIENCE_S)
        near.close()
        far.close()


def test_a_terminal_that_hangs_up_is_waited_at_until_the_mock_is_asked_to_stop(new_scene: New) -> None:
    with served(assemble_mock(new_scene())) as (far, service, thread):
        far.sendall(frame_to_device(SETUP, schema.DESCRIBE, 0, 0, np.zeros(1, np.int64)))
        assert far.recv(100).endswith(b"\0")
        far.close()
        thread.join(0.1)
        assert thread.is_alive()
        service.stop = 1
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
