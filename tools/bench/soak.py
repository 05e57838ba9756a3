"""A long run over a wire that damages frames: is every tick accounted for, and does memory stay what it is?

    tools/bench/soak [--minutes 30] [--damaged 0.001]

At 1 kHz, three processes: `hapsim mock`, `hapsim faults` in front of it, which flips a bit in a share of the frames,
and `hapsim run`. At the end the positions that the device sent are set against what the run says became of each, the
forces that the run sent against the device's own counters, and the memory of the run (RSS, every 10 s) against a
straight line. Where this machine holds a run or the mock up for longer than the guards allow, that run ends, as it
should: it is accounted for, and another one goes on with the time that is left.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
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
from hapsim.device.connection import read_register
from hapsim.device.ports import open_portable_port
from hapsim.errors import DeviceError

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "tools" / "bench" / "results" / "soak.json"
EVERY_S = 10.0
TRIES = 5
STATUSES = (0, 3, 4)  # done; the device stopped, or samples too slowly, where this machine holds it up
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
KEPT = (
    *("ticks", "duration_s", "deadline_misses", "lost_frames", "stale_positions", "crc_errors", "garbage_bytes"),
    *("released", "rejected_by_device", "error"),
)
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
    with contextlib.suppress(PermissionError):  # before other programs, where that is granted: a device waits for none
        os.setpriority(os.PRIO_PROCESS, process.pid, -5)
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


def soak(minutes: float, damaged: float) -> list[dict[str, Any]]:
    """Runs until their time is over: what every side said of each."""
    ends_s, runs = time.monotonic() + 60.0 * minutes, list[dict[str, Any]]()
    while not runs or (left_s := ends_s - time.monotonic()) > 1.0:
        runs.append(run(left_s if runs else 60.0 * minutes, damaged, seed=len(runs)))
        if runs[-1]["run"]["status"] not in STATUSES:
            break
    return runs


def run(duration_s: float, damaged: float, seed: int) -> dict[str, Any]:
    """One run: what every side said, and the samples of memory."""
    with tempfile.TemporaryDirectory() as folder:
        scene, script, device, port = (Path(folder) / name for name in ("scene.yaml", "script.yaml", "device", "port"))
        scene.write_text(SCENE, "utf-8")
        fault = f"{{kind: corrupt, probability: {damaged:g}, bits: 1, after_samples: 0}}"
        script.write_text(f"version: 1\nseed: {seed}\nfaults:\n  - {fault}\n", "utf-8")
        with running("mock", scene, "--link", device) as mock:
            wait_for(device, mock)
            with running("faults", script, "--port", device, "--path", port, "--json") as relay:
                wait_for(port, relay)
                with running(
                    "run", scene, "--port", port, "--duration", duration_s, "--reports", folder, "--json"
                ) as host:
                    memory = list(sampled(host))
                    out, err = host.communicate()
                relay.send_signal(signal.SIGINT)
                wire, _ = relay.communicate()
            return {
                "run": {key: json.loads(out).get(key) for key in KEPT}
                | {"status": host.returncode, "err": err[-2000:]},
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
    """The device's own counters, read once the port is free; retries if this machine is too slow."""
    for tries_left in reversed(range(TRIES)):
        try:
            with contextlib.closing(open_portable_port(port, 2_000_000)) as connection:
                return {name: read_register(connection, register) for name, register in COUNTERS.items()}
        except DeviceError:
            if not tries_left:
                raise
    raise AssertionError


def accounts(found: dict[str, Any]) -> list[tuple[str, int, str, int, int]]:
    """(what, how many, what it has to be, from how many to how many): the same from two sides."""
    report, wire, device = found["run"], found["wire"], found["device"]
    damaged = {way: wire[way]["frames_in"] - wire[way]["frames_out"] for way in ("from_device", "to_device")}
    ticks, lost, misses = report["ticks"], report["lost_frames"], report["deadline_misses"]
    # What the device sends between the last position that the run took and its DISARM: at most half a second of it.
    seen, under_way = ticks + lost, 500
    answered = ticks - report["stale_positions"]
    whole = device["accepted"] + device["expired"]
    return [
        (
            "positions that the device sent",
            wire["samples"],
            "ticks + lost, and what is under way at the end",
            seen,
            seen + under_way,
        ),
        (
            "positions lost, says the run",
            lost,
            "damaged frames of the device, but for a few of the set-up and the end",
            damaged["from_device"] - 2,
            damaged["from_device"],
        ),
        (
            "forces that were sent",
            wire["forces"]["count"] + damaged["to_device"],
            "ticks - stale positions, but for the last one and a farewell",
            answered - 2,
            answered + 2,
        ),
        (
            "forces that reached the device whole",
            wire["forces"]["count"],
            "accepted + too old, it says, but for what came as it stopped",
            whole,
            whole + 2,
        ),
        (
            "samples without a force in time, says the device",
            device["held"],
            "deadline misses, and those of which the news was lost or under way",
            misses,
            misses + lost + under_way,
        ),
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
    every = soak(options.minutes, options.damaged)
    runs = [found for found in every if found["run"]["ticks"] is not None]  # the others were never armed
    if not runs:
        raise SystemExit(f"no run was armed: {every[-1]['run']['err']}")
    each = [accounts(found) for found in runs]
    summed = [
        (rows[0][0], sum(row[1] for row in rows), rows[0][2], sum(row[3] for row in rows), sum(row[4] for row in rows))
        for rows in zip(*each, strict=True)
    ]
    whole = all(least <= count <= most for rows in each for _, count, _, least, most in rows)
    ticks, misses = (sum(found["run"][key] for found in runs) for key in ("ticks", "deadline_misses"))
    statuses = ", ".join(str(found["run"]["status"]) for found in runs)
    unarmed = f", and {len(every) - len(runs)} that were not armed" if len(every) > len(runs) else ""
    print(
        f"{options.minutes:g} minutes, {len(runs)} runs (status {statuses}){unarmed}: {ticks} ticks, "
        f"{misses} deadline misses\n"
    )
    print("| from one side | | from another | | |\n|---|---:|---|---:|---|")
    for what, count, other, least, most in summed:
        expected = str(least) if least == most else f"{least} to {most}"
        print(f"| {what} | {count} | {other} | {expected} | {'yes' if least <= count <= most else '**no**'} |")
    longest = max(runs, key=lambda found: len(found["memory"]))["memory"]
    slope, error = slope_of(longest)
    is_flat = abs(slope) <= max(3 * error, FLAT_KB_PER_MINUTE)
    if longest:
        kilobytes = [kb for _, kb in longest]
        print(
            f"\nMemory of the longest run: {min(kilobytes)} to {max(kilobytes)} kB in {len(kilobytes)} samples, "
            f"{slope:+.2g} ± {error:.2g} kB a minute: {'flat' if is_flat else 'not flat, or too short to tell'}"
        )
    document = {"minutes": options.minutes, "damaged": options.damaged, "accounts": summed, "whole": whole}
    document |= {
        "slope_kb_per_minute": _number(slope),
        "slope_error_kb_per_minute": _number(error),
        "flat": bool(is_flat),
    }
    RESULTS.write_text(json.dumps(document | {"runs": runs}, indent=1) + "\n", "utf-8")
    sys.exit(0 if whole and is_flat and all(found["run"]["status"] in STATUSES for found in runs) else 1)


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


if __name__ == "__main__":
    main()
