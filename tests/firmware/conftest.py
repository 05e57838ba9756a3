"""The reference firmware: its state machine as a program in virtual time, and the mock as it is played."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import firmware_protocol
from firmware_protocol import schema
from firmware_protocol.description import Servo, to_registers
from firmware_protocol.lines import line_units, lines_of
from firmware_protocol.vectors import DEVICES, LIMIT, STATES
from hapsim.device.mock.assemble_mock import assemble_mock, describe_mock
from hapsim.device.mock.firmware import check_watchdog, prepare, take_bytes, take_sample
from hapsim.device.mock.record import OUTBOX_BYTES
from hapsim.device.mock.servo import follow_commands
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))

from bridged import Bridged
from harness_lines import write_sketch

FIRMWARE = Path(firmware_protocol.__file__).parent / "firmware"
HARNESS = Path(__file__).parent / "harness"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")  # the builds are optimised; these compile quickly

SANITIZED = ("-fsanitize=address,undefined",)

Run = Callable[[list[str]], list[str]]


@pytest.fixture(scope="session")
def harness(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Run]:
    """The state machine of a device of sessions.json, compiled: runs lines through it."""
    programs: dict[str, Path] = {}

    def program(device: dict[str, Any], core: Path = FIRMWARE / "hapsim_device.c") -> Run:
        name = f"{device['name']}_{core.parent.name}"
        if name not in programs:
            programs[name] = tmp_path_factory.mktemp(name) / "harness"
            _compile_harness(compiler, device, core, programs[name])

        return lambda lines: _answers(programs[name], lines)

    return program


@pytest.fixture(scope="session")
def law(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs lines through harness/law.c."""
    program = tmp_path_factory.mktemp("law") / "law"
    words = [*STRICT, *SANITIZED, f"-I{FIRMWARE}", f"-I{HARNESS}", *_defined(DEVICES["lines"])]
    _run([compiler, *words, str(HARNESS / "law.c"), "-o", str(program)])
    return lambda lines: _answers(program, lines)


def _answers(program: Path, lines: list[str]) -> list[str]:
    text = "\n".join(lines) + "\n"
    ran = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    return ran.stdout.splitlines()


def _compile_harness(compiler: str, device: dict[str, Any], core: Path, to: Path) -> None:
    sources = [str(HARNESS / "harness.c"), str(core)]
    command = [compiler, *STRICT, *SANITIZED, f"-I{FIRMWARE}", f"-I{HARNESS}", *_defined(device)]
    _run([*command, *sources, "-o", str(to)])


def _defined(device: dict[str, Any]) -> list[str]:
    keys = ("channels", "pacings", "max_watchdog", "impulse", "velocity", "acceleration", "steps", "words", "servo")
    return [f"-DHARNESS_{key.upper()}={int(device[key])}" for key in keys]


def _run(command: list[str]) -> None:
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr


# What the harness calls of the state machine; with the knob for its board, a sketch's loop() and timer do it.
KNOB_CALLS = {f"hapsim_device_{name}": f"knob_{name}" for name in ("init", "take_byte", "tick", "look")}


@pytest.fixture(scope="session")
def compile_knob(compiler: str, built: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """The Arduino library as it was assembled, but for the harness's constants, with one of the harness's programs."""
    cpp = shutil.which("g++")
    if cpp is None:
        pytest.skip("no g++ on this machine (Debian: g++)")

    def compiled(program: str, sanitized: tuple[str, ...], *more: str) -> Path:
        here = tmp_path_factory.mktemp("knob")
        library = shutil.copytree(built / "hapsim_knob" / "src", here / "src")
        shutil.copy(HARNESS / "hapsim_board.h", library)
        included = [f"-I{path}" for path in (library, library / "device", FIRMWARE / "simplefoc" / "emulated", HARNESS)]
        words = ["-g", *sanitized, *_defined(DEVICES["plain"]), *more, *included]
        calls = [f"-D{name}={instead}" for name, instead in KNOB_CALLS.items()]
        in_c = [compiler, *STRICT, *words, "-c"]
        objects = [str(here / "device.o"), str(here / "harness.o")]
        _run([*in_c, str(library / "device" / "hapsim_device.c"), "-o", objects[0]])
        if program == "knob":
            _run([*in_c, "-DHARNESS_KNOB", *calls, str(HARNESS / "harness.c"), "-o", objects[1]])
        sources = [*map(str, library.glob("*.cpp")), str(HARNESS / f"{program}.cpp")]
        strict = ["-Wall", "-Wextra", "-Werror"]
        _run([cpp, *strict, *words, *sources, *objects[: 1 + (program == "knob")], "-o", str(here / program)])
        return here / program

    return compiled


@pytest.fixture(scope="session")
def knob(compile_knob: Callable[..., Path]) -> Callable[..., Run]:
    """The harness with the knob for its board, compiled with further words: runs lines through it."""
    programs: dict[tuple[str, ...], Path] = {}

    def program(*more: str) -> Run:
        if more not in programs:
            programs[more] = compile_knob("knob", SANITIZED, *more)
        return lambda lines: _answers(programs[more], lines)

    return program


@pytest.fixture(scope="session")
def sketch(compiler: str, built: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Run]:
    """The harness with the Arduino sketch for its board: runs lines through it. `in_sessions`: with the harness's
    scales and limits, and a duty that is the force in counts."""
    cpp = shutil.which("g++")
    if cpp is None:
        pytest.skip("no g++ on this machine (Debian: g++)")
    programs: dict[str, Path] = {}

    def compiled(in_sessions: bool, constants: dict[str, object]) -> Path:
        here = tmp_path_factory.mktemp("sketch")
        write_sketch(here, {"RATE_HZ": 1000, "BAUD_RATE": 2_000_000, **constants})
        library = shutil.copytree(built / "hapsim_motor", here / "library")
        if in_sessions:
            shutil.copy(HARNESS / "hapsim_board.h", library / "src")
        emulated = FIRMWARE / "arduino" / "emulated"
        folders = [here, library / "src", library / "extras" / "device", emulated, HARNESS]
        words = ["-g", *SANITIZED, *_defined(DEVICES["plain"]), *(f"-I{folder}" for folder in folders)]
        calls = [f"-D{name}={instead}" for name, instead in KNOB_CALLS.items()]
        in_c = [compiler, *STRICT, *words, "-DHARNESS_KNOB", *calls, "-c", str(HARNESS / "harness.c")]
        _run([*in_c, "-o", str(here / "harness.o")])
        scale = ["-DHAPSIM_FORCE_COUNTS=1"] if in_sessions else []
        strict = ["-std=c++11", "-Wall", "-Wextra", "-Werror", *scale]
        sources = [str(HARNESS / "sketch.cpp"), str(here / "harness.o")]
        _run([cpp, *strict, *words, *sources, "-o", str(here / "sketch")])
        return here / "sketch"

    def program(in_sessions: bool = False, **constants: object) -> Run:
        name = f"{in_sessions} {constants}"
        if name not in programs:
            programs[name] = compiled(in_sessions, constants)
        return lambda lines: _answers(programs[name], lines)

    return program


_PERIOD_NS = 1_000_000
_SENSED = ("velocity", "acceleration")
_OUTSIDE_M = 3.0  # no 32 bits of nanometres hold it


class MockPlayer:
    """The mock as the device of a session: what it measures is set before each event, and no force moves it."""

    def __init__(self, device: dict[str, Any]) -> None:
        self.channels = device["channels"]
        modules = {f"hand{c}": {"type": "device", "channel": c} for c in range(self.channels)}
        hold = "impulse" if device["impulse"] else "zoh"
        steps = device["steps"]
        board = {"law": "board", "board_rate": 1000 * steps} if steps else {}
        real = {"clock": "device", "hold": hold, "mass": 1e12} | board
        if device["servo"]:
            real = {"clock": "device", "mode": "admittance", "simulated_mass": 1.0}
            real["assumed_hand"] = {"stiffness": 1.0}
        scene = Scene.model_validate({"version": 1, "rate": 1000, "device": real, "modules": modules})
        self.mock = assemble_mock(scene)
        scales = {f"{name}_scale": (1e-8 if device[name] else 0.0,) * self.channels for name in _SENSED}
        description = replace(
            describe_mock(scene),
            pacings=device["pacings"],
            max_watchdog_samples=device["max_watchdog"],
            force_scale=(1e-8,) * self.channels,
            sensors=schema.SENSES_ACCELERATION * device["acceleration"]
            | schema.FOLLOWS_LINES * bool(steps)
            | schema.HAS_DIGITAL_WORD * device["words"]
            | (schema.SENSES_FORCE | schema.FOLLOWS_COMMANDS) * device["servo"],
            servo=Servo((1e-3,), (1e-2,), (0.0,), (1.0,)) if device["servo"] else None,
            hand_force_scale=(1e-8,) * device["servo"],
            hand_force_range=(10.0,) * device["servo"],
            lines=lines_of((steps, 1, steps, 32), [line_units(10.0, 1e-3)], [(4, -1)], [(30000, 60000)])
            if steps
            else None,
            **scales,
        )
        self.mock.registers[:] = to_registers(description)
        self.mock.offered = schema.parts_of(description.parts)
        if description.servo:
            follow_commands(self.mock, [None], description.servo, rate=1000.0, delay=1.0)
            self.mock.force_sensors[0].quantum, self.mock.force_sensors[0].range = 1e-8, 10.0
        if steps:
            self.mock.follower.limit[0] = LIMIT
            self.mock.follower.shifts[0], self.mock.follower.largest[0] = (4, -1), (30000, 60000)
        self.mock.force_scale[: self.channels] = description.force_scale
        for name in _SENSED:
            self.mock.converters[f"{name}_quantum"][: self.channels] = scales[f"{name}_scale"]
        prepare(self.mock)
        self.now, self.full = 10**12, False
        self.positions = self.velocities = self.accelerations = [0.0] * self.channels

    def _place(self, before_a_sample: bool) -> None:
        """Places the bodies so that the next event measures the set positions."""
        for c in range(self.channels):
            back, speed, gain = before_a_sample * _PERIOD_NS * 1e-9, self.velocities[c], self.accelerations[c]
            start = self.positions[c] - back * speed + back**2 * gain / 2
            here = (self.mock.initial, self.positions[c], speed)
            for bodies, position, velocity in ((self.mock.bodies, start, speed - back * gain), here):
                bodies[c]["position"] = position
                bodies[c]["velocity"] = velocity
                bodies[c]["push"] = gain * bodies[c]["mass"]

    def play(self, step: dict[str, Any]) -> bytes:
        """Takes one step; what the mock said."""
        if "position" in step:
            self.positions, self.velocities = (
                [count * 1e-9 for count in step["position"]],
                [count * 1e-8 for count in step["velocity"]],
            )
            self.accelerations = [count * 1e-8 for count in step.get("acceleration", [0] * self.channels)]
            self.mock.force_sensors["offset"][: self.channels] = (
                np.array(step.get("hand_force", [0] * self.channels)) * 1e-8
            )
        elif "inputs" in step:
            self.mock.inputs = self.mock.first_inputs = step["inputs"][0]
        elif "finds" in step:
            where = _OUTSIDE_M if step["finds"] == schema.POSITION_OUT_OF_RANGE else 0.0
            self.positions, self.velocities = [where] * self.channels, [0.0] * self.channels
            self.accelerations = self.velocities
        elif "room" in step:
            self.full = not step["room"]
        elif "bytes" in step:
            self._place(before_a_sample=False)
            data = np.frombuffer(bytes.fromhex(step["bytes"]), np.uint8)
            return self._sent(lambda: take_bytes(self.mock, data, data.size, self.now))
        elif "pass" in step:
            self.now += step["pass"] * _PERIOD_NS // 1000
            return self._sent(lambda: check_watchdog(self.mock, self.now))
        else:
            return b"".join(self._tick() for _ in range(step["tick"]))
        return b""

    def _tick(self) -> bytes:
        self.now += _PERIOD_NS
        self._place(before_a_sample=True)
        before = b""
        if self.state == "armed" and self.mock.board.pacing == schema.PACED_BY_DEVICE:
            before = self._sent(lambda: take_sample(self.mock, self.now))
        return before + self._sent(lambda: check_watchdog(self.mock, self.now))

    def _sent(self, event: Callable[[], None]) -> bytes:
        self.mock.board.out = OUTBOX_BYTES if self.full else 0
        event()
        sent = b"" if self.full else bytes(self.mock.outbox[: int(self.mock.board.out)])
        self.mock.board.out = 0
        return sent

    @property
    def state(self) -> str:
        return STATES[int(self.mock.board.state)]

    @property
    def force(self) -> list[int]:
        """Returns the present force in counts; with a sample of delay, the command of the sample before.

        Paced by the host the mock works out what a time to live left of a force once the sample is over.
        """
        commands, depth, board = self.mock.commands, int(self.mock.depth), self.mock.board
        if board.pacing == schema.PACED_BY_HOST and (self.now - int(board.sampled_ns)) * 1e-9 > board.lives:
            return [0] * self.channels
        if self.state != "armed":
            assert not commands.any()
        if self.mock.board.parts & schema.WITH_COMMANDS:
            return [0] * self.channels
        if self.mock.board.parts & schema.WITH_LINE:
            follower, at = self.mock.follower, int(board.n) * int(self.mock.follower.steps)
            return [int(each) for each in follower.under_way[at % 2, : self.channels]]
        acting = commands[(int(self.mock.board.n) - 1) % depth, : self.channels]
        return [round(float(force) * LIMIT / 10.0) for force in acting]

    @property
    def command(self) -> list[int] | None:
        """Returns the commands that the servo follows, in counts; None without torque."""
        board = self.mock.board
        if self.state != "armed" or not board.parts & schema.WITH_COMMANDS:
            return None
        acting = self.mock.commands[(int(board.n) - 1) % int(self.mock.depth), : self.channels]
        return [round(float(place) / 1e-9) for place in acting]

    @property
    def outputs(self) -> int:
        return int(self.mock.outputs)

    def register(self, number: int) -> int:
        decoder = self.mock.decoder
        if number == schema.REG_FAULT:
            return int(self.mock.board.fault)
        if number == schema.REG_REJECTED:
            return int(decoder.crc_errors + decoder.length_errors + decoder.form_errors)
        return int(self.mock.registers[number])


@pytest.fixture(scope="session")
def mock_player() -> type[MockPlayer]:
    return MockPlayer


@pytest.fixture(scope="session")
def built_to_die(once: Any) -> Callable[[str], Path]:
    """Builds a board, by its name, with a tick that dies half a second after arming."""
    defines = {"DEFINES": "-DHAPSIM_BROKEN_TICK"}

    def build(name: str) -> Path:
        words = "avr hapkit" if name == "hapkit" else name
        return once(f"dying_{name}", ["bash", "-c", f'"{FIRMWARE}/build" "$0" {words}'], defines)

    return build


@pytest.fixture(scope="session")
def built_haply_mock(once: Any) -> Path:
    """Directory of the built Haply mock, a patient bridge, and the bridge's kinematics as a library."""
    return once("haply_mock", [str(Path(__file__).parent / "haply_mock" / "build_mock")], {})


@pytest.fixture
def start_bridged(built_haply_mock: Path, tmp_path: Path) -> Iterator[Callable[..., Bridged]]:
    """Starts a mock of a Haply board with these options, and a bridge in front of it; stops both when the test ends."""
    started: list[Bridged] = []

    def start(*options: str, model: str = "v3") -> Bridged:
        to = tmp_path / f"haply{len(started)}"
        to.mkdir()
        started.append(Bridged(built_haply_mock, to, options, model))
        return started[-1]

    yield start
    for one in started:
        one.stop()
