"""The Arduino sketch: what its compiler refuses, what its pins do, and its emulated motors in virtual time."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from harness_lines import ARM, ARMED, DISARM, FAULT, IDLE, LATCHED, SKETCH, force, position_of, write_sketch

import firmware_protocol
import hapsim
from firmware_protocol import schema
from hapsim.scene.rewrite import rewrite_device

FIRMWARE = Path(firmware_protocol.__file__).parent / "firmware"
SCENE = Path(__file__).parents[2] / "configs" / "boards" / "arduino.yaml"
FULL = 32768  # counts of force at full duty
CPP = {
    "g++": (),
    "avr-g++": ("-mmcu=atmega328p", "-DF_CPU=16000000L"),
    "arm-none-eabi-g++": ("-mcpu=cortex-m3", "-mthumb"),
}
AS5600: dict[str, object] = {"SENSOR": "AS5600", "COUNTS": 4096}
POTENTIOMETER: dict[str, object] = {"SENSOR": "POTENTIOMETER", "SENSOR_PIN_A": "A0", "COUNTS": 1023}
TWO_PWMS: dict[str, object] = {"DRIVER": "TWO_PWMS", "MOTOR_PIN_B": 10}
CORE = Path("/usr/share/arduino/hardware/arduino/avr")
Sketch = Callable[..., Callable[[list[str]], list[str]]]


def compiled_by(compiler: list[str], folders: list[Path], sketch: Path) -> str:
    """Compiles a sketch to motor.o beside it; what the compiler says."""
    words = [*compiler, "-std=gnu++11", "-Wall", "-Wextra", "-Os", *(f"-I{one}" for one in folders)]
    words += ["-x", "c++", "-c", str(sketch), "-o", str(sketch.with_suffix(".o"))]
    ran = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (ran.returncode == 0) == ("error" not in ran.stderr), ran.stderr
    return ran.stderr


@pytest.fixture
def compiled(built: Path, tmp_path: Path) -> Callable[..., str]:
    """Compiles the sketch against the emulated core; what the compiler says."""

    def run(cpp: str, constants: dict[str, object], core: str = "") -> str:
        if shutil.which(cpp) is None:
            pytest.skip(f"no {cpp} on this machine (Debian: g++, gcc-avr avr-libc or gcc-arm-none-eabi)")
        path = write_sketch(tmp_path, constants)
        path.write_text(f"#include <Arduino.h>\n{core}\n{path.read_text('utf-8')}", "utf-8")
        return compiled_by([cpp, *CPP[cpp]], [built / "hapsim_motor/src", SKETCH.parents[2] / "emulated"], path)

    return run


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("cpp", CPP)
@pytest.mark.parametrize("sensor", [{}, AS5600 | TWO_PWMS, POTENTIOMETER | {"ENABLE_PIN": 7}])
def test_each_sensor_and_driver_compiles_without_a_warning(
    cpp: str, sensor: dict[str, object], compiled: Callable[..., str], built: Path
) -> None:
    assert compiled(cpp, sensor) == ""
    # The IDE would compile such a file apart from the sketch, without its constants.
    assert not [*built.joinpath("hapsim_motor", "src").rglob("*.c*")]


WRONG: list[tuple[dict[str, object], str]] = [
    ({"MOTOR_PIN_B": 9}, "one pin has two uses: compare MOTOR_PIN_A"),
    ({"ENABLE_PIN": 3}, "one pin has two uses"),
    (AS5600 | {"MOTOR_PIN_B": 18}, "one pin has two uses"),
    ({"MOTOR_PIN_A": 7}, "MOTOR_PIN_A: this pin has no PWM"),
    ({"DRIVER": "TWO_PWMS"}, "MOTOR_PIN_B: this pin has no PWM"),
    ({"SENSOR_PIN_B": 4}, "SENSOR_PIN_B: this pin has no interrupt"),
    ({"SENSOR": "HALL"}, "SENSOR: ENCODER, AS5600 or POTENTIOMETER"),
    (AS5600 | {"COUNTS": 2400}, "COUNTS: an AS5600 gives 4096 in a turn"),
    ({"FORCE_LIMIT": 0.06}, "FORCE_LIMIT: above zero, at most FULL_FORCE"),
    ({"RATE_HZ": 300}, "RATE_HZ: a sample must last a whole number of microseconds"),
    ({"RATE_HZ": 500}, "RATE_HZ: too high: 23 bytes at BAUD_RATE"),
    ({"COUNTS": 0}, "COUNTS, TRAVEL: above zero; POSITION_SIGN sets the direction"),
    ({"TRAVEL": -1.0}, "COUNTS, TRAVEL: above zero"),
    (POTENTIOMETER | {"COUNTS": 2400}, "COUNTS: with a potentiometer 1023, or 4095 of 12 bits"),
    ({"FORCE_LIMIT": 0}, "FORCE_LIMIT: above zero, at most FULL_FORCE"),
    ({"FORCE_SIGN": 0}, "POSITION_SIGN, FORCE_SIGN: 1 or -1"),
]


@pytest.mark.parametrize(("constants", "sentence"), WRONG)
def test_a_wrong_constant_is_an_error_with_a_sentence(
    constants: dict[str, object], sentence: str, compiled: Callable[..., str]
) -> None:
    assert sentence in compiled("g++", constants)


@pytest.mark.parametrize(
    ("constants", "sentence"),
    [
        ({"MOTOR_PIN_A": 5}, "MOTOR_PIN: the timer of this pin is slow, or that of micros(); take 3, 9, 10 or 11"),
        ({"BAUD_RATE": 230400}, "BAUD_RATE: this clock misses it by more than 2.5 %; take 115200"),
        ({"RATE_HZ": 1000, "BAUD_RATE": 250000}, "RATE_HZ: too high"),
        ({"RATE_HZ": 2000, "BAUD_RATE": 1000000}, "on an Uno 0.5 ms of work, take longer than a sample"),
        ({"MOTOR_PIN_B": 1}, "one pin has two uses"),
        (POTENTIOMETER | {"SENSOR_PIN_A": 0}, "SENSOR_PIN_A: an analogue pin, such as A0"),
    ],
)
def test_a_pin_that_an_uno_needs_itself_is_refused(
    constants: dict[str, object], sentence: str, compiled: Callable[..., str]
) -> None:
    assert sentence in compiled("avr-g++", constants)


@pytest.mark.parametrize(
    "call", ["setWireTimeout(uint32_t, bool)", "setTimeOut(uint16_t)", "setTimeout(uint32_t, bool)"]
)
def test_the_time_of_a_transfer_is_limited_by_the_call_that_the_core_has(
    call: str, compiled: Callable[..., str], tmp_path: Path
) -> None:
    assert compiled("g++", AS5600, f"#define WIRE_LIMIT {call}") == ""
    assert call.partition("(")[0].encode() in (tmp_path / "motor.o").read_bytes()


def test_a_core_that_waits_for_ever_for_a_broken_wire_gets_no_as5600(compiled: Callable[..., str]) -> None:
    assert "on this core a broken I2C wire stops loop()" in compiled("g++", AS5600, "#define ARDUINO_ARCH_SAMD")
    assert compiled("g++", POTENTIOMETER, "#define ARDUINO_ARCH_SAMD") == ""


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize(
    ("mcu", "variant", "pin"),
    [
        ("atmega328p", "standard", 9),
        ("atmega2560", "mega", 6),
        ("atmega2560", "mega", 44),
        ("atmega32u4", "leonardo", 5),
    ],
)
@pytest.mark.parametrize("sensor", [{}, AS5600 | TWO_PWMS, POTENTIOMETER])
def test_it_compiles_with_the_cores_of_avr_boards(
    mcu: str, variant: str, pin: int, sensor: dict[str, object], built: Path, tmp_path: Path
) -> None:
    if not CORE.exists() or shutil.which("avr-g++") is None:
        pytest.skip("no core of an Uno on this machine (Debian: arduino-core-avr)")
    sensor = sensor | {"MOTOR_PIN_A": pin, "BAUD_RATE": 500000}
    if variant == "leonardo" and sensor.get("SENSOR") == "AS5600":
        sensor |= {"MOTOR_PIN_B": 9}
    core = [CORE / "cores/arduino", CORE / "variants" / variant, CORE / "libraries/Wire/src"]
    chip = [f"-mmcu={mcu}", "-DF_CPU=16000000L", "-DARDUINO=10800", "-include", "Arduino.h"]
    chip += ["-DUSBCON", "-DUSB_VID=1", "-DUSB_PID=1"] if variant == "leonardo" else []
    told = compiled_by(["avr-g++", *chip], [*core, built / "hapsim_motor/src"], write_sketch(tmp_path, sensor))
    assert "error" not in told
    assert "hapsim" not in "".join(line for line in told.splitlines() if "warning" in line)


def test_pins_that_a_core_knows_only_at_run_time_are_not_checked(compiled: Callable[..., str]) -> None:
    core = "extern const int pwm[];\n#undef digitalPinHasPWM\n#define digitalPinHasPWM(pin) (pwm[pin] >= 0)"
    assert compiled("g++", {"MOTOR_PIN_A": 7}, core) == ""


def states_and_duties(run: Callable[[list[str]], list[str]], lines: list[str]) -> list[tuple[str, int]]:
    answers = [line.split() for line in run(lines)]
    return [(answer[0], int(answer[-1])) for answer in answers]


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("driver", [{}, TWO_PWMS])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_duty_is_the_force_while_armed_and_zero_at_any_other_time(
    driver: dict[str, object], sign: int, sketch: Sketch
) -> None:
    """At most FORCE_LIMIT, here 0.04 of 0.05 N·m. The harness aborts on both inputs at once."""
    run = sketch(FORCE_LIMIT=0.04, FORCE_SIGN=sign, ENABLE_PIN=7, **driver)
    forces = [(0, FULL // 2), (1, -FULL // 4), (2, FULL)]
    lines = [
        "tick",
        "enable",
        ARM,
        "enable",
        *(line for one in forces for line in (force(*one), "tick")),
        DISARM,
        "enable",
    ]
    after = states_and_duties(run, lines)
    assert after[:4] == [(IDLE, 0), (IDLE, 0), (ARMED, 0), (ARMED, 1)]
    assert after[5:10:2] == [(ARMED, sign * duty) for duty in (128, -64, 204)]
    assert after[10:] == [(IDLE, 0), (IDLE, 0)]


def test_a_pin_has_a_duty_before_it_is_given_a_frequency(sketch: Sketch) -> None:
    """Else an ESP32 keeps its PWM of 1 kHz. The harness aborts then."""
    setup = "analogWriteFrequency(MOTOR_PIN_A,20000);analogWriteFrequency(MOTOR_PIN_B,20000)"
    assert sketch(PWM_SETUP=setup, **TWO_PWMS)(["tick"])


def test_a_host_that_dies_leaves_no_force_and_the_clock_makes_the_ticks(sketch: Sketch) -> None:
    """A force with a time to live of 50 acts for 51 samples; the watchdog is 100."""
    after = states_and_duties(sketch(), [ARM, force(0, 10000), *["tick"] * 110])
    duties = [duty for _, duty in after[2:]]
    assert set(duties[:51]) == {77, 78}
    assert not any(duties[51:])
    assert [state for state, _ in after[2:]] == [ARMED] * 100 + [LATCHED] * 10
    early = [line.split()[2] for line in sketch()([ARM, "pass 999", "pass 1", "pass 999", "pass 1"])]
    assert [answer != "-" for answer in early[1:]] == [False, True, False, True]


@pytest.mark.parametrize("counts", [32, -100, 9999])
def test_what_rounding_takes_off_a_duty_comes_later(counts: int, sketch: Sketch) -> None:
    lines = [line for sample in range(256) for line in (force(sample, counts), "tick")]
    duties = [duty for _, duty in states_and_duties(sketch(), [ARM, *lines])[2::2]]
    assert sum(duties) == pytest.approx(256 * 255 * counts / FULL, abs=0.51)
    assert max(duties) - min(duties) == 1


@pytest.mark.parametrize("limit", [0.05, 0.04])
def test_no_duty_is_above_that_of_the_limit(limit: float, sketch: Sketch) -> None:
    """Half a step is left over from the first force."""
    lines = [line for sample in range(20) for line in (force(sample, FULL if sample % 2 else -FULL // 2), "tick")]
    duties = [duty for _, duty in states_and_duties(sketch(FORCE_LIMIT=limit), [ARM, *lines])[2::2]]
    assert max(duties) == round(255 * limit / 0.05)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_encoder_counts_both_ways_and_a_missed_edge_latches_until_armed_again(sign: int, sketch: Sketch) -> None:
    run = sketch(POSITION_SIGN=sign)
    lines = [ARM, "turn 9", "tick", "turn -14", "tick", force(2, 9999), "tick", "leap", "tick", FAULT, ARM, "tick"]
    answers = [line.split() for line in run(lines)]
    assert [position_of(answers[at][2]) for at in (2, 4)] == [9 * sign, -5 * sign]
    assert (answers[6][0], int(answers[6][3])) == (ARMED, 78)
    assert (answers[8][0], answers[8][3], answers[9]) == (LATCHED, "0", [str(schema.HARDWARE)])
    assert answers[11][0] == ARMED


@pytest.mark.parametrize("sensor", [AS5600, POTENTIOMETER])
@pytest.mark.parametrize("wrong", [["silent 1"], ["magnet 0"], ["reading 3000", "reading 300"]])
def test_one_bad_reading_is_skipped_and_the_second_in_a_row_latches(
    sensor: dict[str, object], wrong: list[str], sketch: Sketch
) -> None:
    if sensor is POTENTIOMETER and wrong == ["magnet 0"]:
        pytest.skip("a potentiometer has no magnet")
    middle = 511 if sensor is POTENTIOMETER else 2048
    good = ["silent 0", "magnet 1", f"reading {middle + 20}", "tick"]
    once = [ARM, force(0, 9999), wrong[0], "tick", *good]
    after = sketch(**sensor)([*once, wrong[0], "tick", wrong[-1], "tick", FAULT])
    answers = [line.split() for line in after]
    assert (answers[3][0], answers[3][3], position_of(answers[3][2])) == (ARMED, "78", 0)
    assert (answers[7][0], position_of(answers[7][2])) == (ARMED, 20)
    assert (answers[9][0], position_of(answers[9][2])) == (ARMED, 20)
    assert (answers[11][0], answers[11][3], answers[12]) == (LATCHED, "0", [str(schema.HARDWARE)])


def test_an_as5600_goes_on_over_whole_turns_that_it_makes_while_idle(sketch: Sketch) -> None:
    places = range(0, 10000, 500)
    lines = [line for place in places for line in (f"reading {(2048 + place) % 4096}", "tick")]
    answers = [line.split() for line in sketch(**AS5600)([*lines, ARM])]
    assert position_of(answers[-1][2][-2 * 11 :]) == places[-1]  # after STATUS


@pytest.mark.parametrize(
    ("register", "value"),
    [
        (schema.REG_RATE, 1000.0),
        (schema.REG_CHANNEL + schema.REG_POSITION_SCALE, 6.283185307 / 2400),
        (schema.REG_CHANNEL + schema.REG_FORCE_SCALE, 0.05 / FULL),
        (schema.REG_CHANNEL + schema.REG_FORCE_LIMIT, 0.02),
    ],
)
def test_scales_and_rate_are_the_doubles_of_the_constants(register: int, value: float, sketch: Sketch) -> None:
    low, high = (int(line) for line in sketch()([f"register {register}", f"register {register + 1}"]))
    assert struct.unpack("<d", struct.pack("<II", low, high))[0] == value


def test_the_comments_of_the_scene_stay_true_when_its_values_are_identified(tmp_path: Path) -> None:
    path = tmp_path / "knob.yaml"
    path.write_bytes(SCENE.read_bytes())
    rewrite_device(str(path), {"mass": "3.1e-05", "friction": "0.0002", "delay": "1.2"}, channel=0)
    lines = [line for line in path.read_text("utf-8").splitlines() if re.match(r"  (mass|friction|delay): ", line)]
    assert [re.sub(r" +#.*", "", line) for line in lines] == ["  mass: 3.1e-05", "  friction: 0.0002", "  delay: 1.2"]
    assert not [line for line in lines if "guess" in line]
    shipped = hapsim.predict(hapsim.load_scene(SCENE))
    told = re.search(
        r"k = (\S+) N·m/rad, b = (\S+) N·m·s/rad, ringing.*\n# These are of the shipped", SCENE.read_text("utf-8")
    )
    assert told
    assert [float(one) for one in told.groups()] == pytest.approx([shipped.k, shipped.b], rel=5e-4)


def test_the_scene_has_stable_detents_in_place_of_its_spring(tmp_path: Path) -> None:
    text, found = re.subn(r"  spring: .*\n(.*\n)  # (detent: )", r"\1  \2", SCENE.read_text("utf-8"))
    path = tmp_path / "detents.yaml"
    path.write_text(text, "utf-8")
    assert found == 1
    assert hapsim.predict(hapsim.load_scene(path)).stable


@pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")
@pytest.mark.parametrize(
    "name",
    [
        "arduino_as5600",
        pytest.param("arduino", marks=pytest.mark.thorough),
        pytest.param("arduino_uno", marks=pytest.mark.thorough),  # with a potentiometer
    ],
)
def test_an_emulated_board_is_identified_and_feels_as_predicted(
    name: str, start_board: Callable[..., Any], built: Path
) -> None:
    """In virtual time. The Uno has the core and the chip of a real one. Its bridge coasts at zero duty, so its friction
    is all in the bearing here. A force of 8 bits, and counts a thousandth of the motion, leave k off by 0.3 % and b by
    1 to 2 % in the root mean square, a delay by 0.05 samples; the limits are some five times as wide. What emulates a
    chip is slow: the Uno is not identified."""
    uno = name == "arduino_uno"
    board = start_board(name, built, "lockstep=1", *(["noise=0", "emf=0", "friction=1.75e-4"] if uno else []))
    scene = hapsim.load_scene(SCENE)
    changes = {"port": board.port, "clock": "lockstep"}
    scene = scene.model_copy(update={"device": scene.device.model_copy(update=changes), "mock": None})
    predicted, measured = hapsim.predict(scene), hapsim.measure(scene, push=0.02, duration=3.0)
    assert measured.k == pytest.approx(predicted.k, rel=0.03 if uno else 0.015)
    assert measured.b == pytest.approx(predicted.b, rel=0.08)
    if not uno:
        found = hapsim.identify_device(scene, force=0.012, travel=1.5)
        assert found.mass.value == pytest.approx(2e-5, rel=0.05)
        assert found.friction.value == pytest.approx(1.75e-4, rel=0.08)
        assert found.delay.value == pytest.approx(1.0, abs=0.25)
        by_default = hapsim.measure(scene)
        assert [one.push_n for one in by_default.attempts[:-1]] == ([] if name == "arduino_as5600" else [0.005])
        assert by_default.k == pytest.approx(predicted.k, rel=0.03)


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")
@pytest.mark.parametrize(("baud", "rate"), [(115200, 400), (500000, 1000)])
def test_an_uno_holds_the_rates_that_its_compiler_lets_pass(
    baud: int, rate: int, once: Any, start_board: Callable[..., Any]
) -> None:
    """In virtual time: the wire's and the chip's time pass, the host's does not."""
    constants = {"CONSTANTS": f"BAUD_RATE={baud} RATE_HZ={rate}"}
    built = once(f"uno_{baud}_{rate}", ["bash", "-c", f'"{FIRMWARE}/build" "$0" arduino_uno'], constants)
    board = start_board("arduino_uno", built, "lockstep=1", "noise=0")
    scene = hapsim.load_scene(SCENE)
    device = scene.device.model_copy(update={"port": board.port, "clock": "lockstep", "baud": baud})
    trace = hapsim.run(scene.model_copy(update={"device": device, "mock": None, "rate": float(rate)}), duration=1.0)
    assert trace.report.age_samples.count == rate
    assert trace.report.age_samples.p99 == 1
    assert trace.report.deadline_misses <= 1
