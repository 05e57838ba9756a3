"""The way of the reference firmware's servo until it rests: its host killed, stopped or interrupted, frames
lost, its force sensor broken.

    tools/bench/stopping [--only WORDS ...] [--runs 1]

The device is the Linux board with a servo (firmware_protocol/firmware/servo), in real time. A hand of 300 N/m and
5 N·s/m moves its handle to and fro by 0.2 m, by 0.02 m where the sensor breaks. In the table: the speed of the last
commands; the way beyond the last command until rest and what PROTOCOL.md, section 6.2, allows, v²/2a + v (t + 1) T; the
time until the torque ends; how the host ended. For a broken sensor the way is that from the fault on, with the hand's
own. A machine that samples too slowly ends a run by itself (status 4, "the device samples at"): repeat it.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import hapsim

ROOT = Path(__file__).parents[2]
SCENE = """
version: 1
rate: 1 kHz
device:
  mode: admittance
  clock: device
  simulated_mass: 1 kg
  simulated_damping: 5 N·s/m
  servo: {bandwidth: 50 Hz, damping: 1}
  assumed_hand: {stiffness: 300 N/m, damping: 5 N·s/m}
modules:
  hand: {type: device, channel: 0}
"""
PERIOD_S, TIME_TO_LIVE, BRAKING = 1e-3, 20, 20.0  # s, samples as hapsim asks for at 1 kHz, m/s²
FAULT_SAMPLE = 2500
LOSSES = """
version: 1
faults: [{kind: drop, direction: to_device, probability: 0.2}]
"""
CASES = {
    "host killed": signal.SIGKILL,
    "host stopped for 2 s": signal.SIGSTOP,
    "host interrupted": signal.SIGINT,
    "one frame in five lost": None,
    "sensor dead": None,
    "sensor inverted": None,
    "sensor saturated": None,
    "sensor drifting": None,
}
Log = NDArray[np.int64]


class Board:
    """The Linux board with a servo; `log`: microseconds, position, command, torque, accepted frames, a row per tick."""

    def __init__(self, path: Path, *keys: str) -> None:
        self.path = path
        command = [ROOT / "firmware_protocol/firmware/board", "linux_servo", path, *keys]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.port = self.process.stdout.readline().strip()

    def log(self) -> Log:
        whole = [line.split() for line in self.path.read_text("ascii").splitlines(keepends=True) if line.endswith("\n")]
        rows = np.array([[int(word, 16) for word in line] for line in whole], np.int64).reshape(-1, 5)
        return np.where(rows >= 1 << 31, rows - (1 << 32), rows) if rows.size else rows

    def wait_for(self, accepted: int, patience_s: float = 90.0) -> bool:
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            log = self.log()
            if log.size and log[-1, 4] >= accepted:
                return True
            time.sleep(0.1)
        return False


def way_beyond(log: Log) -> tuple[float, float, float]:
    """Returns the speed of the last command (m/s), the way beyond it (m), and the time from it to no torque (s)."""
    last = int(np.flatnonzero(np.diff(log[:, 4]) > 0)[-1]) + 2  # the tick after the one that put it out
    last = min(last, len(log) - 1)
    speed = 1e-9 * (log[last, 2] - log[last - 1, 2]) / PERIOD_S
    way = 1e-9 * np.abs(log[last:, 1] - log[last, 2])[np.sign(log[last:, 1] - log[last, 2]) == np.sign(speed)]
    off = np.flatnonzero(log[last:, 3] == 0)
    return abs(speed), float(way.max(initial=0.0)), float(off[0] * PERIOD_S) if off.size else np.inf


def run(case: str, work: Path) -> tuple[str, ...]:
    scene = work / "servo.yaml"
    scene.write_text(SCENE, "utf-8")
    fault = case.removeprefix("sensor ") if case.startswith("sensor") else ""
    keys = [f"fault={fault}", f"at={FAULT_SAMPLE}", "swing=0.02"] if fault else ["swing=0.2"]
    board, relay = Board(work / "log", *keys), None
    port = board.port
    if "lost" in case:
        (work / "lost.yaml").write_text(LOSSES, "utf-8")
        words = ["faults", work / "lost.yaml", "--port", port, "--path", work / "port", "--duration", 60]
        relay = subprocess.Popen([sys.executable, "-m", "hapsim", *map(str, words)], stdout=subprocess.DEVNULL)
        while not (work / "port").exists():
            time.sleep(0.1)
        port = str(work / "port")
    words = ["run", scene, "--port", port, "--duration", 8 if fault or relay else 600]
    host = subprocess.Popen(
        ["nice", "-n", "-15", sys.executable, "-m", "hapsim", *map(str, words)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        if (sent := CASES[case]) is not None and board.wait_for(2300):
            host.send_signal(sent)
            if sent == signal.SIGSTOP:
                time.sleep(2.0)
                host.send_signal(signal.SIGCONT)
        read = host.communicate(timeout=120)[1] or ""
        time.sleep(1.5)
        log = board.log()
    finally:
        host.kill()
        for process in (board.process, relay):
            if process is not None:
                process.terminate()
                process.wait()
    speed, way, off = way_beyond(log)
    allowed = speed**2 / 2.0 / BRAKING + speed * (TIME_TO_LIVE + 1) * PERIOD_S
    if fault:
        begun = int(np.flatnonzero(log[:, 3])[0]) + FAULT_SAMPLE
        way, allowed = 1e-9 * float(np.abs(log[begun:, 1] - log[begun, 1]).max()), np.nan
    lines = [line for line in read.splitlines() if line.strip()]
    figures = (f"{speed:.3f}", f"{1e3 * way:.2f}", f"{1e3 * allowed:.2f}", f"{1e3 * off:.0f}", f"{host.returncode}")
    return (case, *figures, lines[-1][:160] if lines else "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--runs", type=int, default=1)
    asked = parser.parse_args()
    print(f"hapsim {hapsim.__version__}")
    print("| case | speed, m/s | way, mm | allowed, mm | torque ends, ms | status | the user read |")
    print("|---|---|---|---|---|---|---|")
    for case in [case for case in CASES if not asked.only or any(word in case for word in asked.only)]:
        for _ in range(asked.runs):
            with tempfile.TemporaryDirectory() as work:
                print("|", " | ".join(run(case, Path(work))), "|", flush=True)


if __name__ == "__main__":
    main()
