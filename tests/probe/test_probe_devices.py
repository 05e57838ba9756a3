"""A whole device passes every check; one with a fault fails the check that names it, and says what was found.

Real time takes part only as far as samples pass in it: no duration is asserted, and a machine that holds up host and
device makes a check "not seen" or an estimate less certain, as on a user's desk.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.mock.terminal import serving as serving_mock
from hapsim.probe import Check, Leave, probe, steps_of
from hapsim.probe.wire import Wire
from hapsim.scene import Scene

Serving = Callable[..., Any]
GENTLE = Leave(force=0.5, travel=0.005, mass=0.2)


def judge(port: str, *only: str, leave: Leave | None = None) -> dict[str, Check]:
    judgement = probe(port, leave=leave, steps=steps_of(only, None))
    assert judgement.released
    assert not judgement.ended
    assert judgement.exit_status == (3 if judgement.failed else 0)
    return {check.name: check for check in judgement.checks}


def failed(checks: dict[str, Check]) -> set[str]:
    return {name for name, check in checks.items() if check.result == "FAIL"}


def told(checks: dict[str, Check]) -> str:
    return "\n".join(f"{check.result} {name}: {check.found}" for name, check in checks.items())


def test_a_whole_device_passes_and_is_never_pushed_without_leave(serving: Serving) -> None:
    with serving(channels=4) as device:
        checks = judge(device.port)
    assert failed(checks) == set(), told(checks)
    not_seen = {name for name, check in checks.items() if check.result == "not seen"}
    pushes = {"sign", "delay", "mass", "time_to_live", "limit_cut", "host_time_to_live"}
    # How steady the rate is, and whether an answer is in time, lies with this machine too.
    assert not_seen - {"rate_kept", "in_time"} == {"wrong_sensing", *pushes}, told(checks)
    assert device.last == {"largest": 0.0, "state": 0, "output": [0.0] * 4}


def test_a_whole_device_passes_the_pushes_that_stay_within_the_leave(serving: Serving) -> None:
    with serving(senses=False, limit=0.4) as device:
        checks = judge(device.port, "push", leave=GENTLE)
    assert failed(checks) == set(), told(checks)
    seen = ("sign", "delay", "mass", "time_to_live", "limit_cut", "host_time_to_live")
    assert {name: checks[name].result for name in seen} == dict.fromkeys(seen, "pass"), told(checks)
    assert 0.4 < device.last["largest"] <= 0.5
    assert (device.last["state"], device.last["output"]) == (0, [0.0])


FAULTS = {
    "answers_damaged": ("registers", {"damaged_frames"}, "a bit flipped"),
    "chatters": ("registers", {"silence"}, "bytes in"),
    "any_schema": ("refusals", {"wrong_schema", "stays_idle"}, "armed"),
    "skips": ("arming", {"numbers"}, "49, then 51"),
    "fast": ("arming", {"rate_kept"}, "from register 4"),
    "always_fresh": ("forces", {"withheld", "held"}, "POSITION"),
    "never_expires": ("forces", {"expired", "accepted"}, "too old"),
    "no_watchdog": ("watchdog", {"latches"}, "still armed at sample 44"),
    "latches_in_setup": ("watchdog", {"latched_status"}, "in the set-up format"),
    "keeps_counters": ("watchdog", {"rearming"}, "held"),
    "waits_for_room": ("blocked", {"tick_goes_on", "watchdog_blocked"}, "stopped while the host did not read"),
    "tears_frames": ("blocked", {"whole_frames"}, "no frame"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_and_named(serving: Serving, fault: str) -> None:
    step, names, words = FAULTS[fault]
    with serving(fault, channels=4) as device:
        checks = judge(device.port, step)
    assert failed(checks) == names, told(checks)
    assert any(words in checks[name].found and checks[name].look_at for name in names), told(checks)


def test_a_host_that_is_not_heard_paces_a_device_without_a_watchdog(serving: Serving) -> None:
    with serving("no_watchdog", pacings=2) as device:
        checks = judge(device.port, "host")
    assert failed(checks) == {"host_watchdog"}, told(checks)


PUSHED = {
    "inverted_sign": ("sign", "inverted"),
    "on_arrival": ("delay", "within the sample that the force came in"),
    "wrong_scale": ("mass", "as if positions were"),
    "never_ends": ("time_to_live", "it goes on"),
}


@pytest.mark.parametrize("fault", PUSHED)
def test_what_shows_in_the_motion_alone_is_found_and_named(serving: Serving, fault: str) -> None:
    name, words = PUSHED[fault]
    with serving(fault, pacings=1) as device:
        checks = judge(device.port, "push", leave=GENTLE)
    assert checks[name].result == "FAIL", told(checks)
    assert words in checks[name].found
    # Who puts a force out early makes more of it; who never ends one, too.
    assert failed(checks) <= {name, "mass"} if fault != "inverted_sign" else failed(checks) == {name}, told(checks)
    assert device.last["largest"] <= GENTLE.force


def test_a_force_without_an_end_shows_where_the_host_paces_too(serving: Serving) -> None:
    with serving("never_ends") as device:
        checks = judge(device.port, "push", leave=GENTLE)
    assert failed(checks) >= {"time_to_live", "host_time_to_live"}, told(checks)


@pytest.mark.parametrize(
    ("registers", "name", "words"),
    [
        ({0: 2}, "version", "2"),
        ({1: 0x12345678}, "schema", "0x12345678"),
        ({2: 17}, "channels", "17"),
        ({3: 0}, "pacings", "none"),
        ({3: 9}, "pacings", "0x9"),
        ({4: 0, 5: 0}, "rate", "0 Hz"),
        ({4: 0x40790000, 5: 0}, "rate", "Hz"),  # 400 Hz, its words swapped
        ({6: 0}, "max_watchdog", "0 samples"),
        ({6: 2048}, "max_watchdog", "2048 samples"),
        ({16: 0x00FF4142}, "name", "BA"),
        ({33: 0xBFF00000}, "position_scale", "-"),
        ({35: 0x7FF00000, 34: 0}, "force_scale", "inf"),
        ({37: 0x7FF80000}, "force_limit", "nan"),
        ({45: 0, 44: 0}, "force_limit", "0"),
        ({46: 0, 47: 0}, "velocity_scale", "0"),
        ({13: 1}, "unknown_registers", "register 13"),
    ],
)
def test_a_register_that_cannot_be_is_named(serving: Serving, registers: dict[int, int], name: str, words: str) -> None:
    with serving(channels=2, registers=registers) as device:
        checks = judge(device.port, "registers")
    assert failed(checks) == {name}, told(checks)
    assert words in checks[name].found


def test_the_mock_passes(new_scene: Callable[..., Scene]) -> None:
    scene = new_scene(16, rate=500.0, device={"clock": "device", "friction": 1.0}, mock={"initial": {"velocity": 0.01}})
    with serving_mock(assemble_mock(scene)) as port:
        checks = judge(port, leave=GENTLE)
    # Its timer is this machine's: whoever holds that up, slows it down.
    assert failed(checks) - {"rate_kept"} == set(), told(checks)
    seen = ("whole_frames", "watchdog_blocked", "sign", "delay", "mass", "time_to_live", "host_time_to_live")
    assert {name: checks[name].result for name in seen} == dict.fromkeys(seen, "pass"), told(checks)


def test_a_stop_releases_the_device_and_says_how_far_it_came(serving: Serving) -> None:
    wires: list[Wire] = []

    def stop_in_time(step: str, _number: int, _of: int) -> None:
        if step == "arming":
            wires[0].stop = True

    with serving() as device:
        judgement = probe(device.port, on_step=stop_in_time, on_wire=wires.append)
    assert (judgement.interrupted, judgement.exit_status, judgement.released) == (True, 130, True)
    results = {check.name: check.result for check in judgement.checks}
    assert (results["version"], results["arm"]) == ("pass", "not seen")
    assert device.last["state"] == 0
