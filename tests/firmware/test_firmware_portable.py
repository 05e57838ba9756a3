"""Portability of the firmware: constants of boards, compiler warnings about doubles, broken devices."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from decimal import Decimal, getcontext
from pathlib import Path

import pytest

import firmware_protocol
from firmware_protocol.make_vectors import PORTING, made_text

FIRMWARE = Path(firmware_protocol.__file__).parent / "firmware"


def test_the_generated_parts_of_porting_are_up_to_date() -> None:
    assert PORTING.read_text("utf-8") == made_text(PORTING), "run python -m firmware_protocol.make_vectors"


def test_every_double_in_words_is_the_number_next_to_it() -> None:
    files = [*FIRMWARE.rglob("*_board.h"), Path(__file__).parent / "harness" / "hapsim_board.h"]
    texts = "\n".join(path.read_text("utf-8") for path in files)
    found = re.findall(r"HAPSIM_F64\(0x([0-9a-f]{8}), 0x([0-9a-f]{8})\)}? +/\* ([0-9.e-]+)", texts)
    assert len(found) >= 8
    for high, low, value in found:
        assert struct.unpack(">d", bytes.fromhex(high + low))[0] == float(value)


def test_the_simulated_mass_has_the_exponentials_of_a_fifth_of_a_kilogram() -> None:
    getcontext().prec = 40
    mass, friction, period = Decimal("0.2"), Decimal(1), Decimal("0.001")
    decay = 1 - (-friction / mass * period).exp()
    lag = 1 - decay / (friction / mass * period)
    units = Decimal(10) ** 9 * 2**24 * Decimal("1e-8")  # 2^-24 nm in a metre, newtons in a count
    exact = {
        "DECAY": decay * 2**39,
        "LAG": lag * 2**40,
        "PUSH_V": period * decay / friction * units * 2**22,
        "PUSH_X": period * lag / friction * units * 2**23,
    }
    text = (FIRMWARE / "simulated" / "simulated_mass.c").read_text("utf-8")
    written = {name: int(value) for name, value in re.findall(r"#define (\w+) (\d+)u", text)}
    assert written == {name: int(value.to_integral_value()) for name, value in exact.items()}
    for steps, shift in ((5, 21), (10, 23)):  # boards that follow lines move it by local periods
        part = re.split(rf"SIMULATED_STEPS == {steps}\n", text)[1].split("#endif")[0].split("#elif")[0]
        written = {name: int(value) for name, value in re.findall(r"#define STEP_(\w+) (\d+)", part)}
        local = period / steps
        decay = 1 - (-friction / mass * local).exp()
        units = Decimal(10) ** 3 * 2**7  # 2^-7 nm in a metre, newtons in a count
        exact = {"DECAY": decay * 2**24, "SHIFT": Decimal(shift), "PUSH_V": local * decay * units * 2**shift}
        assert written == {name: int(value.to_integral_value()) for name, value in exact.items()}


@pytest.mark.parametrize("compiler", ["gcc", "avr-gcc"])
def test_a_double_in_the_board_s_constants_stops_the_compiler_with_a_reason(compiler: str, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} on this machine (Debian: {'gcc' if compiler == 'gcc' else 'gcc-avr avr-libc'})")
    board = (FIRMWARE / "simulated" / "simulated_board.h").read_text("utf-8")
    (tmp_path / "hapsim_board.h").write_text(
        board + '#define HAPSIM_BOARD_NAME "x"\n#define HAPSIM_BOARD_PERIOD_TICKS 1000ul\n'
    )
    command = [
        compiler,
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-pedantic",
        "-Os",
        f"-I{FIRMWARE}",
        f"-I{tmp_path}",
    ]
    command += ["-mmcu=atmega328p"] if compiler == "avr-gcc" else []
    command += ["-c", str(FIRMWARE / "hapsim_device.c"), "-o", str(tmp_path / "device.o")]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    wrong = board.replace("HAPSIM_F64(0x3e112e0b, 0xe826d695)", "HAPSIM_F64(1e-9, 0)")
    (tmp_path / "hapsim_board.h").write_text(
        wrong + '#define HAPSIM_BOARD_NAME "x"\n#define HAPSIM_BOARD_PERIOD_TICKS 1000ul\n'
    )
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode != 0
    assert "write_its_two_hex_words_see_PORTING" in refused.stderr


def test_a_double_handed_to_the_header_of_a_short_one_stops_the_compiler_with_a_reason(tmp_path: Path) -> None:
    if shutil.which("avr-gcc") is None:
        pytest.skip("no avr-gcc on this machine (Debian: gcc-avr avr-libc)")
    source = tmp_path / "words.c"
    source.write_text('#include "hapsim_protocol.h"\nuint32_t f(void) { return hapsim_f64_word(1e-9, true); }\n')
    command = ["avr-gcc", "-std=c99", "-Os", "-mmcu=atmega328p", f"-I{FIRMWARE.parent}", "-c", str(source)]
    refused = subprocess.run([*command, "-o", str(tmp_path / "o")], capture_output=True, text=True, check=False)
    assert refused.returncode != 0
    assert "double has 4 bytes" in refused.stderr
