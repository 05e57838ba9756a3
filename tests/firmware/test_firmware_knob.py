"""A motor of SimpleFOC as a device: what its driver and its torque do where something is wrong."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from harness_lines import ARM, ARMED, DISARM, FAULT, IDLE, LATCHED, force, position_of

import firmware_protocol
from firmware_protocol import schema
from tests.attempts import attempts

FIRMWARE = Path(firmware_protocol.__file__).parent / "firmware"
SMARTKNOB = Path(__file__).parents[2] / "configs" / "boards" / "smartknob.yaml"
HARNESS = Path(__file__).parent / "harness"
TURN = 16384  # counts
STEPS = "-DHAPSIM_KNOB_LARGEST_STEP=1000"  # counts
CERTAIN = (("k", 0.1), ("b", 0.2))  # parts of them, for 14 bits a turn

Knob = Callable[..., Callable[[list[str]], list[str]]]


def states_and_forces(knob: Knob, lines: list[str]) -> list[tuple[str, ...]]:
    """State and force after each line, or the register alone."""
    answers = [answer.split() for answer in knob(STEPS)(lines)]
    return [(answer[0], answer[3]) if len(answer) > 1 else (answer[0],) for answer in answers]


def test_the_driver_is_enabled_while_armed_and_at_no_other_time(knob: Knob) -> None:
    lines = ["driver", "tick", "driver", ARM, "driver", force(0, 7), "tick", "driver", DISARM, "driver"]
    after = states_and_forces(knob, lines)
    assert after[0] == after[2] == (IDLE, "0")
    assert after[4] == (ARMED, "1")
    assert after[6] == (ARMED, "7")
    assert after[7] == (ARMED, "1")
    assert after[9] == (IDLE, "0")


@pytest.mark.parametrize(
    "wrong", [["position 1001"], ["angle nan"], ["angle inf"], ["angle 7"], ["fault 6"], ["stalled"] * 6]
)
def test_what_is_wrong_with_motor_or_angle_releases_and_latches_until_armed_again(knob: Knob, wrong: list[str]) -> None:
    lines = [ARM, force(0, 7), "tick", *wrong, "tick", "driver", FAULT, "angle -1", "fault 0", "tick", "driver", ARM]
    after = states_and_forces(knob, [*lines, force(0, 9), "tick", "driver"])
    at = 3 + len(wrong)
    assert after[2] == (ARMED, "7")
    assert after[at : at + 3] == [(LATCHED, "0"), (LATCHED, "0"), (str(schema.HARDWARE),)]
    assert after[at + 6] == (LATCHED, "0")
    assert after[-2:] == [(ARMED, "9"), (ARMED, "1")]


def test_a_loop_that_died_is_latched_and_then_reset(knob: Knob) -> None:
    """At the fifth tick that sees no round; the watchdog is fed before."""
    answers = [line.split() for line in knob(STEPS)([ARM, "tick", *["stalled"] * 8])]
    states, fed = [line[0] for line in answers[2:]], [int(line[1]) for line in answers[2:]]
    assert states == [ARMED] * 5 + [LATCHED] * 3
    assert fed == [2, 3, 4, 5, 6, 6, 6, 6]


@pytest.mark.parametrize("target_per_nm", ["nan", "inf", "0", "-1", "2.1"])
def test_a_constant_that_is_none_or_asks_for_more_than_the_motor_may_enables_nothing(
    knob: Knob, target_per_nm: str
) -> None:
    """The motor's limit is twice the device's."""
    lines = [f"begin {target_per_nm}", ARM, "driver", "tick", "driver", FAULT]
    after = states_and_forces(knob, lines)
    assert after[0] == (IDLE, "0")
    assert after[2] == (LATCHED, "0")
    assert after[4] == (LATCHED, "0")
    assert after[5] == (str(schema.HARDWARE),)


def test_a_constant_within_the_motor_s_limit_is_taken(knob: Knob) -> None:
    assert states_and_forces(knob, ["begin 1.9", ARM, force(0, 100), "tick"]) == [
        (IDLE, "1"),
        (ARMED, "0"),
        (ARMED, "0"),
        (ARMED, "190"),
    ]


@pytest.mark.parametrize("turned", [False, True])
def test_positions_go_on_over_whole_turns_in_the_direction_of_the_torque(knob: Knob, turned: bool) -> None:
    places = [0, 900, 200, -700, -900, *range(-1800, -3 * TURN, -900)]
    lines = [*(["turned"] if turned else []), ARM]
    for place in places:
        lines += [f"position {place}", "tick"]
    answers = [line.split() for line in knob(STEPS)(lines)][1 + turned + 1 :: 2]
    sent = [position_of(answer[2]) for answer in answers]
    assert sent == [-place if turned else place for place in places]


def test_a_first_touch_of_the_emulated_knob_feels_as_predicted(
    start_board: Callable[..., Any], start_hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    """The friction that the scene declares is the rotor's, 6e-5 N·m·s/rad, and K²/R = 8.5e-5 of the voltage drive."""
    scene = tmp_path / "knob.yaml"
    scene.write_text(SMARTKNOB.read_text("utf-8").replace("delay: 2.25", "delay: 1"), "utf-8")
    words = ("measure", scene, "--port", start_board("simplefoc").port, "--at", 0, "--json")
    for _ in attempts():  # a machine that is busy with other tests may hold host or board up
        measuring = start_hapsim(*words)
        measuring.wait()
        document = json.loads(measuring.out)
        predicted, measured = document.get("predicted"), document.get("measured") or {}
        spread = {one: measured.get(f"{one}_uncertainty") or 1.0 for one, _ in CERTAIN}
        certain = bool(measured) and all(spread[one] < part * predicted[one] for one, part in CERTAIN)
        late = document.get("deadline_misses", 0) > 0  # held up: a force that was late is no fault of the knob's
        if certain and (not late or all(abs(measured[one] - predicted[one]) < 3 * spread[one] for one, _ in CERTAIN)):
            break
    assert certain, document
    for one, _ in CERTAIN:
        assert measured[one] == pytest.approx(predicted[one], abs=3 * spread[one])


@pytest.mark.thorough
def test_timer_and_loop_share_words_and_the_state_machine_alone(compile_knob: Callable[..., Path]) -> None:
    """Timer and loop run as threads at full speed under the compiler's thread sanitizer."""
    program = compile_knob("knob_threads", ("-O2", "-fsanitize=thread"))
    ran = subprocess.run([program], capture_output=True, text=True, check=False, timeout=120)
    if "unexpected memory mapping" in ran.stderr:
        pytest.skip("the thread sanitizer does not know this kernel's memory layout")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    found = re.fullmatch(r"(\d+) ticks, (\d+) forces, (\d+) of (\d+) rounds pushed\n", ran.stdout)
    assert found is not None
    ticks, forces, pushed, _ = map(int, found.groups())
    assert ticks >= 20000
    assert min(forces, pushed) > 1000


@pytest.mark.parametrize("core", ["ESP32", "STM32"])
def test_the_timers_of_both_cores_are_called_as_their_headers_declare(core: str, built: Path) -> None:
    cpp = shutil.which("g++")
    if cpp is None:
        pytest.skip("no g++ on this machine (Debian: g++)")
    folders = [built / "hapsim_knob" / "src", FIRMWARE / "simplefoc" / "emulated", HARNESS / "cores"]
    included = [f"-I{folder}" for folder in folders]
    source = folders[0] / f"{core.lower()}.cpp"
    words = ["-Wall", "-Wextra", "-Werror", "-O2", f"-DARDUINO_ARCH_{core}", *included, "-c", str(source)]
    compiled = subprocess.run([cpp, *words, "-o", "/dev/null"], capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
