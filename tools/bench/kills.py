"""Host and device killed and stopped in the middle of a run: until when there was a force, and what is left.

    tools/bench/kills [--clock device|host] [--only WORDS ...]

The device is the reference firmware's Linux board, which logs by its own clock which force it put out when; its force
changes with every sample. In the table: who was killed or stopped, and how; from the last answer to zero force, by the
device's clock, and what the force's time to live allows; what the record lacks, in the device's samples (it is written
four times a second); the host's exit status; whether a run over the same port succeeds afterwards; what the user
reads.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import hapsim

ROOT = Path(__file__).parents[2]
PERIOD_US, TIME_TO_LIVE = 1000, 20  # samples: what hapsim asks for at 1 kHz
PLAYED = 1500  # forces, before anything happens
STOPPED_S = 2.0
PATIENCE_S = 60.0
ATTEMPTS = 10
SHOWN = 110  # characters
HEAD = ("who", "how", "to zero force, ms", "allowed", "record lacks", "status", "port free", "the user read")


class Board:
    """The Linux board, and its log: microseconds of its clock and counts, for every force put out."""

    def __init__(self, log: Path) -> None:
        self.log = log
        command = [ROOT / "firmware_protocol/firmware/board", "linux", log]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert self.process.stdout is not None
        self.port = self.process.stdout.readline().strip()
        if not self.port:
            raise SystemExit("the Linux board was not built on this machine (Debian: gcc libc6-dev)")

    def put_out(self) -> list[tuple[int, int]]:
        if not self.log.exists():
            return []
        whole = [line.split() for line in self.log.read_text("ascii").splitlines(keepends=True) if line.endswith("\n")]
        return [(int(us, 16), int.from_bytes(bytes.fromhex(counts), signed=True)) for us, counts in whole]


class Host:
    """A hapsim that runs and records."""

    def __init__(self, scene: Path, port: str, record: Path, reports: Path) -> None:
        words = ["run", scene, "--port", port, "--duration", 600, "--record", record, "--reports", reports]
        self.record = record
        self.process = subprocess.Popen(
            ["nice", "-n", "-15", sys.executable, "-m", "hapsim", *map(str, words)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._result: tuple[int, str] | None = None

    def end(self) -> tuple[int, str]:
        """The exit status and the last sentence, without file names."""
        if self._result is None:
            printed = self.process.communicate(timeout=PATIENCE_S)[1].strip().splitlines()
            lines = [line for line in printed if not line.startswith(("running", "compiling", "granted", "denied"))]
            self._result = self.process.returncode, lines[-1] if lines else ""
        return self._result


@dataclass(frozen=True)
class Case:
    who: str
    how: str
    do: Callable[[Host, Board], None]


def _kill_host(host: Host, _board: Board) -> None:
    host.process.kill()
    host.end()


def _kill_device(_host: Host, board: Board) -> None:
    board.process.kill()
    board.process.wait()


def _stop_for_a_while(process: subprocess.Popen[str]) -> None:
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(STOPPED_S)
    os.kill(process.pid, signal.SIGCONT)


def _kill_host_then_device(host: Host, board: Board) -> None:
    _kill_host(host, board)
    _kill_device(host, board)


def _kill_device_then_host(host: Host, board: Board) -> None:
    _kill_device(host, board)
    _kill_host(host, board)


CASES = (
    Case("host", "killed", _kill_host),
    Case("host", f"stopped for {STOPPED_S:g} s", lambda host, _board: _stop_for_a_while(host.process)),
    Case("device", "killed", _kill_device),
    Case("device", f"stopped for {STOPPED_S:g} s", lambda _host, board: _stop_for_a_while(board.process)),
    Case("host, then device", "killed", _kill_host_then_device),
    Case("device, then host", "killed", _kill_device_then_host),
)


def played(case: Case, scene: Path, clock: str, place: Path) -> list[str] | None:
    """The row of a case; None where a busy machine made the host too late for the device before anything was done."""
    board = Board(place / "log")
    host = Host(scene, board.port, place / "t.npz", place / "reports")
    try:
        _wait(lambda: len(board.put_out()) > PLAYED or host.process.poll() is not None)
        if host.process.poll() is not None:
            return None
        before = len(board.put_out())
        case.do(host, board)
        status, sentence = host.end()
        is_there = board.process.poll() is None
        if is_there:
            _wait(lambda: board.put_out()[-1][1] == 0)
        row = [*_to_zero(board, clock, is_there, before), _lacks(host, board), str(status)]
        free = _runs_again(scene, board) if is_there else "the device is gone"
    finally:
        for process in (host.process, board.process):
            process.kill()
            process.communicate()
    return [case.who, case.how, *row, free, sentence if len(sentence) <= SHOWN else f"{sentence[:SHOWN]}…"]


def _to_zero(board: Board, clock: str, is_there: bool, before: int) -> list[str]:
    """Returns the times from the last answer to zero force on a connected device. If the device is the clock, it
    repeats the held force in each tick, and equal forces count as one answer."""
    if not is_there:
        return ["the device is gone", "–"]
    forces = board.put_out()
    if clock == "device":
        forces = [one for last, one in zip([(0, None), *forces], forces, strict=False) if one[1] != last[1]]
    last = max(i for i, (_, counts) in enumerate(forces) if counts)
    if last + 1 == len(forces):
        return [f"none after {len(board.put_out()) - before} forces", "–"]
    allowed = TIME_TO_LIVE + (2.0 if clock == "host" else 1.5)
    return [f"{(forces[last + 1][0] - forces[last][0]) / 1e3:.1f}", f"{allowed * PERIOD_US / 1e3:.1f}"]


def _lacks(host: Host, board: Board) -> str:
    """Returns the samples from the last force in the record of a killed host to the last force of the device."""
    part = host.record.with_name(f"{host.record.name}.part")
    if host.record.exists():
        return f"nothing: {hapsim.load_trace(host.record).report.ending}"
    trace = hapsim.load_trace(part)
    ends = set(trace.force_counts[-50:, 0].tolist())
    forces = [counts for _, counts in board.put_out()]
    found = [i for i, counts in enumerate(forces) if counts in ends]
    last = max((i for i, counts in enumerate(forces) if counts), default=0)
    return f"{max(last - found[-1], 0)} behind {trace.sample.size}" if found else f"unknown, behind {trace.sample.size}"


def _runs_again(scene: Path, board: Board) -> str:
    words = [sys.executable, "-m", "hapsim", "run", str(scene), "--port", board.port, "--duration", "0.2"]
    for _ in range(3):  # a busy machine may be too late for the device's watchdog
        ran = subprocess.run(words, capture_output=True, text=True, check=False)
        if ran.returncode == 0:
            return "yes"
    return f"no: {ran.stderr.strip().splitlines()[-1][:60]}"


def _wait(until: Callable[[], bool]) -> None:
    give_up = time.monotonic() + PATIENCE_S
    while not until():
        if time.monotonic() > give_up:
            raise SystemExit(f"not seen within {PATIENCE_S:g} s")
        time.sleep(0.02)


def _swinging(clock: str, place: Path) -> Path:
    text = (ROOT / "tools/bench/swinging.yaml").read_text("utf-8")
    path = place / f"{clock}.yaml"
    path.write_text(text.replace("clock: device", f"clock: {clock}"), "utf-8")
    return path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clock", choices=("device", "host"), nargs="+", default=["device", "host"])
    parser.add_argument("--only", nargs="+", default=[""], metavar="WORDS", help="Cases with one of these words.")
    options = parser.parse_args()
    for clock in options.clock:
        print(f"\nclock: {clock}\n\n| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
        for case in CASES:
            if any(word in f"{case.who}, {case.how}" for word in options.only):
                print(f"| {' | '.join(_played_at_last(case, clock))} |", flush=True)


def _played_at_last(case: Case, clock: str) -> list[str]:
    for _ in range(ATTEMPTS):
        with tempfile.TemporaryDirectory(prefix="hapsim-kills-") as place:
            cells = played(case, _swinging(clock, Path(place)), clock, Path(place))
        if cells is not None:
            return cells
    raise SystemExit(f"{case.who}, {case.how}: {ATTEMPTS} times the host was too late for the device before that")


if __name__ == "__main__":
    main()
