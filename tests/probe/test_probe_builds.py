"""The mock and every build of the firmware pass each check that can be seen of them; a build that is broken on purpose
fails the check that is there to find it, and what is printed names the fault and its section of PROTOCOL.md.

These run on ports and in real time, at 1 kHz or, the Arduino sketch, at 250 Hz. Where this machine is busy with other
tests it may hold a device or its judge up: then what depends on time is judged again (`attempts.py`), and nothing else.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rich.console import Console

from hapsim.bringup.probe import STEPS, Check, Judgement, Leave, judge, open_wire, steps_of
from hapsim.cli.probe import show_judgement
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.scene import Scene
from tests.attempts import attempts

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")

LIMIT, MASS = 10.0, 0.2  # N, kg: of every device here
# Far enough for a push of which the opposite one was late; no hand is on these devices.
LEAVE = Leave(force=1.2 * LIMIT, travel=0.2, mass=MASS)
KNOB = Leave(force=0.012, travel=3.0, mass=1.2e-5)  # N·m, rad, kg·m²
# In QEMU the samples that come in time are too few to see the knob's response in counts of 14 bits a turn.
MOTOR = Leave(force=0.024, travel=3.0, mass=2e-5)
LEAVES = {"simplefoc": KNOB, "arduino": MOTOR}
TIMED = STEPS[STEPS.index("arming") :]

NO_ACCELERATION = {
    "accelerations": "no acceleration is sensed (register 15)",
    "acceleration": "no acceleration is sensed (register 15, bit 0)",
}
UNSENSED = {"velocities": "no velocity is sensed (register 38)", **NO_ACCELERATION}
LINE_PUSHES = ("line_stiffness", "line_damping", "line_bounds", "line_missed")
NO_LINES = {
    **dict.fromkeys(("lines", "line_rejected", "line_kept"), "no lines are followed (register 15, bit 3)"),
    **dict.fromkeys(LINE_PUSHES, "no lines are followed"),
}
WITH_WORDS = ("linux_lines", "avr", "cortex_m")
NO_SERVO = {
    "servo_registers": "no position commands are followed",
    **dict.fromkeys(
        ("commands", "servo_brakes"),
        "no position commands are followed, or no hand force is sensed (register 15)",
    ),
}
NO_WORDS = dict.fromkeys(("words", "words_looped"), "no digital words (register 15, bit 2)")
TOO_SLOW = "3636 frames of 11 B at 250 Hz take 14.5 s: too long to fill what buffers"
ARDUINO = {
    **UNSENSED,
    **dict.fromkeys(("tick_goes_on", "whole_frames", "watchdog_blocked"), TOO_SLOW),
}
NOT_SEEN = {
    "mock": {
        "lockstep": "declared; whether there is a motor cannot be seen on the wire",
        "limit_cut": "32 bits of counts carry no force above the limit",
    },
    "avr": NO_ACCELERATION,
    "cortex_m": NO_ACCELERATION,
    "linux_lines": {},
    "simplefoc": UNSENSED,
    "arduino": ARDUINO,
    "arduino_uno": ARDUINO,
    "simplefoc_cortex_m": UNSENSED,
}
UNTIL = dict.fromkeys(("arduino_uno", "cortex_m", "simplefoc_cortex_m"), "watchdog")
"""Last step of boards on emulated chips, where others of the same sources take all: `arduino`, `linux_lines`,
`simplefoc`, and `avr`, whose port is its own."""
# QEMU's clock stands still while it emulates what an interrupt does: its rate is this machine's, 0.85 kHz or so.
OF_THE_EMULATOR = {name: {"rate_kept"} for name in ("cortex_m", "simplefoc_cortex_m")}


@pytest.fixture(autouse=True)
def _before_other_programs() -> Iterator[None]:
    """Gives this process the boards' priority if permitted: a delayed judge sees less."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, -15)
    yield
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, usual)


@contextlib.contextmanager
def mock_port() -> Iterator[str]:
    device = {"clock": "device", "mass": MASS, "force_limit": LIMIT}
    modules = {"hand": {"type": "device", "channel": 0}}
    scene = Scene.model_validate({"version": 1, "rate": 1000.0, "device": device, "modules": modules})
    with serving(assemble_mock(scene), as_hardware=True) as path:
        yield path


def judged(
    start: Callable[[], str], expected: Callable[[Check], bool], leave: Leave, steps: tuple[str, ...]
) -> dict[str, Check]:
    """Every check of these steps, of the device at the port that `start` gives; those of a step that time may have
    spoiled as they came out last. A board that its hardware watchdog ended, because the machine held it up, is started
    again."""
    checks: dict[str, Check] = {}
    port, again = start(), steps
    for _ in attempts():
        with open_wire(port) as wire:
            judgement = judge(wire, leave=leave, steps=steps_of(again, None))
        checks |= {check.name: check for check in judgement.checks if check.step in again}
        again = tuple(step for step in TIMED if not all(expected(c) for c in checks.values() if c.step == step))
        if not judgement.released:
            port, again = start(), again or steps[-1:]
        if not again:
            break
    assert judgement.released
    return checks


@pytest.mark.parametrize(
    "name", ["mock", *(pytest.param(one, marks=pytest.mark.thorough) for one in NOT_SEEN if one != "mock")]
)
def test_a_sound_device_passes_every_check_that_can_be_seen_of_it(name: str, request: pytest.FixtureRequest) -> None:
    lines = {} if name == "linux_lines" else NO_LINES
    words = {} if name in WITH_WORDS else NO_WORDS
    not_seen, of_the_emulator = lines | words | NO_SERVO | NOT_SEEN[name], OF_THE_EMULATOR.get(name, set())

    def expected(check: Check) -> bool:
        if check.name in not_seen:
            return (check.result, check.found) == ("not seen", not_seen[check.name])
        return check.result == "pass" or check.name in of_the_emulator

    with contextlib.ExitStack() as stack:
        start_board = request.getfixturevalue("start_board") if name != "mock" else None
        start = (lambda: start_board(name).port) if start_board else (lambda: stack.enter_context(mock_port()))
        checks = judged(start, expected, LEAVES.get(name, LEAVE), steps_of((), UNTIL.get(name)))
    others = {check.name: (check.result, check.found) for check in checks.values() if not expected(check)}
    assert not others, others


# The step that is looked at; how the line begins that tells the failure; which fault it names; where it says to look.
BROKEN = {
    "sign": ("push", "sign (§ 6)", "inverted: 1 N makes -", "swap the motor's two wires, or reverse the encoder"),
    "scale": ("push", "mass (§ 5)", "as if positions were", "position_scale (an encoder's edges counted once, twice"),
    "acceleration": ("push", "acceleration (§ 6)", "there, -", "acceleration_scale (g or m/s²"),
    "rate": ("arming", "rate_kept (§ 6)", "% from register 4 (1000 Hz)", "the sample timer's divider"),
    "transmitter": ("blocked", "tick_goes_on (§ 8)", "the device went away here", "a tick that died or waits for room"),
    "tick": ("arming", "numbers (§ 6)", "the device went away here", "hardware watchdog, which ends a tick that died"),
    "watchdog": ("watchdog", "latches (§ 7)", "watchdog 40: still armed at sample", "n - heard > watchdog"),
    "arrival": ("push", "delay (§ 6)", "within the sample that the force came in", "FORCE is put out on arrival"),
}


def printed(judgement: Judgement) -> list[str]:
    """Returns the printed text of each failure, without its line breaks."""
    shown = io.StringIO()
    show_judgement(Console(file=shown, width=100), judgement)
    blocks = re.split(r"\n(?=\S|$)", shown.getvalue())
    return [" ".join(block.split()) for block in blocks if block.startswith("FAIL")]


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("name", BROKEN)
def test_a_build_that_is_broken_on_purpose_is_found_out(name: str, start_broken_board: Callable[[str], Any]) -> None:
    """A judge that was held up may see the device go away one check later, or nothing, or something else too."""
    step, check, fault, look_at = BROKEN[name]
    for _ in attempts():
        with open_wire(start_broken_board(name).port) as wire:
            judgement = judge(wire, leave=LEAVE, steps=steps_of((step,), None))
        failures = printed(judgement)
        if name == "scale":  # its accelerations, which are right, contradict those positions too
            failures = [one for one in failures if not one.startswith("FAIL acceleration (§ 6): ")]
        if len(failures) == 1 and failures[0].startswith(f"FAIL {check}:"):
            break
    assert len(failures) == 1, failures
    assert re.fullmatch(
        rf"FAIL {re.escape(check)}: .*{re.escape(fault)}.*expected: .*look at: .*{re.escape(look_at)}.*", failures[0]
    )
    assert judgement.exit_status == 3


def test_every_build_that_is_broken_on_purpose_is_judged(built_broken: Any) -> None:
    assert {path.name for path in built_broken.iterdir()} - {"done"} == BROKEN.keys()
