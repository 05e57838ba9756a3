"""Records an hour of four channels at 4 kHz in virtual time, and exports it as each of ENDINGS [default: h5].

`tools/bench/export [--hours H] [ENDING ...]`: the seconds and the largest memory of `hapsim export`, run by itself. It
takes 4 GB in the directory for temporary files.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import hapsim

SCENE = """
version: 1
rate: 4000
device: {clock: lockstep, mass: 0.2, friction: 0.1, force_limit: 10}
mock: {initial: {velocity: 0.1}, hand: {stiffness: 5}, noise: 1.0e-6}
modules:
  wall: {type: ground}
"""
for _c in range(4):
    SCENE += f"""\
  hand{_c}: {{type: device, channel: {_c}}}
  touch{_c}: {{type: spring, between: [hand{_c}, wall], stiffness: 100}}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("endings", nargs="*", default=["h5"])
    parser.add_argument("--hours", type=float, default=1.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        record = Path(directory) / "hour.trace"
        begun = time.monotonic()
        report = hapsim.run(
            hapsim.parse_scene(SCENE), duration=3600.0 * options.hours, record=record, keep=False
        ).report
        took = time.monotonic() - begun
        print(f"{report.ticks} rows, {record.stat().st_size / 1e9:.2f} GB, recorded in {took:.1f} s", flush=True)
        for ending in options.endings:
            export(record, record.with_suffix(f".{ending}"))


def export(record: Path, out: Path) -> None:
    column = ["--column", "force.0"] if out.suffix == ".wav" else []
    begun = time.monotonic()
    process = subprocess.Popen([sys.executable, "-m", "hapsim", "export", record, out, *column])
    _, status, usage = os.wait4(process.pid, 0)
    took = time.monotonic() - begun
    if status:
        raise SystemExit(f"{out.suffix}: hapsim export ended with status {status}")
    size, memory, busy = out.stat().st_size / 1e9, usage.ru_maxrss / 1e3, usage.ru_utime + usage.ru_stime
    times = f"{took:.1f} s, {busy:.1f} s of the processor"
    print(f"{out.suffix}: {times}, {size:.2f} GB, at most {memory:.0f} MB of memory", flush=True)
    out.unlink()


if __name__ == "__main__":
    main()
