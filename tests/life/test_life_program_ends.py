"""The force ends with the program: however a program that started a session ends, the device is disarmed before the
interpreter frees the memory that the loop runs in.

The device is in this process, on a pseudo-terminal. In virtual time no watchdog releases it, so that it is idle
only where the program disarmed it.
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from firmware_protocol import schema
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.scene import parse_scene

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the mock on a pseudo-terminal")

SCENE = (Path(__file__).parents[2] / "configs" / "first_touch.yaml").read_text("utf-8")
BEGINNING = """
import signal, threading, time

def runs(session):
    while session.statistics().age.total < 100 and not session.wait(0.01): pass
    return session

signal.alarm(100)  # for a program that hangs
scene = parse_scene(sys.argv[1])
"""


@pytest.fixture
def ends(start_hapsim: Callable[..., Any]) -> Callable[..., tuple[int, str, Any]]:
    """Runs a program beside a device until it ends: its status, its standard error, and the device."""

    def run(program: str, clock: str = "lockstep", stiffness: int = 2000) -> tuple[int, str, Any]:
        text = SCENE.replace("clock: device", f"clock: {clock}").replace("stiffness: 2000", f"stiffness: {stiffness}")
        mock = assemble_mock(parse_scene(text))
        with serving(mock) as port:
            text = text.replace("device:\n", f"device:\n  port: {port}\n")
            ended = start_hapsim(text, program=BEGINNING + program)
            ended.wait(120.0)
            while clock == "device" and mock.board.state == schema.ARMED:
                time.sleep(0.01)
        return ended.wait(), ended.err, mock

    return run


WAYS_OUT = {
    "a normal end": ("session = runs(hapsim.start(scene))", 0, ""),
    "an end without a name for the session": ("runs(hapsim.start(scene))", 0, ""),
    "an exception": (
        "stack = contextlib.ExitStack()\nsession = runs(stack.enter_context(hapsim.start(scene)))\nraise ValueError",
        1,
        "ValueError\n",
    ),
    "sys.exit": ("session = runs(hapsim.start(scene))\nsys.exit(7)", 7, ""),
    "Ctrl-C": (
        "session = runs(hapsim.start(scene))\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)",
        -2,
        "KeyboardInterrupt\n",
    ),
    "Ctrl-C again at the end": (
        "session = runs(hapsim.start(scene))\n"
        "end = hapsim.Session._end\n"
        "hapsim.Session._end = lambda self: [os.kill(os.getpid(), signal.SIGINT), end(self)][1]",
        0,
        "",
    ),
    "a kernel that restarts": (
        "names = {'hapsim': hapsim, 'scene': scene, 'runs': runs}\n"
        "exec('session = hapsim.start(scene)', names)\nexec('runs(session)', names)",
        0,
        "",
    ),
    "two sessions": (
        "memory = scene.model_copy(update={'device': scene.device.model_copy(update={'port': None})})\n"
        "both = [runs(hapsim.start(one, transport=on)) for one, on in ((memory, 'terminal'), (scene, 'auto'))]",
        0,
        "",
    ),
    "a thread that outlives the main one": (
        "session = runs(hapsim.start(scene))\n"
        "def play():\n"
        "    with session:\n"
        "        threading.main_thread().join()\n"
        "        before = session.progress().ticks\n"
        "        while session.progress().ticks < before + 100: assert not session.wait(0.01)\n"
        "    print('played', file=sys.stderr)\n"
        "threading.Thread(target=play).start()",
        0,
        "played\n",
    ),
}


@pytest.mark.parametrize("way", WAYS_OUT)
def test_every_way_out_of_a_program_disarms_the_device(ends: Callable[..., Any], way: str) -> None:
    program, status, last = WAYS_OUT[way]
    found, err, mock = ends(program)
    assert (found, mock.board.state) == (status, schema.IDLE), err
    assert not mock.commands.any()
    assert "defect" not in err
    assert err.endswith(last)
    assert last or not err


def test_the_end_of_the_program_reports_what_stopped_a_session_that_was_not_closed(ends: Callable[..., Any]) -> None:
    status, err, mock = ends(
        "session = hapsim.start(scene, judges_energy=True)\nassert session.wait(60.0)", stiffness=20000
    )
    assert (status, mock.board.state) == (0, schema.IDLE)
    assert err.startswith("hapsim: /dev/")
    assert "energy" in err
    assert err.count("\n") == 1


def test_of_a_program_that_is_killed_the_watchdog_releases(ends: Callable[..., Any]) -> None:
    status, err, mock = ends("runs(hapsim.start(scene))\nos.kill(os.getpid(), 9)", clock="device")
    assert status == -9, err
    assert mock.board.state == schema.LATCHED
    assert not mock.commands.any()


def test_a_second_session_on_a_port_names_the_first_and_how_to_stop_it(ends: Callable[..., Any]) -> None:
    status, err, mock = ends(
        "runs(hapsim.start(scene))\n"
        "try: hapsim.start(scene)\n"
        "except hapsim.errors.UsageError as error: print(error, file=sys.stderr)\n"
        "(session,) = hapsim.sessions()\n"
        "session.close()\n"
        "assert hapsim.sessions() == []\n"
        "with hapsim.start(scene) as again: runs(again)\n"
    )
    assert (status, mock.board.state) == (0, schema.IDLE), err
    assert re.fullmatch(r"/dev/\S+: a session of this program, which runs .*`hapsim.sessions\(\)`.*\n", err), err
