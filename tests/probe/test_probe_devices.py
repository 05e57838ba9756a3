"""A whole device passes every check; one with a fault fails the check that names it, and says what was found.

Host, device and what is between them are played in virtual time: nothing waits, and every run is the same.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hapsim.bringup.probe import CHECKS, STEPS, Check, Leave, judge, steps_of
from hapsim.bringup.probe.probing import SECTIONS

PROTOCOL = Path(__file__).resolve().parents[2] / "firmware_protocol" / "PROTOCOL.md"
NewBench = Callable[..., Any]
GENTLE = Leave(force=0.5, travel=0.005, mass=0.2)
PUSHES = ("sign", "delay", "mass", "acceleration", "time_to_live", "limit_cut", "host_time_to_live")
LINES = ("lines", "line_rejected", "line_kept")
WORDS = ("words", "words_looped")
SERVO = {"servo_registers", "commands", "servo_brakes"}
LINE_PUSHES = ("line_stiffness", "line_damping", "line_bounds", "line_missed")


def judged(bench: Any, *only: str, leave: Leave | None = None) -> dict[str, Check]:
    judgement = judge(bench.wire, leave=leave, steps=steps_of(only, None))
    assert judgement.released
    assert not judgement.ended
    assert judgement.exit_status == (3 if judgement.failed else 0)
    assert (bench.device.state, set(bench.device.output)) == (0, {0.0})
    return {check.name: check for check in judgement.checks}


def failed(checks: dict[str, Check]) -> set[str]:
    return {name for name, check in checks.items() if check.result == "FAIL"}


def summary(checks: dict[str, Check]) -> str:
    return "\n".join(f"{check.result} {name}: {check.found}" for name, check in checks.items())


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"channels": 4, "rate": 1000.0},
        {"senses": False, "rate": 2000.0},
        {"accelerates": True, "channels": 2},
        {"senses": False, "accelerates": True},
        {"accelerates": True, "steps": 4, "channels": 2},
        {"steps": 10},
        {"words": 3},
        {"words": 0, "channels": 3, "steps": 4, "accelerates": True},
        {"servo": (0.5, 5.0), "channels": 2},
        {"servo": (0.5, 5.0), "senses": False},
    ],
)
def test_a_whole_device_passes_and_is_never_pushed_without_leave(new_bench: NewBench, options: dict[str, Any]) -> None:
    bench = new_bench(**options)
    checks = judged(bench)
    not_to_be_seen = {*PUSHES, *LINE_PUSHES} | ({"velocities"} if "senses" in options else set())
    not_to_be_seen |= set() if "steps" in options else set(LINES)
    not_to_be_seen |= set() if options.get("accelerates") else {"accelerations"}
    not_to_be_seen |= {"servo_brakes"} if "servo" in options else SERVO
    not_to_be_seen |= set(WORDS) if "words" not in options else set() if options["words"] else {"words_looped"}
    assert {name for name, check in checks.items() if check.result == "not seen"} == not_to_be_seen, summary(checks)
    assert failed(checks) == set(), summary(checks)
    assert bench.device.largest == 0.0


@pytest.mark.parametrize(
    ("fault", "wrong"), [("", set()), ("never_brakes", {"servo_brakes"}), ("brakes_softly", {"servo_brakes"})]
)
@pytest.mark.parametrize(("braking", "watchdog"), [(0.002, 2047), (0.5, 2047), (0.05, 300)])
def test_a_servo_without_its_host_rests_within_its_braking(
    new_bench: NewBench, fault: str, wrong: set[str], braking: float, watchdog: int
) -> None:
    bench = new_bench(*filter(None, [fault]), servo=(0.5, braking), rate=1000.0, max_watchdog=watchdog)
    checks = judged(bench, "servo", "push", leave=Leave(force=1.0, travel=0.02))
    assert checks["commands"].result == "pass"
    assert failed(checks) & SERVO == wrong, summary(checks)


def test_an_output_that_is_wired_to_an_input_has_to_show_in_the_position_after_the_answered_one(
    new_bench: NewBench,
) -> None:
    checks = judged(new_bench(words=2), "words")
    assert checks["words_looped"].found == (
        "output 0 in input 0 and 1 more: 1 after the position that the FORCE answers"
    )
    checks = judged(new_bench("late_outputs", words=2), "words")
    assert failed(checks) == {"words_looped"}, summary(checks)
    assert ": 2 after" in checks["words_looped"].found


def test_outputs_that_no_input_shows_are_left_to_the_eye_and_a_lost_bit_is_a_fault(new_bench: NewBench) -> None:
    checks = judged(new_bench(words=0), "words")
    assert (checks["words"].result, checks["words_looped"].result) == ("pass", "not seen")
    assert "LEDs" in checks["words_looped"].found
    assert failed(judged(new_bench("short_words", words=0), "words")) == {"words"}


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_a_whole_device_passes_the_pushes_that_stay_within_the_leave(new_bench: NewBench, rate: float) -> None:
    bench = new_bench(accelerates=True, limit=0.4, rate=rate)
    checks = judged(bench, "push", leave=GENTLE)
    assert failed(checks) == set(), summary(checks)
    assert {name: checks[name].result for name in PUSHES} == dict.fromkeys(PUSHES, "pass"), summary(checks)
    assert 0.4 < bench.device.largest <= 0.5


@pytest.mark.parametrize(
    ("fault", "wrong"),
    [
        ("", set()),
        ("any_bounds", {"line_rejected", "line_kept"}),
        ("never_forgets", {"line_kept"}),
        ("wrong_shift", {"line_stiffness"}),
        ("newest_position", {"line_stiffness"}),
        ("short_window", {"line_damping"}),
        ("no_bounds", {"line_bounds"}),
        ("keeps_pushing", {"line_missed"}),
    ],
)
@pytest.mark.parametrize(("steps", "kept_reports"), [(4, 16), (10, 32)])
@pytest.mark.thorough(keep=9)
def test_a_device_that_follows_lines_answers_a_kept_sample_clips_and_bridges_missed_frames(
    new_bench: NewBench, fault: str, wrong: set[str], steps: int, kept_reports: int
) -> None:
    bench = new_bench(*filter(None, [fault]), steps=steps, kept_reports=kept_reports, rate=1000.0)
    checks = judged(bench, "lines", "push", leave=Leave(force=1.0, travel=0.01, mass=0.2))
    names = failed(checks) & {*LINES, *LINE_PUSHES}
    if fault == "short_window" and kept_reports == 16:  # too short for its noise
        assert not names
        assert checks["line_damping"].result == "not seen"
        return
    assert names == wrong or (fault and names and names <= wrong), summary(checks)
    if not fault:
        assert {checks[name].result for name in (*LINES, *LINE_PUSHES)} == {"pass"}, summary(checks)


@pytest.mark.parametrize(
    ("fault", "off_by", "result", "says"),
    [
        ("", 1.0, "pass", r"^1 N makes 5\.0\d* m/s² there, 1\.01 times that of the positions; acceleration_age: 0$"),
        ("", 0.8, "pass", r"1\.26 times"),
        ("", 0.7, "FAIL", r"1\.44 times"),
        ("", 9.80665, "FAIL", r"0\.103 times"),
        ("", -1.0, "FAIL", r"-1\.01 times"),
        ("late_acceleration", 1.0, "pass", "acceleration_age: 1$"),
        ("inverted_sign", 1.0, "pass", r"1 N makes -5\.0\d* m/s² there, 1\.01 times"),
    ],
)
def test_an_acceleration_that_the_positions_contradict_is_found_with_its_factor(
    new_bench: NewBench, fault: str, off_by: float, result: str, says: str
) -> None:
    """Half a per cent of a factor is the friction, within a sample; the rest of it a position's rounding."""
    checks = judged(new_bench(fault, accelerates=True, acceleration_off_by=off_by), "push", leave=GENTLE)
    assert checks["acceleration"].result == result, summary(checks)
    assert re.search(says, checks["acceleration"].found), checks["acceleration"].found


def test_without_the_sensor_no_acceleration_is_judged(new_bench: NewBench) -> None:
    check = judged(new_bench(), "push", leave=GENTLE)["acceleration"]
    assert (check.result, check.found) == ("not seen", "no acceleration is sensed (register 15, bit 0)")


def test_what_passes_beyond_the_nominal_is_reported_with_what_is_allowed(new_bench: NewBench) -> None:
    checks = judged(new_bench(senses=False, limit=0.4), leave=GENTLE)
    for name, allowed in {
        "rate_kept": "; 1 % is allowed",
        "latches": " is allowed)",
        "host_watchdog": " ms or more is allowed: this host may read it late)",
        "mass": " (within 25 %, and its uncertainty, is allowed)",
        "time_to_live": "; from 0.65 up and up to 0.35 are allowed",
        "host_time_to_live": " (up to 1.5 times is allowed, and shorter is safe)",
    }.items():
        assert (checks[name].result, checks[name].found[-len(allowed) :]) == ("pass", allowed)
    assert "-0.00" not in summary(checks)
    assert checks["round_trip"].found.count(" ms") == 4
    assert checks["jitter"].found.count(" ms") == 3


def test_a_coarse_encoder_takes_the_whole_leave_and_longer_pushes(new_bench: NewBench) -> None:
    bench = new_bench(scale=2e-5)
    checks = judged(bench, "push", leave=GENTLE)
    assert checks["sign"].result == "pass", summary(checks)
    assert bench.device.largest == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_how_many_times_the_response_of_the_given_mass_it_is(new_bench: NewBench, factor: float) -> None:
    """A device of 0.2 kg that is said to weigh twice as much responds twice as much as that mass would."""
    checks = judged(new_bench(), "push", leave=replace(GENTLE, mass=0.2 * factor))
    found = re.search(r"like (\S+) kg: (\S+) times the response of (\S+) kg", checks["mass"].found)
    assert found is not None, summary(checks)
    assert [float(one) for one in found.groups()] == pytest.approx([0.2, factor, 0.2 * factor], rel=0.05)


@pytest.mark.parametrize(("limit", "needed"), [(10.0, 12), (0.5, 0.6)])
def test_a_leave_below_or_at_the_limit_gets_what_it_takes_to_try_the_cut(
    new_bench: NewBench, limit: float, needed: float
) -> None:
    bench = new_bench(limit=limit)
    check = judged(bench, "push", leave=GENTLE)["limit_cut"]
    assert (check.result, check.found) == ("not seen", f"this takes --push {needed:g}: 1.2 times the limit")
    assert 0.0 < bench.device.largest <= 0.5


def test_forces_that_are_all_late_do_not_accuse_the_device(new_bench: NewBench) -> None:
    bench = new_bench(limit=0.4, rate=2000.0)
    begun = []

    def late_when_judging_limits(step: str, _number: int, _of: int) -> None:
        begun.append(step)
        if begun.count("push") == 2:
            bench.line.late = (1.0, 0.1)

    judgement = judge(bench.wire, leave=GENTLE, steps=steps_of(("push",), None), on_step=late_when_judging_limits)
    checks = {check.name: check for check in judgement.checks}
    assert failed(checks) == set(), summary(checks)
    assert checks["limit_cut"].result == "not seen"
    assert "0 of them in time: register 12 counts 0" in checks["limit_cut"].found


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
def test_a_fault_is_found_and_named(new_bench: NewBench, fault: str) -> None:
    step, names, words = FAULTS[fault]
    checks = judged(new_bench(fault, channels=4), step)
    assert failed(checks) == names, summary(checks)
    assert any(words in checks[name].found and checks[name].look_at for name in names), summary(checks)


def test_paced_by_the_host_a_missing_watchdog_is_found_too(new_bench: NewBench) -> None:
    assert failed(judged(new_bench("no_watchdog", pacings=2), "host")) == {"host_watchdog"}


PUSHED = {
    "inverted_sign": ({"sign"}, "inverted"),
    "on_arrival": ({"delay"}, "within the sample that the force came in"),
    "wrong_scale": ({"mass"}, "as if positions were "),
    "never_ends": ({"time_to_live", "host_time_to_live"}, "it goes on"),
    "never_cuts": ({"limit_cut"}, "register 12 counts 0"),
}


@pytest.mark.parametrize("fault", PUSHED)
def test_what_shows_in_the_motion_alone_is_found_and_named(new_bench: NewBench, fault: str) -> None:
    names, words = PUSHED[fault]
    bench = new_bench(fault, limit=0.4)
    checks = judged(bench, "push", leave=GENTLE)
    assert names <= failed(checks) <= {*names, "mass"}, summary(checks)
    assert any(words in checks[name].found for name in names)
    assert bench.device.largest <= GENTLE.force


def test_positions_that_come_in_bursts_show_no_rate(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.line.late = (0.02, 2.0)  # the host is held up for a second, and finds hundreds of positions
    checks = judged(bench, "arming")
    assert checks["rate_kept"].result == "not seen", summary(checks)
    assert "came in bursts" in checks["rate_kept"].found


@pytest.mark.parametrize("mass", [0.2, None])
@pytest.mark.parametrize("force", [0.1, 1.0, 10.0])
def test_a_sensor_that_is_dead_is_named_and_the_device_stays_in_its_travel(
    new_bench: NewBench, force: float, mass: float | None
) -> None:
    bench = new_bench("frozen")
    checks = judged(bench, "push", leave=Leave(force=force, travel=0.005, mass=mass))
    words = r"has not changed by one count for \S+ s while force acts \(\S+ N at most\): sensor or cable\?"
    assert re.search(words, checks["sign"].found), summary(checks)
    assert 0.0 < bench.device.farthest < 0.005


def test_pushing_stops_where_the_device_moves_too_far(new_bench: NewBench) -> None:
    bench = new_bench()
    checks = judged(bench, "push", leave=Leave(force=10.0, travel=1e-6))
    assert "moved more than 0.001 mm" in checks["sign"].found, summary(checks)
    assert bench.device.largest < 0.2  # the gentlest pushes went too far: no others were tried


@pytest.mark.parametrize(("friction", "result"), [(3.0, "pass"), (60.0, "not seen")])
def test_friction_neither_hides_nor_feigns_a_force_that_ends_by_itself(
    new_bench: NewBench, friction: float, result: str
) -> None:
    """Friction reduces the speed after a push to a third (3 N·s/m) or to nothing before the silence ends."""
    bench, endless = new_bench(), new_bench("never_ends")
    for one in (bench, endless):
        one.device.bodies[0].friction = friction
    checks, failing = (judged(one, "push", leave=GENTLE)["host_time_to_live"] for one in (bench, endless))
    assert checks.result == result, checks.found
    assert failing.result == ("FAIL" if result == "pass" else "not seen"), failing.found


def test_after_an_unclear_response_comes_a_stronger_push_within_the_travel(new_bench: NewBench) -> None:
    checks = judged(new_bench(), "push", leave=Leave(force=0.05, travel=3e-4))
    assert checks["sign"].found.endswith("pushes of 0.00313 N, 1 long"), summary(checks)


def test_a_device_that_moves_by_itself_is_not_pushed(new_bench: NewBench) -> None:
    bench = new_bench()
    bench.device.bodies[0].v = 1.0  # somebody pulls at it, and goes on to do so
    bench.device.bodies[0].friction = 1e-6
    checks = judged(bench, "push", leave=GENTLE)
    assert {checks[name].result for name in PUSHES} == {"not seen"}
    assert "moves by itself" in checks["sign"].found
    assert bench.device.largest == 0.0


@pytest.mark.parametrize(
    ("registers", "name", "words"),
    [
        ({0: 2}, "version", "2"),
        ({1: 0x12345678}, "schema", "0x12345678"),
        ({2: 17}, "channels", "17"),
        ({3: 0}, "pacings", "none"),
        ({3: 9}, "pacings", "0x9"),
        ({4: 0, 5: 0}, "rate", "0 Hz"),
        ({4: 0x408F4000, 5: 0}, "rate", "Hz"),  # 1000 Hz, its words swapped
        ({6: 0}, "max_watchdog", "0 samples"),
        ({6: 2048}, "max_watchdog", "2048 samples"),
        ({16: 0x00FF4142}, "name", "BA"),
        ({33: 0xBFF00000}, "position_scale", "-"),
        ({35: 0x7FF00000, 34: 0}, "force_scale", "inf"),
        ({37: 0x7FF80000}, "force_limit", "nan"),
        ({45: 0, 44: 0}, "force_limit", "0"),
        ({46: 0, 47: 0}, "velocity_scale", "0"),
        ({24: 1}, "unknown_registers", "register 24"),
        ({15: 8}, "sensors", "0x8"),
        ({15: 1}, "acceleration_scale", "0: no acceleration"),
        ({15: 1, 160: 0, 161: 0x3F000000, 176: 0, 177: 0xBF000000}, "acceleration_scale", "-"),
        ({14: 2}, "bridge", "2: neither 0 nor 1"),
        ({13: 4}, "rotary", "0x4: channel 0 linear"),
    ],
)
def test_a_register_that_cannot_be_is_named(
    new_bench: NewBench, registers: dict[int, int], name: str, words: str
) -> None:
    checks = judged(new_bench(channels=2, registers=registers), "registers")
    assert failed(checks) == {name}, summary(checks)
    assert words in checks[name].found


def test_a_bridge_passes_and_names_where_guards_end(new_bench: NewBench) -> None:
    checks = judged(new_bench(registers={14: 1}), "registers")
    assert failed(checks) == set(), summary(checks)
    assert (checks["bridge"].result, checks["bridge"].found[:11]) == ("not seen", "1: a bridge")


def test_what_was_not_reached_is_not_seen(new_bench: NewBench) -> None:
    checks = judged(new_bench(registers={1: 0x12345678}))
    assert {check.result for check in checks.values() if check.step not in STEPS[:2]} == {"not seen"}


def test_a_stop_releases_the_device_and_reports_how_far_it_came(new_bench: NewBench) -> None:
    bench = new_bench()

    def stop_in_time(step: str, _number: int, _of: int) -> None:
        bench.wire.stop = step == "forces"

    judgement = judge(bench.wire, on_step=stop_in_time)
    assert (judgement.interrupted, judgement.exit_status, judgement.released) == (True, 130, True)
    results = {check.name: check.result for check in judgement.checks}
    assert (results["arm"], results["in_time"]) == ("pass", "not seen")
    assert bench.device.state == 0


def test_every_check_names_a_section_of_the_protocol_by_its_title() -> None:
    titles = dict(re.findall(r"^###? (\d+(?:\.\d+)?)\.? (.+)$", PROTOCOL.read_text("utf-8"), re.MULTILINE))
    assert {number: titles[number] for number in SECTIONS} == SECTIONS
    assert {check.section for check in CHECKS} <= SECTIONS.keys()
    assert len({check.name for check in CHECKS}) == len(CHECKS)


def test_a_device_that_goes_away_fails_the_check_that_it_went_away_in(new_bench: NewBench) -> None:
    """A hardware watchdog resets the device in a tick that waits for room."""
    bench = new_bench("resets_where_it_waits", channels=4)
    judgement = judge(bench.wire, steps=steps_of(("blocked",), None))
    assert (judgement.exit_status, judgement.released) == (3, False)
    assert [check.name for check in judgement.failed] == ["tick_goes_on"]
    assert "the device went away here" in judgement.failed[0].found
    assert judgement.ended in judgement.failed[0].found


def test_a_slow_device_and_one_that_slows_down_are_not_taken_for_one_that_waits(new_bench: NewBench) -> None:
    """A simulated one on a busy machine: it loses every other sample, whether the host reads or not."""
    checks = judged(new_bench(channels=1, registers={4: 0, 5: 0x408F4000}), "blocked")  # says 1000 Hz, keeps 500
    assert failed(checks) == set(), summary(checks)
    checks = judged(new_bench("slows_down", channels=4), "blocked")
    assert failed(checks) == set(), summary(checks)
    assert "too unsteady to tell" in checks["tick_goes_on"].found


def test_a_channel_that_moves_in_place_of_the_pushed_one_is_named(new_bench: NewBench) -> None:
    checks = judged(new_bench("swapped", channels=2), "push", leave=GENTLE)
    assert "but that of channel 1 has: are their wires exchanged?" in checks["sign"].found, summary(checks)
    dead = judged(new_bench("frozen", channels=2), "push", leave=GENTLE)
    assert "exchanged" not in dead["sign"].found


def turned(degrees: float) -> list[list[float]]:
    """The forces of two motors that are turned by so much."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return [[c, -s], [s, c]]


@pytest.mark.parametrize(
    ("motors", "found"),
    [
        (turned(10.0), ""),
        (turned(-10.0), ""),
        ([[2.0, 0.6], [0.6, 0.7]], ""),  # a linkage, whose mass is a matrix
        (turned(20.0), 20.0),
        (turned(-30.0), -30.0),
        (turned(45.0), 45.0),
        (turned(90.0), 90.0),
        (turned(180.0), 180.0),
        ([[-1.0, 0.0], [0.0, 1.0]], "the first channel is inverted"),
        ([[1.0, 0.0], [0.0, -1.0]], "the second channel is inverted"),
        ([[0.0, 1.0], [1.0, 0.0]], "the channels are exchanged"),
    ],
)
def test_a_pair_is_pushed_along_both_axes_and_its_turn_is_named(
    new_bench: NewBench, motors: list[list[float]], found: str | float
) -> None:
    checks = judged(new_bench(channels=2, motors=motors), "push", leave=replace(GENTLE, mass=None, pair=(0, 1)))
    assert failed(checks) == ({"sign"} if found else set()), summary(checks)
    if isinstance(found, str):
        assert checks["sign"].found.startswith(found or "turned by"), summary(checks)
    else:
        away = float(checks["sign"].found.removeprefix("turned by ").partition("°")[0]) - found
        assert abs((away + 180.0) % 360.0 - 180.0) <= 2.0, summary(checks)
    if found:
        assert checks["delay"].found == "the axes of the pair are not right: see sign"


def test_a_pair_stays_within_its_travel_whichever_axis_moves(new_bench: NewBench) -> None:
    bench = new_bench(channels=2, motors=turned(90.0))
    checks = judged(bench, "push", leave=Leave(force=10.0, travel=1e-6, pair=(0, 1)))
    assert checks["sign"].found.startswith("it moved more than 0.001 mm: stopped")


def test_one_axis_alone_does_not_show_a_turn_of_45_degrees(new_bench: NewBench) -> None:
    checks = judged(new_bench(channels=2, motors=turned(45.0)), "push", leave=replace(GENTLE, mass=None))
    assert checks["sign"].result == "pass"
