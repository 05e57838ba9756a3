"""Each kind of fault, bytes in and bytes out, without a port and without a clock."""

from __future__ import annotations

import math
import sys
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from wire_session import (
    ARMED,
    DESCRIPTION,
    PERIOD_S,
    bytes_of,
    described,
    force,
    frames_of,
    injector_of,
    numbers_of,
    position,
    positions_through,
)

from firmware_protocol import schema
from firmware_protocol.description import from_registers
from firmware_protocol.frames import SETUP, armed_format, frame_to_device, frame_to_host
from hapsim.bringup.faults import KINDS, Injector, Passed, parse_script
from hapsim.bringup.faults.fault import OnFrames, Piece
from hapsim.bringup.faults.kinds import misread
from hapsim.errors import UsageError
from hapsim.scene.quantity import count

STREAM = b"".join(position(number) for number in range(300))
MANY = ("kind: drop, probability: 0.1", "kind: corrupt, probability: 0.2, bits: 3", "kind: reorder, probability: 0.1")


def test_where_nothing_happens_every_byte_passes_at_once_whatever_it_is() -> None:
    injector = injector_of("kind: silence, at: 1000", "kind: drop, probability: 0")
    noise = np.random.default_rng(1).bytes(5000) + b"\0"
    for to_device, data in ((False, STREAM), (True, noise), (False, noise + STREAM)):
        passed = injector.take(data, to_device, 1.0)
        assert bytes_of(passed, to_device) == data
        assert {one.due_s for one in passed} == {1.0}
    assert all(count == 0 for _, count in injector.counts)


@pytest.mark.parametrize("size", [1, 7, 11, 100])
def test_the_same_bytes_make_the_same_faults_however_they_arrive(size: int) -> None:
    whole, pieces = injector_of(*MANY), injector_of(*MANY)
    expected = bytes_of(whole.take(STREAM, False, 0.0))
    cut = [pieces.take(STREAM[at : at + size], False, 0.0) for at in range(0, len(STREAM), size)]
    assert b"".join(map(bytes_of, cut)) == expected != STREAM
    assert pieces.counts == whole.counts


def test_another_seed_makes_other_faults_and_either_way_has_a_chance_of_its_own() -> None:
    script = parse_script("version: 1\nseed: 3\nfaults: [{kind: drop, probability: 0.3}]")
    streams = [bytes_of(Injector(script, seed).take(STREAM, False, 0.0)) for seed in (None, 3, 4)]
    assert streams[0] == streams[1] != streams[2]
    forces = b"".join(map(force, range(300)))
    alone, beside = injector_of(*MANY), injector_of(*MANY)
    beside.take(forces, True, 0.0)
    assert bytes_of(alone.take(STREAM, False, 0.0)) == bytes_of(beside.take(STREAM, False, 0.0))
    injector = injector_of("kind: drop, probability: 0.5")
    positions = numbers_of(injector.take(STREAM, False, 0.0))
    left = frames_of(bytes_of(injector.take(forces, True, 0.0), to_device=True), to_device=True)
    assert positions != [frame.number for frame in left]


def test_a_fault_that_is_one_class_is_read_from_scripts_and_listed() -> None:
    class Stuck(OnFrames):
        """Every count is the same."""

        kind: Literal["stuck"] = "stuck"
        at: Annotated[int, count("Where it sticks", 0, 100)] = 7

        def change(self, piece: Piece) -> list[Piece]:
            return [piece.rewritten(counts_of=lambda frame: [self.at for _ in frame.counts])]

    try:
        assert list(KINDS)[-1] == "stuck"
        injector = injector_of("kind: stuck, at: 12, after_samples: 1, for_samples: 1")
        seen = [frame.counts for frame in frames_of(bytes_of(positions_through(injector, 3)))]
        assert seen == [(0,), (12,), (2000,)]
        assert injector.counts == [("stuck", 1)]
        with pytest.raises(UsageError, match=r"expected .* invert or stuck; did you mean 'stuck'"):
            injector_of("kind: stuk")
        with pytest.raises(UsageError, match="at: found 101, expected a whole number from 0 to 100"):
            injector_of("kind: stuck, at: 101")
    finally:
        del KINDS["stuck"]


def test_a_frame_is_dropped_in_its_direction_only() -> None:
    injector = injector_of("kind: drop, direction: from_device, after_samples: 10, for_samples: 5")
    positions_through(injector, 12)
    assert bytes_of(injector.take(force(1), True, 0.012), to_device=True) == force(1)


def test_as_many_are_dropped_as_the_probability_demands() -> None:
    injector = injector_of("kind: drop, probability: 0.1")
    left = len(positions_through(injector, 2000))
    assert injector.counts == [("drop", 2000 - left)]
    assert 2000 - left == pytest.approx(200, abs=4 * math.sqrt(2000 * 0.1 * 0.9))


@pytest.mark.parametrize("bits", [1, 2, 5])
def test_so_many_bits_flip_and_no_receiver_takes_the_frame(bits: int) -> None:
    injector = injector_of(f"kind: corrupt, bits: {bits}, after_samples: 5, for_samples: 1")
    passed = positions_through(injector, 10)
    flipped = np.unpackbits(np.frombuffer(bytes_of(passed), np.uint8)) != np.unpackbits(
        np.frombuffer(STREAM[: 10 * 11], np.uint8)
    )
    assert np.flatnonzero(flipped).size == bits
    assert set(np.flatnonzero(flipped) // (8 * 11)) == {5}
    assert 5 not in numbers_of(passed)


@pytest.mark.parametrize(
    ("fault", "seen", "count"),
    [
        ("kind: duplicate, after_samples: 3, for_samples: 2", [0, 1, 2, 3, 3, 4, 4, 5, 6, 7, 8, 9], 2),
        ("kind: wrong_baud, ratio: 0.5, after_samples: 5, for_samples: 3", [0, 1, 2, 3, 4, 8, 9], 3),
        ("kind: silence, direction: both, at: 0.0045, for: 0.003", [0, 1, 2, 3, 4, 8, 9], 3),
        ("kind: drop, direction: from_device, after_samples: 3, for_samples: 5", [0, 1, 2, 8, 9], 5),
        ("kind: drop, from: 0.0025, for: 0.005", [0, 1, 2, 8, 9], 5),
        ("kind: half_frame, after_samples: 5", [0, 1, 2, 3, 4], 5),
    ],
)
def test_of_ten_positions_a_host_sees_these(fault: str, seen: list[int], count: int) -> None:
    injector = injector_of(fault)
    passed = positions_through(injector, 10)
    assert numbers_of(passed) == seen
    assert [times for _, times in injector.counts] == [count]
    assert "half_frame" not in fault or bytes_of(passed) == STREAM[: 5 * 11 + 5]


def test_a_late_frame_holds_up_what_is_behind_it() -> None:
    injector = injector_of("kind: delay, seconds: 0.0025, after_samples: 3, for_samples: 1")
    passed = positions_through(injector, 8)
    assert numbers_of(passed) == list(range(8))
    assert [one.due_s for one in passed] == pytest.approx([0.0, 0.001, 0.002, 0.0055, 0.0055, 0.0055, 0.006, 0.007])


def test_two_frames_change_places_and_the_last_one_is_not_kept() -> None:
    injector = injector_of("kind: reorder, within: 0.02")
    passed = positions_through(injector, 5)
    assert numbers_of(passed) == [1, 0, 3, 2]
    due_s = injector.next_s(4 * PERIOD_S)
    assert due_s == pytest.approx(4 * PERIOD_S + 0.02)
    assert injector.advance(due_s - 1e-6) == []
    assert numbers_of(injector.advance(due_s)) == [4]
    assert injector.next_s(due_s) == math.inf


@pytest.mark.parametrize("every", ["every_samples: 10", "every: 0.01"])
def test_noise_comes_between_frames_and_no_frame_is_lost_by_it(every: str) -> None:
    injector = injector_of(f"kind: garbage, bytes: 300, {every}", seed=1)
    passed = positions_through(injector, 95)
    assert injector.counts == [("garbage", 10)]
    assert len(bytes_of(passed)) == 95 * 11 + 10 * 300
    assert numbers_of(passed) == list(range(95))


def test_noise_comes_although_nothing_else_does_and_once_where_no_period_is_given() -> None:
    injector = injector_of("kind: garbage, bytes: 5, every: 0.5, direction: both", "kind: garbage, bytes: 7, from: 0.2")
    first = injector.take(b"\0", False, 10.0)
    assert [len(one.data) for one in first] == [5, 5, 1]
    assert injector.next_s(10.0) == pytest.approx(10.2)
    assert [(one.to_device, len(one.data)) for one in injector.advance(10.2)] == [(False, 7)]
    assert injector.next_s(10.2) == pytest.approx(10.5)
    assert len(injector.advance(10.5)) == 2


@pytest.mark.parametrize(
    ("data", "ratio", "read"),
    [
        (bytes(range(256)), 1.0, bytes(range(256))),
        # By hand: 0x55 is ten levels that change with each bit, 0 first; then the wire rests at 1.
        (b"\x55", 0.5, b"\xff"),  # samples at 3, 5, 7, 9 and beyond
        (b"\x55", 2.0, b"\x66\xe6"),  # at 0.75, 1.25, … 4.25 from the edge at 0; and again from that at 6
        (b"\x55\x40", 0.5, b"\x8f"),  # 3 … 17; the edge at 18 comes before the stop bit's middle at 19
        (b"\x00", 0.5, b"\xf8"),  # three zeros, at 3, 5 and 7; then the stop bit, and rest
    ],
)
def test_a_uart_at_another_rate_reads_what_its_samples_hit(data: bytes, ratio: float, read: bytes) -> None:
    assert misread(data, ratio) == read


def test_an_unplugged_device_is_gone_both_ways_until_it_is_plugged_in_again() -> None:
    injector = injector_of("kind: unplug, at: 0.005", "kind: replug, at: 0.5")
    assert injector.next_s(0.0) == math.inf  # no byte yet: no time passes
    assert numbers_of(positions_through(injector, 10)) == list(range(5))
    assert not injector.plugged
    assert injector.take(force(3), True, 0.02) == []
    assert injector.next_s(0.02) == pytest.approx(0.5)
    injector.advance(0.5)
    assert injector.plugged
    assert injector.take(force(3), True, 0.6)[0].data == force(3)


def test_a_plug_is_pulled_although_noise_comes_at_the_same_moment() -> None:
    injector = injector_of("kind: garbage, bytes: 5, from: 0.005", "kind: unplug, at: 0.005")
    positions_through(injector, 10)
    assert (injector.plugged, injector.counts) == (False, [("garbage", 1), ("unplug", 1)])


def test_a_device_that_reboots_is_released_and_sends_nothing_until_it_is_back() -> None:
    injector = injector_of("kind: reboot, seconds: 0.5, after_samples: 5")
    passed = positions_through(injector, 10)
    assert numbers_of(passed) == list(range(5))
    disarm = frame_to_device(ARMED, schema.DISARM, 0, 0, [0])
    assert bytes_of(passed, to_device=True) == disarm
    idle = frame_to_host(SETUP, schema.STATUS, 5, [schema.IDLE])
    assert injector.take(idle, False, 0.011) == []
    assert injector.take(force(9), True, 0.012) == []
    assert bytes_of(injector.take(idle, False, 0.506)) == idle


def test_another_version_is_declared_with_a_right_check() -> None:
    injector = injector_of("kind: version, answers: 3")
    frames = frames_of(bytes_of(injector.take(described(), False, 0.0)), wire=SETUP)
    assert len(frames) == schema.REGISTERS
    assert [frame.counts[0] for frame in frames[:3]] == [3, frames_of(described(), wire=SETUP)[1].counts[0], 1]


@pytest.mark.parametrize(
    ("register", "what", "field", "value"),
    [
        ("rate", "nan", "rate_hz", math.nan),
        ("rate", "zero", "rate_hz", 0.0),
        ("position_scale", "negative", "position_scale", (-1.0,)),
        ("force_scale", "huge", "force_scale", (1e300,)),
        ("force_limit", "zero", "force_limit", (0.0,)),
        ("pacings", "negative", "pacings", 2**32 - 1),
    ],
)
def test_nonsense_is_declared_of_one_thing_alone(register: str, what: str, field: str, value: object) -> None:
    injector = injector_of(f"kind: nonsense, register: {register}, what: {what}")
    words = np.zeros(schema.REGISTERS, np.int64)
    for frame in frames_of(bytes_of(injector.take(described(), False, 0.0)), wire=SETUP):
        words[frame.number] = frame.counts[0] & 0xFFFFFFFF
    declared = from_registers(words)
    np.testing.assert_equal(getattr(declared, field), value)
    np.testing.assert_equal(
        [entry for name, entry in vars(declared).items() if name != field],
        [entry for name, entry in vars(DESCRIPTION).items() if name != field],
    )


def counts_of(passed: list[Passed], to_device: bool = False) -> list[int]:
    return [frame.counts[0] for frame in frames_of(bytes_of(passed, to_device), to_device)]


def test_a_position_leaps_by_this_many_metres_or_counts_and_stays_there() -> None:
    injector = injector_of("kind: leap, metres: 0.01, after_samples: 3")
    assert bytes_of(injector.take(described(), False, 0.0)) == described()
    assert counts_of(positions_through(injector, 6)) == [0, 1000, 2000, 13000, 14000, 15000]
    # Counts need no described scale, metres do; and none leaves 32 bits.
    for fault, expected in (("counts: -7", 993), ("metres: 1", 1000), ("counts: 2147483647", 2**31 - 1)):
        assert counts_of(injector_of(f"kind: leap, {fault}, at: 0").take(position(1), False, 0.0)) == [expected]
    beyond = injector_of("kind: leap, counts: 5, channel: 3, at: 0")
    assert bytes_of(beyond.take(position(1), False, 0.0)) == position(1)
    assert beyond.counts == [("leap", 0)]


@pytest.mark.parametrize(
    ("fault", "seen"),
    [
        ("kind: freeze", [0] * 10),
        ("kind: freeze, after_samples: 4", [0, 1, 2, 3, 3, 3, 3, 3, 3, 3]),
        ("kind: freeze, from: 0.0035, for: 0.003", [0, 1, 2, 3, 3, 3, 3, 7, 8, 9]),
        ("kind: refresh, every_samples: 4", [0, 0, 0, 0, 4, 4, 4, 4, 8, 8]),
        ("kind: refresh, every: 0.003, after_samples: 2", [0, 1, 2, 2, 2, 5, 5, 5, 8, 8]),
        ("kind: freeze, channel: 1", list(range(10))),
    ],
)
def test_a_dead_sensor_goes_on_sending_its_last_position_in_frames_that_are_right(fault: str, seen: list[int]) -> None:
    injector = injector_of(fault)
    passed = positions_through(injector, 10)
    assert numbers_of(passed) == list(range(10))
    assert [count // 1000 for count in counts_of(passed)] == seen
    assert injector.counts[0][1] == sum(count != number for number, count in enumerate(seen))


def test_only_the_sensor_of_its_channel_is_dead_and_reports_no_velocity_either() -> None:
    wire, injector = armed_format(2, schema.WITH_VELOCITY), injector_of("kind: freeze, channel: 1, after_samples: 1")
    sent = [frame_to_host(wire, schema.POSITION, n, [n, 10 + n, 20 + n, 30 + n]) for n in range(3)]
    passed = [one for data in sent for one in injector.take(data, False, 0.001)]
    frames = frames_of(bytes_of(passed), wire=wire)
    assert [frame.counts for frame in frames] == [(0, 10, 20, 30), (1, 10, 21, 30), (2, 10, 22, 30)]


def test_a_sign_is_wrong_one_way() -> None:
    positions = injector_of("kind: invert, after_samples: 2")
    assert counts_of(positions_through(positions, 4)) == [0, 1000, -2000, -3000]
    forces = injector_of("kind: invert, direction: to_device, at: 0")
    (frame,) = frames_of(bytes_of(forces.take(force(5, 700), True, 0.0), to_device=True), to_device=True)
    assert (frame.number, frame.argument, frame.counts) == (5, 20, (-700,))
    assert bytes_of(forces.take(position(1), False, 0.0)) == position(1)


@pytest.mark.parametrize(
    ("factor", "seen", "true"),
    [(0.5, [0, 1, 2, 3, 4, 5], [0, 1, 3, 5, 7, 9]), (2.0, [0, 1, 2, 3, 4, 5, 6], [0, 1, 2, 2, 3, 3, 4])],
)
def test_a_device_samples_at_another_rate_and_counts_its_own_samples(
    factor: float, seen: list[int], true: list[int]
) -> None:
    """The forces answer the samples that the device knows."""
    injector = injector_of(f"kind: rate, factor: {factor}, after_samples: 2")
    passed = positions_through(injector, 12)
    frames = frames_of(bytes_of(passed))
    assert [frame.number for frame in frames][: len(seen)] == seen
    assert [frame.counts[0] // 1000 for frame in frames][: len(seen)] == true
    answers = bytes_of(injector.take(b"".join(map(force, seen)), True, 0.02), to_device=True)
    assert [frame.number for frame in frames_of(answers, to_device=True)] == true


def test_faults_act_one_after_the_other_in_the_scripts_order() -> None:
    twice = injector_of("kind: duplicate", "kind: delay, seconds: 1")
    assert twice.counts == [("duplicate", 0), ("delay", 0)]
    positions_through(twice, 3)
    assert twice.counts == [("duplicate", 3), ("delay", 6)]
    never = injector_of("kind: drop", "kind: duplicate")
    assert positions_through(never, 3) == []
    assert never.counts == [("drop", 3), ("duplicate", 0)]


def test_samples_go_on_being_counted_where_numbers_begin_anew_and_where_the_host_arms_again() -> None:
    injector = injector_of("kind: drop, after_samples: 4100")
    for first in range(0, 5000, 1000):
        positions_through(injector, 1000, first)
    assert injector.samples == 4999
    injector.take(position(4990) + position(4999), False, 5.0)  # of the past, and the newest again
    positions_through(injector, 1, 4999)
    assert injector.samples == 4999
    assert injector.counts == [("drop", 903)]
    injector.take(frame_to_host(SETUP, schema.STATUS, 0, [schema.ARMED]), False, 6.0)
    positions_through(injector, 10)
    assert injector.samples == 5009


WITH = {
    "delay": "seconds: 0.01",
    "freeze": "after_samples: 5",
    "garbage": "bytes: 5",
    "half_frame": "after_samples: 5",
    "invert": "at: 0",
    "leap": "metres: 0.01, at: 0",
    "nonsense": "register: rate, what: zero",
    "rate": "factor: 2",
    "reboot": "seconds: 0.5, after_samples: 5",
    "refresh": "every_samples: 7",
    "replug": "at: 0.01",
    "silence": "at: 0.01",
    "unplug": "at: 0.01",
    "wrong_baud": "ratio: 0.5",
}


@cache
def played(*faults: str) -> tuple[object, list[tuple[str, int]]]:
    """Returns what passes of a short session with these faults, and their counts."""
    injector = injector_of(*faults)
    passed = injector.take(described(), False, 0.0) + positions_through(injector, 30)
    passed += injector.take(force(29, 500), True, 0.03) + injector.advance(1.0)
    return [(one.data, one.to_device, one.due_s) for one in passed], injector.counts


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_changes_what_passes_and_is_counted(kind: str) -> None:
    """A kind that is new and does nothing fails here; what it does is for a test of its own."""
    before = "kind: unplug, at: 0.005" if kind == "replug" else "kind: drop, probability: 0"
    told, counts = played(before, f"kind: {kind}, {WITH.get(kind, '')}")
    assert told != played(before)[0] or kind == "replug"
    assert counts[-1][0] == kind
    assert counts[-1][1] > 0
