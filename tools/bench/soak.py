"""A long run over a wire that damages frames: is every tick accounted for, and does memory stay what it is?

    tools/bench/soak [--minutes 30] [--damaged 0.001]

At 1 kHz, three processes: `hapsim mock`, `hapsim faults` in front of it, which flips a bit in so many of the frames,
and `hapsim run`. At the end the positions that the device sent are set against what the run says became of each, the
forces that the run sent against the device's own counters, and the memory of the run (RSS, every 10 s) against a
straight line.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.device.conversation import read_register
from hapsim.device.serial_port import open_portable_port

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "tools" / "bench" / "results" / "soak.json"
EVERY_S = 10.0
WARM_UP_S = 20.0  # until a process has touched what it works on
FLAT_KB_PER_MINUTE = 4.0  # one page in a minute: less than that no straight line tells from a single page
SCENE = """\
version: 1
rate: 1000
device: {clock: device, mass: 0.2, friction: 1.0, delay: 1}
mock: {initial: {velocity: 0.1}}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}
"""
COUNTERS = {
    "accepted": schema.REG_ACCEPTED,
    "rejected": schema.REG_REJECTED,
    "held": schema.REG_HELD,
    "expired": schema.REG_EXPIRED,
    "limited": schema.REG_LIMITED,
}


@contextlib.contextmanager
def running(*words: object) -> Iterator[subprocess.Popen[str]]:
    """A hapsim command in a process of its own, told to stop at the end."""
    command = [sys.executable, "-m", "hapsim", *map(str, words)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.communicate()


def wait_for(link: Path, process: subprocess.Popen[str]) -> None:
    while not link.is_symlink():
        if process.poll() is not None:
            raise SystemExit(f"{' '.join(map(str, process.args))}: {process.communicate()[1]}")  # type: ignore[arg-type]
        time.sleep(0.05)


def resident_kb(pid: int) -> int:
    for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    return 0


def run(minutes: float, damaged: float) -> dict[str, Any]:
    """One soak: what every side said, and the samples of memory."""
    with tempfile.TemporaryDirectory() as folder:
        scene, script, device, port = (Path(folder) / name for name in ("scene.yaml", "script.yaml", "device", "port"))
        scene.write_text(SCENE, "utf-8")
        fault = f"{{kind: corrupt, probability: {damaged:g}, bits: 1, after_samples: 0}}"
        script.write_text(f"version: 1\nseed: 1\nfaults:\n  - {fault}\n", "utf-8")
        with running("mock", scene, "--link", device) as mock:
            wait_for(device, mock)
            with running("faults", script, "--port", device, "--path", port, "--json") as relay:
                wait_for(port, relay)
                with running("run", scene, "--port", port, "--duration", 60.0 * minutes, "--json") as host:
                    memory = list(sampled(host))
                    out, err = host.communicate()
                relay.send_signal(signal.SIGINT)
                wire, _ = relay.communicate()
            return {
                "run": json.loads(out) | {"status": host.returncode, "err": err[-2000:]},
                "wire": json.loads(wire),
                "device": counters_of(str(device)),
                "memory": memory,
            }


def sampled(host: subprocess.Popen[str]) -> Iterator[tuple[float, int]]:
    """(s, kB) of a process until it ends."""
    begun, due = time.monotonic(), EVERY_S
    while host.poll() is None:
        if time.monotonic() - begun >= due:
            with contextlib.suppress(OSError):
                if kb := resident_kb(host.pid):
                    yield round(time.monotonic() - begun, 1), kb
            due += EVERY_S
        time.sleep(0.1)


def counters_of(port: str) -> dict[str, int]:
    """The device's own, asked of itself once nobody else is on the port."""
    with contextlib.closing(open_portable_port(port, 2_000_000)) as connection:
        return {name: read_register(connection, register) for name, register in COUNTERS.items()}


def accounts(found: dict[str, Any]) -> list[tuple[str, int, str, int]]:
    """(what, how many, what it has to be, how many): pairs that say the same from two sides."""
    report, wire, device = found["run"], found["wire"], found["device"]
    damaged = {way: wire[way]["frames_in"] - wire[way]["frames_out"] for way in ("from_device", "to_device")}
    after = wire["samples"] - report["ticks"] - report["lost_frames"]
    sent = wire["forces"]["count"]
    return [
        (
            "positions that the device sent",
            wire["samples"],
            f"ticks ({report['ticks']}) + lost ({report['lost_frames']}) + sent after the last tick ({after})",
            report["ticks"] + report["lost_frames"] + after,
        ),
        ("positions lost, says the run", report["lost_frames"], "frames of the device damaged", damaged["from_device"]),
        (
            "forces that reached the device whole",
            sent,
            "accepted + too old, says the device",
            device["accepted"] + device["expired"],
        ),
        ("frames of the host damaged", damaged["to_device"], "frames refused, says the device", device["rejected"]),
        ("frames refused, says the run", report["crc_errors"], "frames of the device damaged", damaged["from_device"]),
    ]


def slope_of(memory: list[tuple[float, int]]) -> tuple[float, float]:
    """(kB a minute, its standard error) of a straight line, after the warm-up."""
    time_s, kb = np.array([one for one in memory if one[0] >= WARM_UP_S], float).reshape(-1, 2).T
    if time_s.size < 4:
        return float("nan"), float("nan")
    minutes = (time_s - time_s.mean()) / 60.0
    slope = (minutes @ kb) / (minutes @ minutes)
    residual = kb - kb.mean() - slope * minutes
    return float(slope), float(np.sqrt(residual @ residual / (time_s.size - 2) / (minutes @ minutes)))


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/soak", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--damaged", type=float, default=0.001, help="share of the frames (0.001)")
    options = parser.parse_args()
    found = run(options.minutes, options.damaged)
    report, memory = found["run"], found["memory"]
    print(
        f"{options.minutes:g} minutes: {report['ticks']} ticks, {report['deadline_misses']} deadline misses, status "
        f"{report['status']}\n"
    )
    print("| from one side | | from another | | |\n|---|---:|---|---:|---|")
    for what, count, other, expected in accounts(found):
        print(
            f"| {what} | {count} | {other} | {expected} | {'same' if count == expected else f'{count - expected:+d}'} |"
        )
    slope, error = slope_of(memory)
    kilobytes = [kb for _, kb in memory]
    is_flat = abs(slope) <= max(3 * error, FLAT_KB_PER_MINUTE)
    if kilobytes:
        print(
            f"\nMemory of the run: {min(kilobytes)} to {max(kilobytes)} kB in {len(kilobytes)} samples, "
            f"{slope:+.2g} ± {error:.2g} kB a minute: {'flat' if is_flat else 'not flat'}"
        )
    found |= {"minutes": options.minutes, "damaged": options.damaged, "accounts": accounts(found)}
    found |= {"slope_kb_per_minute": slope, "slope_error_kb_per_minute": error, "flat": bool(is_flat)}
    RESULTS.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
