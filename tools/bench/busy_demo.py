"""Demos that live while a browser starts beside them on busy cores, and the processor time that a demo takes.

    tools/bench/busy_demo [--runs 10] [--seconds 10] [--busy 2] [--scene first_touch] [--transports default terminal]

Each run is `hapsim run SCENE --serve` as a process of its own, beside as many programs that compute without a pause as
`--busy` says. Once it runs, Chromium (headless) starts and opens its page. After `--seconds` the run is stopped
by SIGTERM. It lives if that ended it, with status 0 and no pause. The transports take turns. Processor time
is that of the demo from the opening of the page on, page's server included.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SECOND = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Outcome:
    """A demo's end."""

    lives: bool
    ending: str
    seconds: float
    late: int
    rate_hz: float
    cores: float
    """Processor time over time."""


def processor_s(pid: int) -> float:
    """Returns the processor time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / SECOND


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Keeps `count` processes computing without a pause during the block."""
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(process.wait)
            stack.callback(process.kill)
        yield


@contextlib.contextmanager
def browser(url: str) -> Iterator[None]:
    """Chromium with this page, in a process group of its own."""
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        raise SystemExit("found no chromium, expected it on PATH")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = ["--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}"]
        streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen([program, *options, url], start_new_session=True, **streams)  # type: ignore[call-overload]
        try:
            yield
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def demo(scene: str, seconds: float, options: list[str]) -> Outcome:
    """Runs a demo beside a browser."""
    command = [sys.executable, "-m", "hapsim", "run", scene, "--serve-at", "127.0.0.1:0", "--json", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        words = ""
        while "running " not in words:
            if not (line := process.stderr.readline()):
                raise SystemExit(words)
            words += line
        found = re.search(r"http://[^\s\"]+", words)
        assert found is not None
        with browser(found[0]):
            begun, before = time.monotonic(), processor_s(process.pid)
            while process.poll() is None and time.monotonic() < begun + seconds:
                time.sleep(0.05)
                with contextlib.suppress(OSError, ValueError):
                    used, until = processor_s(process.pid) - before, time.monotonic()
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
            report = json.loads(process.communicate()[0])
    return Outcome(
        process.returncode == 0 and not report.get("interruptions"),
        report.get("ending") or str(report.get("error")),
        report.get("duration_s", 0.0),
        report.get("deadline_misses", 0),
        report.get("rate_hz", 0.0),
        used / (until - begun),
    )


def main() -> None:
    """Prints a row for each transport."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--busy", type=int, default=2)
    parser.add_argument("--scene", default="first_touch")
    parser.add_argument("--transports", nargs="+", default=["default", "terminal"])
    asked = parser.parse_args()
    found: dict[str, list[Outcome]] = {one: [] for one in asked.transports}
    with busy(asked.busy):
        for _ in range(asked.runs):
            for transport, outcomes in found.items():
                options = [] if transport == "default" else ["--transport", transport]
                outcomes.append(demo(asked.scene, asked.seconds, options))
                print(f"  {transport}: {outcomes[-1]}", file=sys.stderr)
    print(f"{asked.scene}, {os.cpu_count()} cores, {asked.busy} busy, load {os.getloadavg()[0]:.1f}")
    for transport, outcomes in found.items():
        late, cores = sorted(one.late for one in outcomes), sorted(one.cores for one in outcomes)
        middle = len(outcomes) // 2
        print(
            f"{transport}: {sum(one.lives for one in outcomes)} of {len(outcomes)} live; late samples {late[middle]} "
            f"in the median, {late[-1]} at most; {cores[middle]:.2f} cores in the median"
        )


if __name__ == "__main__":
    main()
