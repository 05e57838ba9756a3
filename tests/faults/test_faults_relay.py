"""The faults between a pseudo-terminal and a port: what passes, what a host sees of a plug, and how it ends."""

from __future__ import annotations

import contextlib
import itertools
import os
import select
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from wire_session import force, injector_of, position, touched_scene

from hapsim.bringup.faults import Injector
from hapsim.bringup.faults import relay as relay_module
from hapsim.bringup.faults.relay import Relay
from hapsim.cli.faults import passing_on
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.device.ports import raw_port
from hapsim.errors import DeviceError, UsageError
from hapsim.running import run
from hapsim.scene import Scene

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")

_LONGEST_S = 60.0  # for a machine that hangs


@contextlib.contextmanager
def pair() -> Iterator[tuple[int, int]]:
    """A device's own end, and that which the relay reads; both raw."""
    ends = os.openpty()
    for end in ends:
        tty.setraw(end)
        os.set_blocking(end, False)
    try:
        yield ends
    finally:
        for end in ends:
            with contextlib.suppress(OSError):
                os.close(end)


class Running:
    """A relay in a thread of its own."""

    def __init__(self, relay: Relay) -> None:
        self.relay, self.whole = relay, None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        self.whole = self.relay.run()

    def ended(self) -> bool | None:
        self._thread.join(_LONGEST_S)
        assert not self._thread.is_alive()
        return self.whole

    def stop(self) -> bool | None:
        self.relay.stop()
        return self.ended()


@contextlib.contextmanager
def relaying(device: int, injector: Injector, path: Path | None = None) -> Iterator[Running]:
    with Relay(device, injector, path) as relay:
        running = Running(relay)
        try:
            yield running
        finally:
            running.stop()


def read(descriptor: int, count: int) -> bytes:
    """The next `count` bytes."""
    data = b""
    while len(data) < count:
        assert select.select([descriptor], [], [], _LONGEST_S)[0], f"only {data!r} came"
        data += os.read(descriptor, count - len(data))
    return data


def wait_for(what: Callable[[], bool]) -> None:
    give_up = time.monotonic() + _LONGEST_S
    while not what():
        assert time.monotonic() < give_up, "not seen within a minute"
        time.sleep(0.005)


@contextlib.contextmanager
def host_of(name: str) -> Iterator[int]:
    descriptor = os.open(name, os.O_RDWR | os.O_NOCTTY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def hangs_up(descriptor: int) -> bool:
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(event & select.POLLHUP for _, event in poll.poll(1000 * _LONGEST_S))


def test_how_long_passing_on_took_is_counted_without_what_a_fault_held_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fake clock advances by a millisecond per reading. The delay of a fault does not count as passing time."""
    looks = itertools.count()
    monkeypatch.setattr(relay_module, "_LONGEST_WAIT_S", 1e-3)
    monkeypatch.setattr(relay_module.time, "monotonic", lambda: 1e-3 * next(looks))
    injector, told = injector_of("kind: delay, seconds: 0.02"), list[str]()
    with pair() as (device, port), Relay(port, injector) as relay, host_of(relay.name) as host:
        os.write(device, position(0) + position(1))
        relay.run(0.1, lambda: told.append(passing_on(injector)))
        assert read(host, 22) == position(0) + position(1)
    assert told
    assert passing_on(injector) == "passing on: 2 frames, 2 faults · Ctrl-C ends it"
    assert relay.delays.total == 2
    assert 0.0 < relay.delays.maximum < 0.01


def test_bytes_pass_both_ways_and_hosts_come_and_go() -> None:
    injector = injector_of("kind: drop, probability: 0")
    with pair() as (device, port), relaying(port, injector) as running:
        for number in range(2):
            with host_of(running.relay.name) as host:
                os.write(host, force(number))
                assert read(device, 12) == force(number)
                os.write(device, position(number))
                assert read(host, 11) == position(number)
        assert running.stop() is True
    assert injector.passed[True].frames_in == injector.passed[True].frames_out == 2
    assert injector.passed[False].bytes_out == 22


def test_a_plug_that_is_pulled_hangs_the_host_up_and_comes_back_under_its_name(tmp_path: Path) -> None:
    name = tmp_path / "port"
    injector = injector_of("kind: unplug, after_samples: 1", "kind: replug, after_samples: 2")
    with pair() as (device, port), relaying(port, injector, name):
        with host_of(str(name)) as host:
            os.write(device, position(0))
            assert read(host, 11) == position(0)
            os.write(device, position(1))
            assert hangs_up(host)
        assert not name.is_symlink()
        os.write(device, position(2))
        wait_for(name.exists)
        with host_of(str(name)) as host:
            os.write(host, force(2))
            assert read(device, 12) == force(2)
    assert not name.is_symlink()


def test_a_device_that_goes_away_ends_it() -> None:
    with pair() as (device, port), relaying(port, injector_of("kind: drop")) as running:
        os.close(device)
        assert running.ended() is False


def test_what_no_host_fetches_is_counted() -> None:
    injector = injector_of("kind: garbage, bytes: 60000, after_samples: 0")
    with pair() as (device, port), relaying(port, injector) as running:
        os.write(device, position(0))
        wait_for(lambda: running.relay.unread_bytes > 0)
        running.stop()
    assert 0 < running.relay.unread_bytes < 60011


def test_a_name_that_is_taken_is_left_alone(tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    with pair() as (_, port), pytest.raises(UsageError, match="expected a free name for the port"):
        Relay(port, injector_of("kind: drop"), taken).__enter__()
    assert taken.read_text() == "mine"


@contextlib.contextmanager
def scene_behind(injector: Injector) -> Iterator[Scene]:
    """The scene with its mock behind a relay."""
    scene = touched_scene()
    with (
        serving(assemble_mock(scene)) as device,
        raw_port(device, 2_000_000) as port,
        relaying(port, injector) as running,
    ):
        yield scene.model_copy(update={"device": scene.device.model_copy(update={"port": running.relay.name})})


def test_a_run_through_it_is_the_run_without_it() -> None:
    injector = injector_of("kind: garbage, bytes: 50, every_samples: 10", "kind: duplicate, direction: from_device")
    with scene_behind(injector) as scene:
        trace = run(scene, duration=0.2)
    direct = run(touched_scene(), duration=0.2)
    np.testing.assert_array_equal(trace.force_counts, direct.force_counts)
    assert trace.report.stale_positions >= 199
    assert trace.report.garbage_bytes > 0
    assert injector.witness.all.count == 200
    release = injector.witness.release()
    assert release is not None
    assert release.by == "disarm"


def test_a_run_whose_plug_is_pulled_reports_it() -> None:
    injector = injector_of("kind: unplug, after_samples: 50")
    sentence = r"the device went away after \d+ ticks \(unplugged.*did not confirm"
    with scene_behind(injector) as scene, pytest.raises(DeviceError, match=sentence):
        run(scene, duration=10.0)
    assert injector.witness.since_fault.count == 0
