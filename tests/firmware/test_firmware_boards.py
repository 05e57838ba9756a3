"""The firmware on its boards, the emulated ones among them, as hapsim meets it: over a port.

Nothing here is measured by this machine's clock: a board tells when it put out which force by its own.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from firmware_protocol import schema
from firmware_protocol.client import Received
from firmware_protocol.lines import line_counts, pack_line
from hapsim.bringup.probe.probing import Wire
from hapsim.device.connection import arm, describe, disarm, read_register
from hapsim.device.ports import open_serial_port
from hapsim.errors import DeviceError
from tests.thorough import points

CONFIGS = Path(__file__).parents[2] / "configs"
SWINGING = Path(__file__).parents[2] / "tools" / "bench" / "swinging.yaml"
BOARDS = ("linux", "avr", "cortex_m")
TIME_TO_LIVE = 20  # samples: what hapsim asks for at 1 kHz
PERIOD_US = 1000
PATIENCE_S = 30.0  # for a machine that hangs
Start = Callable[..., Any]

FIRMWARE = Path(__file__).parents[2] / "firmware_protocol" / "firmware"

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="boards stand on pseudo-terminals of Linux")


@pytest.fixture
def swinging(tmp_path: Path) -> Callable[[str], Path]:
    """The scene whose every sample has a force of its own, under a clock."""

    def write(clock: str) -> Path:
        path = tmp_path / f"{clock}.yaml"
        path.write_text(SWINGING.read_text("utf-8").replace("clock: device", f"clock: {clock}"), "utf-8")
        return path

    return write


def start_host(start_hapsim: Start, scene: Path, board: Any) -> Any:
    """A hapsim that plays with the board, which has put out some forces already. On a machine that is busy with other
    tests the host may be held up for so long that the board latches: then it begins anew."""
    for _ in range(10):
        before = len(board.forces())
        host = start_hapsim("run", scene, "--port", board.port, "--duration", 600)
        board.wait_for(lambda forces: len(forces) > before + 100 or host.poll() is not None)  # noqa: B023
        if host.poll() is None:
            break
    return host


@contextlib.contextmanager
def connected(board: Any) -> Iterator[Any]:
    with contextlib.closing(open_serial_port(board.port, 2_000_000)) as connection:
        yield connection


def is_description(received: Received) -> bool:
    return received.kind == schema.DESCRIPTION


@pytest.mark.parametrize(
    ("name", "scene"), [*((name, "first_touch") for name in BOARDS), ("linux", "sensed_acceleration")]
)
def test_a_scene_feels_as_predicted(
    name: str, scene: str, start_board: Start, start_hapsim: Start, tmp_path: Path
) -> None:
    """Shorter than the rate is judged: a machine that is busy with other tests may hold an emulated board up."""
    board, path = start_board(name), tmp_path / f"{scene}.yaml"
    path.write_text((CONFIGS / path.name).read_text().replace("clock: lockstep", "clock: device"))
    words = ("measure", path, "--port", board.port, "--duration", 0.8, "--json")
    for _ in range(5):
        host = start_hapsim(*words)
        if host.wait() == 0:
            break
    assert host.poll() == 0, host.err
    document = json.loads(host.out)
    predicted, measured = document["predicted"], document["measured"]
    # Of few samples, where most forces came late, it is as exact as it says itself.
    assert measured["k"] == pytest.approx(predicted["k"], rel=1e-6, abs=5 * measured["k_uncertainty"])
    assert measured["b"] == pytest.approx(predicted["b"], rel=1e-5, abs=5 * measured["b_uncertainty"])


@pytest.mark.parametrize("name", BOARDS)
def test_a_board_describes_itself_and_receives_every_frame(name: str, start_board: Start) -> None:
    """All in one piece, at the full baud: the newest bytes behind noise that no ring holds, and all of a row."""
    numbers = [*range(12)]
    with connected(start_board(name)) as connection:
        description = describe(connection)
        wire = Wire(connection)
        for length in (255, 300, 3000):
            noise = bytes(1 + (7 * i) % 255 for i in range(length))
            wire.send(noise + wire.frame(schema.DESCRIBE, schema.REG_SCHEMA))
            answer, _ = wire.wait_for(is_description, PATIENCE_S)
            assert answer is not None, f"nothing after {length} bytes of noise"
            assert (answer.number, answer.word) == (schema.REG_SCHEMA, schema.SCHEMA_HASH)
        wire.send(b"".join(wire.frame(schema.DESCRIBE, number) for number in numbers))
        answers = []
        while len(answers) < len(numbers):
            answer, received = wire.wait_for(is_description, PATIENCE_S)
            assert answer is not None, f"only {answers} of the registers {numbers} were answered"
            answers += [one.number for one in received]
    assert answers == numbers
    assert (description.channels, description.rate_hz, description.pacings) == (1, 1000.0, 3)
    assert description.position_scale == (1e-9,)
    assert description.velocity_scale == (1e-8,)
    assert description.force_scale == (1e-8,)
    assert description.force_limit == (10.0,)


def test_the_reference_firmware_sends_the_acceleration_that_its_velocity_then_gains(start_board: Start) -> None:
    """A mass of 0.2 kg with 1 N·s/m, moved exactly under each force: that which begins at the sample (age 0)."""
    rows: dict[int, tuple[int, ...]] = {}
    with connected(start_board("linux")) as connection:
        description = describe(connection)
        assert (description.sensed, description.acceleration_scale) == (("velocity", "acceleration"), (5e-8,))
        wire = arm(connection, description, schema.PACED_BY_DEVICE, 2047, schema.MOTION_BITS)
        while len(rows) < 100:
            (one,) = connection.receive(PATIENCE_S)
            rows[one.number] = one.counts
            force = (-1) ** one.number * 3_000_000 * (one.number % 97)  # up to 2.9 N
            connection.send(connection.frame(schema.FORCE, one.number, 255, [force], armed=True))
        assert disarm(connection, wire)
    pairs = [(rows[n], rows[n + 1]) for n in rows if n + 1 in rows]
    gained = np.array([1e-8 * (after[1] - before[1]) for before, after in pairs])
    sensed = np.array([5e-8 * before[2] for before, _ in pairs])
    np.testing.assert_allclose(gained, sensed * -np.expm1(-5.0 * 1e-3) / 5.0, rtol=0, atol=1.1e-8)
    assert len(pairs) > 50
    assert abs(np.diff(sensed)).max() > 10.0


def read_back(connection: Any, description: Any, words: list[int]) -> list[int]:
    """Sends a word with each force, which makes a sample; the inputs of each position. Less of them where the machine
    held the host up for longer than the watchdog."""
    seen, wire = [], arm(connection, description, schema.PACED_BY_HOST, 2047, schema.WITH_WORDS)
    for n, word in enumerate([*words, 0]):
        received = connection.receive(PATIENCE_S)
        if not received or received[0].kind == schema.STATUS:
            break
        seen.append(received[0].counts[-1] & 0xFFFFFFFF)
        signed = word - (word >> 31 << 32)
        connection.send(connection.frame(schema.FORCE, n % schema.SAMPLE_MODULUS, 255, [0, signed], armed=True))
    disarm(connection, wire)
    return seen


@pytest.mark.parametrize(("name", "wired"), [("linux", 0xFFFFFFFF), ("avr", 0x3F), ("cortex_m", 3)])
def test_a_boards_outputs_act_with_the_force_that_they_came_with_and_inputs_are_read_after_them(
    name: str, wired: int, start_board: Start
) -> None:
    """The board reads its own outputs back."""
    words = np.random.default_rng(3).integers(0, 2**32, points(200, 10**4 if name == "linux" else 1000))
    with connected(start_board(name)) as connection:
        description = describe(connection)
        assert description.has_words
        for part in np.array_split(words, -(-len(words) // 5000)):
            for _ in range(8):
                seen = read_back(connection, description, part.tolist())
                if len(seen) > len(part):
                    break
            assert [word & wired for word in seen] == [0, *(part & wired)]


def test_the_reference_firmware_logs_the_word_of_each_sample_and_reads_a_script(
    start_board: Start, built: Path, tmp_path: Path
) -> None:
    log, seen = tmp_path / "outputs.log", []
    board = start_board("linux", built, str(log), "3:80000001", "5:0")
    with connected(board) as connection:
        wire = arm(connection, describe(connection), schema.PACED_BY_HOST, 2047, schema.WITH_WORDS)
        for n in range(8):
            (one,) = connection.receive(PATIENCE_S)
            seen.append(one.counts[-1] & 0xFFFFFFFF)
            connection.send(connection.frame(schema.FORCE, n, 255, [0, 10 * n], armed=True))
        assert disarm(connection, wire)
    assert seen == [0, 0, 0, 0x80000001, 0x80000001, 0, 0, 0]
    lines = [[int(word, 16) for word in line.split()] for line in log.read_text("ascii").splitlines()]
    assert [line for line in lines if line[0]] == [*([n + 1, 10 * n] for n in range(8)), [9, 0]]


def pole_of_a_board(stiffness: float, damping: float, steps: int) -> tuple[float, float]:
    """k and b of 0.2 kg with 1 N·s/m in a loop of `steps` local periods in 1 ms, a delay of one and a window of all."""
    local = 1e-3 / steps
    move = expm(np.array([[0.0, 1.0, 0.0], [0.0, -5.0, 5.0], [0.0, 0.0, 0.0]]) * local)
    loop = np.zeros((3 + steps, 3 + steps))  # x, v, the acting force, the last positions
    loop[:2, :3] = move[:2]
    loop[2, 0], loop[2, -1] = -stiffness - damping * 1e3, damping * 1e3
    loop[3:, [0, *range(3, 2 + steps)]] = np.eye(steps)
    pole = max(np.linalg.eigvals(loop), key=abs)
    pole = np.log(pole + 0j) / local
    return 0.2 * abs(pole) ** 2, -0.4 * pole.real


def follow_a_line(connection: Any, pacing: int, samples: int, missed: float) -> tuple[dict[int, int], int]:
    """Lets a board follow 2000 N/m with 5 N·s/m to 0, without an answer to the share `missed` of its samples. Returns
    the first positions, in counts by their sample, and how many of all said that the answer had not come."""
    chance, description = np.random.default_rng(7), describe(connection)
    lines = description.lines
    assert lines is not None
    k, b, *_ = line_counts(2000.0, 5.0, -10.0, 10.0, lines.scales(0), 10.0)
    words, x, held, count = pack_line(k, b, -32767, 32767), dict[int, int](), 0, 0
    wire = arm(connection, description, pacing, 2047, schema.WITH_LINE)
    while count <= samples:
        received = connection.receive(PATIENCE_S)
        if not received or received[0].kind == schema.STATUS:
            break
        (one,) = received
        x.setdefault(one.number, one.counts[0])
        count += 1
        held += one.kind == schema.POSITION_HELD
        if chance.random() >= missed:
            force = round(-2000.0 * 1e-9 * one.counts[0] / description.force_scale[0])
            connection.send(connection.frame(schema.FORCE, one.number, 255, [force, *words], armed=True))
        elif pacing == schema.LOCKSTEP:
            connection.send(b"\0")  # a delimiter of no frame, so that time goes on
    disarm(connection, wire)
    return x, held


def judge_swing(x: dict[int, int], steps: int) -> None:
    """k and b, of the pole of the free swing, are those of the board's own loop."""
    triples = [[x[n], x[n + 1], x[n + 2]] for n in x if n > 40 and n + 1 in x and n + 2 in x]
    before, at, after = np.array(triples, float).T
    (first, second), *_ = np.linalg.lstsq(np.stack([at, before], 1), after, rcond=None)
    pole = np.log(np.roots([1.0, -first, -second])[0] + 0j) * 1e3
    expected = pole_of_a_board(2000.0, 5.0, steps)
    assert 0.2 * abs(pole) ** 2 == pytest.approx(expected[0], rel=0.01)
    assert -0.4 * pole.real == pytest.approx(expected[1], rel=0.01)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("name", "missed"), [("linux_lines", 0.33), ("cortex_m_lines", 0.0), ("cortex_m_lines", 0.33)])
def test_a_board_that_follows_lines_is_felt_as_its_own_loop_whatever_the_host_misses(
    name: str, missed: float, start_board: Start
) -> None:
    """The machine may hold up host and board, until no line lives any more: then it begins anew."""
    with connected(start_board(name)) as connection:
        for _ in range(8):
            x, held = follow_a_line(connection, schema.PACED_BY_DEVICE, 400, missed)
            if len(x) > 300 and held < 300:
                break
    judge_swing(x, 10)


@pytest.mark.parametrize("missed", [0.0, 0.33])
def test_an_avr_follows_lines_five_times_a_millisecond_and_no_local_period_is_late(
    missed: float, start_board: Start, built: Path
) -> None:
    """In virtual time, with bytes that take theirs at 1 Mbaud. Late: a force put out a quarter of a local period after
    its time."""
    board, samples = start_board("avr_lines", built, "lockstep=1"), points(400, 400)
    with connected(board) as connection:
        x, held = follow_a_line(connection, schema.LOCKSTEP, samples, missed)
    judge_swing({n: x[n] for n in x if n < 400}, 5)
    assert held == 0 if not missed else 0.2 * samples < held < 0.5 * samples
    forces = board.put_out()
    at = np.array([us for us, _ in forces[next(i for i, (_, counts) in enumerate(forces) if counts) : -2]])
    late = (at - at[0]) - 200 * np.arange(len(at))
    assert len(at) > 5 * (samples - 10)
    assert -50 < late.min() <= late.max() < 50


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(
    ("name", "clock"), [*((name, clock) for name in BOARDS for clock in ("device", "host")), ("hapkit", "device")]
)
def test_a_host_that_is_stopped_or_killed_leaves_no_force(
    name: str, clock: str, start_board: Start, start_hapsim: Start, swinging: Callable[[str], Path]
) -> None:
    board = start_board(name)
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for _ in range(4):
            host, status = start_host(start_hapsim, swinging(clock), board), 3
            os.kill(host.pid, number)
            if number == signal.SIGKILL:
                host.wait()
            seen = wait_for_the_end(board)
            # The force of the last answer, and its end: by the board's clock no later than its time to live allows. One
            # of the boards tells the time in whole samples; another puts out 255 forces only, so that up to four
            # answers in a row are the same and the last of them is no change.
            allowed = TIME_TO_LIVE + (2 if clock == "host" else 1.5) + (3 if name == "hapkit" else 0)
            assert life_of_the_last(board, clock) <= allowed * PERIOD_US
            if number == signal.SIGSTOP:
                time.sleep(1.0)  # the watchdog lasts a tenth of a second; the port is the stopped host's meanwhile
                os.kill(host.pid, signal.SIGCONT)  # and what it goes on to say moves nothing
                status = host.wait()
            if status != 4:  # a guard may end a run whose forces a busy machine held up: then it begins anew
                break
        assert status == 3, host.err
        if number == signal.SIGSTOP:
            assert "(100 samples)" in host.err
        else:
            wait_for_latch(board)
        assert not any(counts for _, counts in board.forces()[seen:])
    with connected(board) as connection:
        description = describe(connection)
        for _ in range(10):  # held up for longer than its watchdog, two seconds, it has latched anew
            arm(connection, description, schema.PACED_BY_DEVICE, description.max_watchdog_samples)
            fault = read_status_after_disarm(connection)
            if fault == schema.NO_FAULT:
                break
        assert fault == schema.NO_FAULT


def wait_for_the_end(board: Any) -> int:
    """Until the force is zero for longer than an answer lives; how often it has changed by then. A swing is at zero for
    a sample, too, while the host's last answer is on its way."""
    while True:
        seen = len(board.wait_for(lambda forces: forces[-1][1] == 0))
        time.sleep(1.5 * TIME_TO_LIVE * PERIOD_US * 1e-6)
        if len(board.forces()) == seen:
            return seen


def life_of_the_last(board: Any, clock: str) -> int:
    """Microseconds from the last answer to its end. Paced by the host, each answer is put out as it comes, and a host
    that waits too long for the next position sends the same one again, which lives anew; paced by the device, each tick
    puts out what it holds, and an answer is a change."""
    put_out = board.put_out() if clock == "host" else board.forces()
    last = max(at for at, (_, counts) in enumerate(put_out) if counts)
    return int(put_out[last + 1][0] - put_out[last][0])


def wait_for_latch(board: Any) -> None:
    """An armed device answers no DESCRIBE: an answer is one of a device that has latched."""
    with connected(board) as connection:
        for _ in range(60):
            with contextlib.suppress(DeviceError):
                assert read_register(connection, schema.REG_FAULT) == schema.HOST_QUIET
                return
    pytest.fail("the watchdog did not latch the board")


def read_status_after_disarm(connection: Any) -> int:
    from firmware_protocol.frames import armed_format

    assert disarm(connection, armed_format(1))
    return read_register(connection, schema.REG_FAULT)


@pytest.mark.parametrize(
    "name", ["linux", *(pytest.param(one, marks=pytest.mark.thorough) for one in ("avr", "cortex_m", "hapkit"))]
)
def test_a_tick_that_dies_ends_in_zero_force(
    name: str,
    built_to_die: Callable[[str], Path],
    start_board: Start,
    start_hapsim: Start,
    swinging: Callable[[str], Path],
) -> None:
    """Neither time to live nor watchdog is looked at any more; the hardware watchdog is."""
    board = start_board(name, built_to_die(name))
    for _ in range(10):
        start_host(start_hapsim, swinging("device"), board).wait()
        if name == "linux":  # on a busy machine a host may have ended before the tick died: then another one
            with contextlib.suppress(subprocess.TimeoutExpired):
                assert board.process.wait(5) == 1
                break
            continue
        with connected(board) as connection:
            describe(connection)
            if read_register(connection, schema.REG_ACCEPTED) == 0:  # reset, and not only disarmed or latched
                break
    forces = board.forces()
    assert forces[-1][1] == 0
    if name in ("avr", "hapkit"):  # whose clock neither stops with its tick nor begins anew with its reset
        assert forces[-2][1] != 0
        assert forces[-1][0] - forces[-2][0] < 100 * PERIOD_US


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc (Debian: apt install gcc libc6-dev)")
def test_the_build_names_the_files_that_it_wrote(tmp_path: Path) -> None:
    (tmp_path / "older").touch()
    built = subprocess.run([FIRMWARE / "build", tmp_path, "haply"], check=True, capture_output=True, text=True)
    assert built.stdout.splitlines()[-1] == f"Wrote to {tmp_path}: haply"
    assert (tmp_path / "haply").is_file()
