"""Sockets in place of a serial port: the same run over them, the peer alone is answered, and what cannot be reached."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, frame_to_device
from hapsim.device.connection import describe
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.listening import listening
from hapsim.device.ports import open_serial_port
from hapsim.device.sockets import open_socket
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.endings import HUNG_UP, TIMED_OUT
from hapsim.loop.transport import datagram_transport, descriptor_transport
from hapsim.running import run, start
from hapsim.scene import Scene, parse_scene
from hapsim.scene.addresses import Address, address_of

KINDS = ["tcp", "udp"]
SCENE = """
version: 1
rate: 1000
device: {mass: 0.2, friction: 1, clock: lockstep}
mock: {initial: {velocity: 0.1}, seed: 3, noise: 1e-7}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 2}
"""
PATIENCE_S = 60.0


def at(scene: Scene, address: str) -> Scene:
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": address})})


@contextlib.contextmanager
def served(kind: str, peer: str = "127.0.0.1", refused: Callable[[str], None] = lambda _: None) -> Iterator[Any]:
    """A mock that listens: its MOCK and its address."""
    mock = assemble_mock(parse_scene(SCENE))
    with listening(mock, address=f"{kind}://127.0.0.1:0", peer=peer, refused=refused) as address:
        yield mock, address


def until(is_true: Callable[[], bool]) -> None:
    give_up = time.monotonic() + PATIENCE_S
    while not is_true():
        assert time.monotonic() < give_up, "it did not come within a minute"
        time.sleep(0.001)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_over_a_socket_is_that_in_memory_bit_for_bit(kind: str) -> None:
    scene = parse_scene(SCENE)
    in_memory = run(scene, duration=0.2)
    with served(kind) as (_, address):
        runs = [run(at(scene, address), duration=0.2) for _ in range(2)]  # a second host calls from another port
    for one in runs:
        assert one.sample.tolist() == list(range(200))
        for name in ("position_counts", "force_counts", "flags"):
            np.testing.assert_array_equal(getattr(one, name), getattr(in_memory, name))
        assert one.report.released


@pytest.mark.parametrize("kind", KINDS)
def test_the_portable_loop_runs_over_a_socket_too(kind: str) -> None:
    scene = parse_scene(SCENE)
    with served(kind) as (_, address):
        trace = run(at(scene, address), duration=0.05, portable=True)
    np.testing.assert_array_equal(trace.force_counts, run(scene, duration=0.05).force_counts)


def test_only_the_peer_is_answered() -> None:
    calls: list[str] = []
    with served("tcp", "127.0.0.2", calls.append) as (_, address):
        with contextlib.closing(open_socket(address)) as connection, pytest.raises(DeviceError) as caught:
            describe(connection)
        assert "does it list this machine as its peer" in str(caught.value)
        until(lambda: bool(calls))
    assert calls == ["refused 127.0.0.1, which is not the peer 127.0.0.2"]


def test_a_datagram_of_another_machine_is_not_answered() -> None:
    calls: list[str] = []
    with served("udp", "127.0.0.2", calls.append) as (mock, address):
        place = "127.0.0.1", address_of(address).port  # type: ignore[union-attr]
        ask = frame_to_device(SETUP, schema.DESCRIBE, schema.REG_VERSION, 0, np.zeros(1, np.int64))
        with (
            socket.socket(type=socket.SOCK_DGRAM) as stranger,
            socket.socket(type=socket.SOCK_DGRAM) as peer,
        ):
            peer.bind(("127.0.0.2", 0))
            for one in (stranger, peer):
                one.settimeout(0.05)
            stranger.sendto(ask, place)
            until(lambda: bool(calls))

            def answered() -> bool:
                peer.sendto(ask, place)
                with contextlib.suppress(TimeoutError):
                    return bool(peer.recv(100))
                return False

            until(answered)  # the first datagram makes the socket
            with pytest.raises(TimeoutError):
                stranger.recv(100)
    assert int(mock.board.state) == schema.IDLE


@pytest.mark.parametrize("kind", KINDS)
def test_nobody_takes_the_device_from_a_host_that_has_armed_it(kind: str) -> None:
    calls: list[str] = []
    with served(kind, refused=calls.append) as (mock, address):
        scene = at(parse_scene(SCENE), address)
        before = mock.board.state

        with start(scene, duration=600.0) as session:
            until(lambda: int(mock.board.state) == schema.ARMED)
            with contextlib.suppress(DeviceError), contextlib.closing(open_socket(address)):
                until(lambda: bool(calls))
            session.stop()
        assert session.trace.report.released
    assert (int(before), calls[0]) == (schema.IDLE, "refused 127.0.0.1: another program has armed the device")


def test_several_datagrams_are_one_read_and_an_empty_one_is_none() -> None:
    device, host = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with device, host:
        for one in (device, host):
            one.setblocking(False)
        transport, buffer = datagram_transport(host.fileno()), np.zeros(8192, np.uint8)
        assert transport.receive(buffer, 0) == TIMED_OUT
        for data in (b"one\0", b"", b"two\0three\0"):
            device.send(data)
        assert buffer[: transport.receive(buffer, 0)].tobytes() == b"one\0two\0three\0"
        device.send(b"")
        assert transport.receive(buffer, 0) == TIMED_OUT
        assert transport.send(b"four\0") == 0
        assert device.recv(100) == b"four\0"


def test_a_refused_datagram_and_a_closed_stream_are_a_device_that_is_gone() -> None:
    buffer = np.zeros(8192, np.uint8)
    with socket.socket(type=socket.SOCK_DGRAM) as nobody, socket.socket(type=socket.SOCK_DGRAM) as host:
        nobody.bind(("127.0.0.1", 0))
        host.connect(nobody.getsockname())
        host.setblocking(False)
        nobody.close()
        host.send(b"any")
        assert datagram_transport(host.fileno()).receive(buffer, 1_000_000_000) == HUNG_UP
    one, other = socket.socketpair()
    with one:
        one.setblocking(False)
        other.close()
        assert descriptor_transport(one.fileno()).receive(buffer, 1_000_000_000) == HUNG_UP


@pytest.mark.parametrize("kind", KINDS)
def test_where_nothing_listens_is_an_error(kind: str) -> None:
    with socket.socket(type=socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(DeviceError, match=f"{kind}://127.0.0.1:{port}: nothing listens there"):
        open_serial_port(f"{kind}://127.0.0.1:{port}", 115_200)


def test_an_unknown_host_and_a_wrong_address_are_errors() -> None:
    with pytest.raises(DeviceError, match=r"the host nowhere\.invalid is not known"):
        open_socket("tcp://nowhere.invalid:7472")
    with pytest.raises(UsageError, match=r"expected tcp://HOST:PORT or udp://HOST:PORT"):
        open_serial_port("http://127.0.0.1:80", 115_200)
    with pytest.raises(
        UsageError, match=r"--peer: found nowhere\.invalid, expected the name or the number of a machine"
    ):
        served("tcp", "nowhere.invalid").__enter__()


def test_a_taken_address_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            pytest.raises(DeviceError, match="the mock cannot listen there: Address already in use"),
            listening(assemble_mock(parse_scene(SCENE)), address=f"tcp://127.0.0.1:{port}", peer="127.0.0.1"),
        ):
            pass


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("tcp://host:7472", Address("tcp", "host", 7472)),
        ("udp://192.168.7.2:1", Address("udp", "192.168.7.2", 1)),
        ("udp://[fe80::2%eth0]:7472", Address("udp", "fe80::2%eth0", 7472)),
        ("tcp://host", None),
        ("tcp://host:65536", None),
        ("tcp://fe80::2:7472", None),
        ("tcp://user@host:7472", None),
        ("tcp://host:7472/", None),
        ("http://host:7472", None),
        ("/dev/ttyACM0", None),
    ],
)
def test_what_is_an_address(text: str, expected: Address | None) -> None:
    assert address_of(text) == expected
    if expected is not None:
        assert str(expected) == text


@pytest.mark.parametrize("port", ["tcp://host", "http://host:80"])
def test_a_scene_with_a_wrong_address_is_refused(port: str) -> None:
    with pytest.raises(UsageError, match=r"4:40: port: found .*, expected tcp://HOST:PORT or udp://HOST:PORT"):
        parse_scene(SCENE.replace("clock: lockstep", f"port: '{port}'"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_device_answers_at_an_address_of_version_6(kind: str) -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    with (
        listening(assemble_mock(parse_scene(SCENE)), address=f"{kind}://[::1]:0", peer="::1") as address,
        contextlib.closing(open_socket(address)) as connection,
    ):
        assert describe(connection).name == "hapsim mock"


class Relay:
    """Passes datagrams between a host and a device, and drops some of the device's."""

    def __init__(self, device: str, dropped: set[int]) -> None:
        self.to_device, self.to_host = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))
        self.to_device.connect(("127.0.0.1", address_of(device).port))  # type: ignore[union-attr]
        self.to_host.bind(("127.0.0.1", 0))
        self.address = f"udp://127.0.0.1:{self.to_host.getsockname()[1]}"
        self._dropped, self._seen, self._host, self._stop = dropped, 0, None, False
        self._thread = threading.Thread(target=self._relay)

    def _relay(self) -> None:
        while not self._stop:
            for one in select.select([self.to_device, self.to_host], [], [], 0.01)[0]:
                data, place = one.recvfrom(2000)
                if one is self.to_host:
                    self._host = place
                    self.to_device.send(data)
                    continue
                self._seen += 1
                if self._seen not in self._dropped and self._host is not None:
                    self.to_host.sendto(data, self._host)

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop = True
        self._thread.join()
        self.to_device.close()
        self.to_host.close()


def test_lost_datagrams_are_lost_frames() -> None:
    """Datagrams of the description come first, one a register; the run goes on over the gaps."""
    slow = parse_scene(SCENE.replace("1000", "200", 1).replace("clock: lockstep", "clock: device"))
    mock = assemble_mock(slow)
    lost = {120, 121, 140}
    with listening(mock, address="udp://127.0.0.1:0", peer="127.0.0.1") as device, Relay(device, lost) as relay:
        trace = run(at(slow, relay.address), duration=1.0)
    assert trace.report.lost_frames >= len(lost)
    assert trace.sample[-1] >= 199
