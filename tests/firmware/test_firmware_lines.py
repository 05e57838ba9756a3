"""A whole host with `law: board` before the firmware that follows its lines: k and b are within 1 % of the prediction,
whatever the wire and however late the host. In virtual time (simavr); the host that is killed, in real time."""

from __future__ import annotations

import functools
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from late_hosts import FarAway, MissesThird
from test_firmware_boards import FIRMWARE, PERIOD_US, SWINGING, TIME_TO_LIVE, start_host, wait_for_latch

import hapsim
from hapsim.scene import Scene, parse_scene

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="boards stand on pseudo-terminals of Linux")
BOARD_RATE = 5000


def scene_at(port: str, rate: int, **device: Any) -> Scene:
    of_device = {"clock": "lockstep", "port": port, "mass": 0.2, "friction": 1.0, "force_limit": 10}
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground"},
        "touch": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 2000, "damping": 5},
    }
    of_device |= {"law": "board", "board_rate": BOARD_RATE} | device
    return parse_scene(
        yaml.safe_dump({"version": 1, "rate": rate, "device": of_device, "modules": modules}), "test.yaml"
    )


def measured(scene: Scene, between: Any = None) -> tuple[Any, list[Any]]:
    """Requires k and b within 1 % of the prediction. Returns the measurement, and the transports put between."""
    made: list[Any] = []

    def wrap(transport: Any) -> Any:
        made.append(between(transport))
        return made[-1]

    run = functools.partial(hapsim.run, portable=True, between=wrap) if between else hapsim.run
    found, predicted = hapsim.measure(scene, duration=0.6, run=run), hapsim.predict(scene)
    assert found.k == pytest.approx(predicted.k, rel=0.01)
    assert found.b == pytest.approx(predicted.b, rel=0.01)
    return found, made


@pytest.fixture
def at_avr(start_board: Callable[..., Any], built: Path) -> str:
    """Port of an AVR in lockstep."""
    return str(start_board("avr_lines", built, "lockstep=1").port)


def test_the_loop_in_python_is_felt_as_predicted_though_it_misses_a_third_of_its_deadlines(at_avr: str) -> None:
    found, (between,) = measured(scene_at(at_avr, 1000), MissesThird)
    assert between.missed > 0.3 * found.trace.sample.size
    assert found.k_uncertainty < 0.01 * found.k


def test_a_wire_of_fifteen_samples_is_felt_as_predicted(at_avr: str) -> None:
    """As old as an answer may be for an AVR, which remembers 16 reports. The host's law would be unstable from 3 on."""
    measured(scene_at(at_avr, 1000, delay=15), FarAway)


@pytest.mark.thorough
def test_250_hz_over_115200_baud_is_felt_as_predicted(start_board: Callable[..., Any], once: Any) -> None:
    defines = {"DEFINES": "-DSIMULATED_SLOW -DHAPSIM_BAUD=115200ul"}
    slow = once("slow_lines", ["bash", "-c", f'"{FIRMWARE}/build" "$0" avr'], defines)
    found, _ = measured(scene_at(start_board("avr_lines", slow, "lockstep=1").port, 250, baud=115200))
    assert found.trace.report.deadline_misses == 0
    assert found.trace.report.crc_errors == 0


STEPS = 10  # local periods in a sample, a force in each


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_host_that_is_stopped_or_killed_leaves_no_line(
    number: int, start_board: Callable[..., Any], start_hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    """The force is zero once the last line's time to live is over, and what a host says that goes on moves nothing."""
    scene = tmp_path / "swinging.yaml"
    scene.write_text(SWINGING.read_text("utf-8").replace("{clock: device", "{clock: device, law: board"), "utf-8")
    board, status = start_board("linux_lines"), 0
    for _ in range(4):
        host = start_host(start_hapsim, scene, board)
        os.kill(host.pid, number)
        signalled = len(board.put_out())  # at the latest
        board.wait_for(lambda forces: forces[-1][1] == 0)
        time.sleep(1.5 * TIME_TO_LIVE * PERIOD_US * 1e-6)
        put_out = board.put_out()
        last = max(at for at, (_, counts) in enumerate(put_out) if counts)
        ended, seen = last + 1, len(put_out)
        assert ended - signalled <= (TIME_TO_LIVE + 2) * STEPS  # of the board's, however late this machine is
        if number == signal.SIGSTOP:
            time.sleep(1.0)  # the watchdog lasts a tenth of a second
            os.kill(host.pid, signal.SIGCONT)
        status = host.wait()
        if status != 4:  # a guard may have ended it before, on a machine that held it up
            break
    assert status == (3 if number == signal.SIGSTOP else -signal.SIGKILL), host.err
    if number == signal.SIGKILL:
        wait_for_latch(board)
    assert not any(counts for _, counts in board.put_out()[seen:])
