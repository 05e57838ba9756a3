"""The mock under attack: whatever bytes come, it keeps running, its answers fit, and its force stays within the limit
and is zero unless armed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from firmware_protocol import schema
from firmware_protocol.frames import SETUP, armed_format, frame_to_device
from hapsim.device.mock.record import OUTBOX_BYTES
from tests.thorough import points

DEVICE, HOST, LOCKSTEP = schema.PACED_BY_DEVICE, schema.PACED_BY_HOST, schema.LOCKSTEP
T_NS = 1_000_000
HASH = schema.SCHEMA_HASH - ((schema.SCHEMA_HASH & 0x80000000) << 1)

New = Callable[..., Any]


def assert_safe(host: Any) -> None:
    """Asserts the invariants that hold after every event."""
    mock = host.mock
    assert np.isfinite(mock.commands).all()
    assert (np.abs(mock.commands) <= mock.force_limit).all()
    assert host.state in (schema.IDLE, schema.ARMED, schema.LATCHED)
    if host.state != schema.ARMED:
        assert not mock.commands.any()
    assert 0 <= mock.board.out <= OUTBOX_BYTES


def assert_like_new(new: New, host: Any, **fields: Any) -> None:
    """Asserts that after a disarm the attacked mock runs like a new one."""
    fresh = new(**fields)
    for wire in (*host.armed_formats.values(), SETUP):
        host.send(b"\0" + frame_to_device(wire, schema.DISARM, 0, 0, [0] * wire.words(True)))
    counts = np.random.default_rng(0).integers(-(2**31), 2**31, (20, host.channels))
    for one in (host, fresh):
        one.heard = one.arm()
        for n, force in enumerate(counts):
            one.heard += one.force(n, force)
    assert host.heard == fresh.heard


# Bytes.

kinds = st.sampled_from([schema.DESCRIBE, schema.ARM, *[schema.FORCE] * 6, schema.DISARM, 0, 5, 15])
words = st.one_of(st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31), HASH]), st.integers(-(2**31), 2**31 - 1))
mostly = st.sampled_from([True, True, True, False])
requested = st.sampled_from([0, 0, 0, *schema.COMBINATIONS])
arming = st.sampled_from(
    [0, 1, 2, 0, 1, 2, *(pacing | parts for parts in schema.COMBINATIONS[1:] for pacing in range(3))]
)


@st.composite
def frames(draw: st.DrawFn, channels: int) -> bytes:
    kind = draw(kinds)
    armed = kind in (schema.FORCE, schema.DISARM)
    wire = armed_format(channels, draw(requested)) if armed == draw(mostly) else SETUP
    counts = [draw(words) for _ in range(wire.words(to_device=True))]
    number, argument = draw(st.integers(0, 4095)), draw(st.integers(0, 255))
    if kind == schema.ARM and draw(mostly):
        counts[0], number, argument = HASH, draw(st.integers(1, 2047)), draw(arming)
    if kind == schema.FORCE and draw(mostly):
        number = draw(st.integers(0, 3))
    return frame_to_device(wire, kind, number, argument, np.array(counts, np.int64))


@st.composite
def torn(draw: st.DrawFn, channels: int) -> bytes:
    frame = bytearray(draw(frames(channels)))
    for at, bit in draw(st.lists(st.tuples(st.integers(0, len(frame) - 1), st.integers(0, 7)), max_size=3)):
        frame[at] ^= 1 << bit
    start, stop = sorted(draw(st.tuples(st.integers(0, len(frame)), st.integers(0, len(frame)))))
    return bytes(frame[start:stop])


@st.composite
def streams(draw: st.DrawFn, channels: int) -> list[bytes]:
    pieces = st.sampled_from("ffffffftb").flatmap(
        {"f": frames(channels), "t": torn(channels), "b": st.binary(max_size=60)}.__getitem__
    )
    counts = np.array([HASH], np.int64)
    armed = [frame_to_device(SETUP, schema.ARM, 30, draw(arming), counts)] if draw(mostly) else []
    return armed + draw(st.lists(pieces, min_size=draw(st.sampled_from([0, 15])), max_size=30))


@settings(max_examples=points(30, 60), deadline=None, derandomize=True)
@given(streams(2), st.booleans())
def test_no_stream_of_bytes_breaks_the_mock_or_its_promises(
    new_host: New, stream: list[bytes], high_scale: bool
) -> None:
    fields = {"channels": 2, "device": {"delay": 1.5, "mass": 5.0}, "mock": {"noise": 1e-6}}
    host = new_host(**fields)
    if high_scale:  # a device whose force counts reach beyond its limit
        host.mock.force_scale[:] *= 1e3
    for i, piece in enumerate(stream):
        host.send(piece, now=i * T_NS)
        assert_safe(host)
        if host.state == schema.ARMED and host.mock.board.pacing == DEVICE:
            host.sample_passes(now=i * T_NS)
            assert_safe(host)
        host.check_watchdog(now=i * T_NS)
        assert_safe(host)
        assert host.misread == 0
    if not high_scale:
        assert_like_new(new_host, host, **fields)


@settings(max_examples=points(25, 40), deadline=None, derandomize=True)
@given(streams(1), st.data())
def test_where_a_stream_is_cut_makes_no_difference(new_host: New, stream: list[bytes], data: st.DataObject) -> None:
    whole, parts = new_host(), new_host()
    joined = b"".join(stream)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(joined)), max_size=8)))
    heard = whole.send(joined)
    heard_in_parts = []
    for start, stop in zip([0, *cuts], [*cuts, len(joined)], strict=True):
        heard_in_parts += parts.send(joined[start:stop])
    assert heard == heard_in_parts
    assert whole.mock.board == parts.mock.board
    assert (whole.commanded == parts.commanded).all()


# Frames, against a second firmware: written from the protocol's rules, in plain Python, without bodies or bytes.


@dataclass
class Model:
    """Model of a device's messages and commands. `said`: (type, number, state, fault), the last two for a status
    only."""

    scale: float
    impulse: bool
    state: int = schema.IDLE
    fault: int = schema.NO_FAULT
    n: int = 0
    said: list[tuple[int, ...]] = field(default_factory=list)
    counters: dict[int, int] = field(default_factory=dict)

    def arm(self, pacing: int, watchdog: int, schema_is_right: bool, now: int) -> None:
        if self.state == schema.ARMED:
            return
        self.n = 0
        self.fault = schema.NO_FAULT
        if not schema_is_right:
            self.fault = schema.WRONG_SCHEMA
        elif pacing not in (DEVICE, HOST, LOCKSTEP):
            self.fault = schema.WRONG_PACING
        elif not 1 <= watchdog <= schema.MAX_WATCHDOG_SAMPLES:
            self.fault = schema.WRONG_WATCHDOG
        if self.fault:
            self.status()
            return
        self.state, self.pacing, self.watchdog = schema.ARMED, pacing, watchdog
        self.quiet_since, self.quiet_since_ns = -1, now
        self.force, self.force_of, self.force_until, self.arrived = 0.0, None, -1, None
        self.zero_from_ns: int | None = None
        self.history: dict[int, float] = {}
        self.counters = dict.fromkeys((schema.REG_ACCEPTED, schema.REG_HELD, schema.REG_EXPIRED, schema.REG_LIMITED), 0)
        self.status()
        self.said.append((schema.POSITION, 0))

    def take_force(self, number: int, ttl: int, counts: int, now: int) -> None:
        if self.state != schema.ARMED:
            return
        answers = next((n for n in range(self.n, self.n - ttl - 1, -1) if n % 4096 == number), None)
        if answers is None:
            self.counters[schema.REG_EXPIRED] += 1
            return
        self.counters[schema.REG_ACCEPTED] += 1
        self.force, self.force_of, self.force_until, self.arrived = counts * self.scale, answers, answers + ttl, self.n
        self.quiet_since, self.quiet_since_ns = self.n, now
        if self.pacing != DEVICE:
            expired = self.pacing == HOST and self.zero_from_ns is not None and now > self.zero_from_ns
            if expired:  # with all that was on its way to the actuator
                self.history = dict.fromkeys(self.history, 0.0)
            self.sample(expired)
            self.zero_from_ns = now + (ttl + 1) * T_NS

    def sample(self, expired: bool = False) -> None:
        came = self.arrived == self.n
        in_time = came and self.force_of == self.n and not expired
        acts = came or (self.n <= self.force_until and not self.impulse)
        if not acts:
            self.force = 0.0
        self.history[self.n] = self.force
        self.counters[schema.REG_HELD] += not in_time
        self.n += 1
        self.said.append((schema.POSITION if in_time else schema.POSITION_HELD, self.n % 4096))

    def check_watchdog(self, now: int) -> None:
        if self.state != schema.ARMED or self.pacing == LOCKSTEP:
            return  # no test here waits ten seconds
        quiet = self.n - self.quiet_since if self.pacing == DEVICE else (now - self.quiet_since_ns) // T_NS
        if quiet > self.watchdog:
            self.state, self.fault = schema.LATCHED, schema.HOST_QUIET
            self.status()

    def disarm(self) -> None:
        self.state = schema.IDLE
        self.status()

    def status(self) -> None:
        self.said.append((schema.STATUS, self.n % 4096, self.state, self.fault))


ages = st.sampled_from([0, 0, 0, 0, 0, 1, 2, 3, 5, 6, -1, -3, 255, 256, 4095, 4096])
EVENTS: dict[str, st.SearchStrategy] = {
    "force": st.tuples(st.just("force"), ages, st.sampled_from([0, 1, 2, 5, 255]), words),
    "sample": st.tuples(st.just("sample")),
    "time": st.tuples(st.just("time"), st.sampled_from([0.1, 0.9, 1.1, 3.0, 30.0])),
    "arm": st.tuples(st.just("arm"), st.sampled_from([0, 1, 2, 0, 1, 2, 3, 7]), st.sampled_from([1, 4, 500, 0, 2048])),
    "wrong schema": st.tuples(st.just("wrong schema")),
    "disarm": st.tuples(st.just("disarm")),
    "wrong format": st.tuples(st.just("wrong format"), kinds),
}
WEIGHTS = {"force": 14, "sample": 18, "time": 3, "arm": 3, "wrong schema": 1, "disarm": 1, "wrong format": 1}
events = st.sampled_from([name for name, weight in WEIGHTS.items() for _ in range(weight)]).flatmap(EVENTS.__getitem__)
beginnings = st.tuples(st.just("arm"), st.sampled_from([DEVICE, HOST, LOCKSTEP]), st.sampled_from([1, 4, 2047]))


@settings(max_examples=points(30, 60), deadline=None, derandomize=True)
@given(
    beginnings, st.lists(events, min_size=25, max_size=60), st.booleans(), st.sampled_from([0, 4090, 4096 * 10**9 - 3])
)
def test_whatever_is_sent_the_mock_and_a_model_of_its_firmware_send_and_command_the_same(
    new_host: New, beginning: tuple, events: list[tuple], impulse: bool, start: int
) -> None:
    host = new_host(device={"mass": 1e4, "delay": 3.0, "hold": "impulse" if impulse else "zoh"})
    model = Model(float(host.mock.force_scale[0]), impulse)
    now, heard = 0, []
    for i, (event, *what) in enumerate([beginning, *events]):
        listening = model.state == schema.ARMED
        if event == "force":
            age, ttl, counts = what
            number = (model.n - age) % 4096
            heard += host.send(host.frame(schema.FORCE, number, ttl, [counts], armed=listening), now)
            model.take_force(number, ttl, counts, now)
        elif event == "sample" and listening and model.pacing == DEVICE:
            heard += host.sample_passes(now)
            model.sample()
        elif event == "time":
            now += int(what[0] * T_NS)
            heard += host.check_watchdog(now)
            model.check_watchdog(now)
        elif event == "arm":
            heard += host.arm(*what, now)
            model.arm(*what, True, now)
        elif event == "wrong schema":
            heard += host.send(host.arm_frame(LOCKSTEP, 100, schema.SCHEMA_HASH ^ 0x10), now)
            model.arm(LOCKSTEP, 100, False, now)
        elif event == "disarm":
            heard += host.send(host.disarm_frame(armed=listening), now)
            model.disarm()
        elif event == "wrong format":
            heard += host.send(host.frame(what[0], 0, 1, [HASH], armed=not listening), now)
        if i == 0 and model.state == schema.ARMED:  # as after a long run
            host.mock.board.n = host.mock.board.accepted = model.n = model.quiet_since = start
            host.mock.board.answered = start - 1
        assert_safe(host)
        assert host.state == model.state
        if model.state == schema.ARMED:
            for n in range(model.n - 4, model.n):
                if n in model.history:
                    assert host.commanded[n % len(host.commanded), 0] == model.history[n]
    said = [
        (frame.type, frame.number, frame.state, frame.fault)[: 4 if frame.type == schema.STATUS else 2]
        for frame in heard
    ]
    assert said == model.said
    assert {register: int(host.mock.registers[register]) for register in model.counters} == model.counters


# Numbers.

sizes = st.one_of(
    st.sampled_from([1e-12, 1e-9, 1.0, 1e9, 1e12]),
    st.floats(-12, 12).map(lambda exponent: 10.0**exponent),
)
none_or_sizes = st.one_of(st.just(0.0), sizes)
ORDINARY: dict[str, Any] = {
    "rate": 1e3,
    "mass": 1.0,
    "friction": 0.0,
    "coulomb": 0.0,
    "limit": 10.0,
    "quantum": 1e-9,
    "noise": 0.0,
    "position": 0.0,
    "velocity": 1.0,
    "delay": 1.0,
    "impulse": False,
    "average": False,
    "counts": [-(2**31)] * 6,
}


@settings(max_examples=points(50, 120), deadline=None, derandomize=True)
@given(
    rate=sizes,
    mass=sizes,
    friction=none_or_sizes,
    coulomb=none_or_sizes,
    limit=sizes,
    quantum=sizes,
    noise=none_or_sizes,
    position=none_or_sizes,
    velocity=none_or_sizes,
    delay=st.sampled_from([0.0, 0.37, 1.0, 1000.0]),
    impulse=st.booleans(),
    average=st.booleans(),
    counts=st.lists(words, min_size=6, max_size=6),
)
@example(**ORDINARY | {"coulomb": 1e12, "limit": 1e12, "quantum": 1e12})
@example(**ORDINARY | {"coulomb": 1e-12, "friction": 1.0, "average": True})
@example(**ORDINARY | {"mass": 1e-12, "limit": 1e12})
def test_no_scene_however_absurd_its_numbers_breaks_the_mock(
    new_host: New,
    rate: float,
    mass: float,
    friction: float,
    coulomb: float,
    limit: float,
    quantum: float,
    noise: float,
    position: float,
    velocity: float,
    delay: float,
    impulse: bool,
    average: bool,
    counts: list[int],
) -> None:
    device = {"mass": mass, "friction": friction, "delay": delay, "force_limit": limit}
    kinds = {"hold": "impulse" if impulse else "zoh", "sampling": "average" if average else "ideal"}
    initial = {"position": position, "velocity": -velocity}
    mock = {"coulomb": coulomb, "quantum": quantum, "noise": noise, "initial": initial}
    host = new_host(rate=rate, device=device | kinds, mock=mock)
    for pacing in (LOCKSTEP, HOST):
        heard = host.arm(pacing)
        for n, count in enumerate(counts):
            heard += host.force(n, [count], now=(n + 1) * T_NS)
            assert_safe(host)
        assert host.misread == 0
        *positions, last = heard[1:]
        # Paced by the host, a millisecond may be longer than a force lives.
        outlived = pacing == HOST and 21.0 / rate < T_NS * 1e-9
        in_time = [schema.POSITION, schema.POSITION, *[schema.POSITION_HELD if outlived else schema.POSITION] * 5]
        assert [frame.type for frame in positions] == in_time[: len(positions)]
        assert last.type == in_time[len(positions)] or last.fault == schema.POSITION_OUT_OF_RANGE
        if last.type != schema.STATUS:
            assert math.isfinite(host.bodies["position"][0])
        host.disarm()
        assert_safe(host)
