"""The loop in Python on a Windows Python under Wine, beside Linux's loops: rate, deadline misses, lateness, starts.

    tools/bench/windows [--seconds 4] [--rounds 3] [--place ~/.cache/hapsim-wine]

The mock is a Linux process behind a pseudo-terminal, which Wine has as COM5. Within a round all take turns.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

CLONE = Path(__file__).resolve().parents[2]
RATES = (500, 1000, 2000)
SCENE = """\
version: 1
rate: {rate}
device: {{mass: 0.2, friction: 1.0, clock: {clock}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 300, damping: 2}}
"""
RUN = """
import json, time, hapsim
from hapsim.scene import load_scene
from hapsim.prediction.linear import with_device
scene = load_scene(path)
scene = with_device(scene, port=port) if port else scene
begun = time.perf_counter()
trace = hapsim.run(scene, duration=seconds, keep=False, unstable=True, **options)
report, elapsed = trace.report, time.perf_counter() - begun
late, exchange = report.lateness_s, report.exchange_s
print(json.dumps({
    "rate kept  Hz": report.rate_hz, "misses  %": 100.0 * report.deadline_misses / report.ticks,
    "late  µs": 1e6 * (late.p50 or 0.0), "late, 99 %  µs": 1e6 * (late.p99 or 0.0),
    "exchange  µs": 1e6 * (exchange.p50 or 0.0), "exchanges/s": report.ticks / elapsed,
}))
"""


class Answers:
    """A Python that runs scenes, all in one process."""

    def __init__(self, python: list[str], **environment: str) -> None:
        self._process = subprocess.Popen(
            [*python, str(CLONE / "tests" / "cli" / "answers.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": str(CLONE)} | environment,
            encoding="utf-8",
        )

    def run(self, scene: Path, port: str | None, seconds: float, **options: Any) -> dict[str, float]:
        """The figures of a run."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        given = {"path": str(scene), "port": port, "seconds": seconds, "options": options}
        code = "".join(f"{name} = {value!r}\n" for name, value in given.items()) + RUN
        print(json.dumps(["-c", code]), file=self._process.stdin, flush=True)
        status, output, errors = json.loads(self._process.stdout.readline())
        if status:
            sys.exit(errors)
        figures: dict[str, float] = json.loads(output)
        return figures


@contextlib.contextmanager
def mock_at(scene: Path, place: Path) -> Iterator[str]:
    """The scene's mock behind a pseudo-terminal, which is COM5 under Wine; its port."""
    com5 = place / "prefix" / "dosdevices" / "com5"
    command = [sys.executable, "-m", "hapsim", "mock", str(scene), "--link", str(scene.with_suffix(""))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as mock:
        assert mock.stdout is not None
        mock.stdout.readline()
        com5.unlink(missing_ok=True)
        com5.symlink_to(os.path.realpath(scene.with_suffix("")))
        try:
            yield str(scene.with_suffix(""))
        finally:
            com5.unlink()
            mock.terminate()


def starts(place: Path, scene: Path) -> dict[str, float]:
    """Seconds of commands under Wine: a first `run`, which compiles, a later one, and `check`."""
    users = place / "prefix" / "drive_c" / "users"
    for cache in users.glob("*/.cache/hapsim"):
        shutil.rmtree(cache)
    found = {}
    for name, words in (("first run", "run"), ("later run", "run"), ("check", "check")):
        begun = time.perf_counter()
        lasts = ("--duration", "0.1") if words == "run" else ()
        subprocess.run(
            [place / "hapsim", words, scene, *lasts, "--json"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=True,
        )
        found[f"{name}  s"] = time.perf_counter() - begun
    return found


def measured(place: Path, folder: Path, seconds: float, windows: Answers, linux: Answers) -> Iterator[tuple[str, Any]]:
    """Yields what was run, and its figures."""
    ways: tuple[tuple[str, Answers, dict[str, Any]], ...] = (
        ("Wine, COM5", windows, {}),
        ("Linux, portable loop", linux, {"portable": True}),
        ("Linux, compiled loop", linux, {}),
    )
    for clock in ("device", "host", "lockstep"):
        for rate in RATES if clock != "lockstep" else (1000,):
            scene = folder / f"{clock}{rate}.yaml"
            scene.write_text(SCENE.format(rate=rate, clock=clock), encoding="utf-8")
            with mock_at(scene, place) as port:
                for name, python, options in ways:
                    to = "COM5" if python is windows else port
                    figures = python.run(scene, to, seconds, **options)
                    as_fast_as_possible = {"exchanges/s": figures.pop("exchanges/s")}
                    yield f"{clock} {rate} Hz, {name}", as_fast_as_possible if clock == "lockstep" else figures
    yield "starts under Wine", starts(place, scene)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--place", type=Path, default=Path.home() / ".cache" / "hapsim-wine")
    options = parser.parse_args()
    subprocess.run([CLONE / "tools" / "wine", options.place], stdin=subprocess.DEVNULL, capture_output=True, check=True)
    wine = {"LC_ALL": "C.UTF-8", "WINEPREFIX": str(options.place / "prefix"), "WINEDEBUG": "-all"}
    windows = Answers(["wine", str(options.place / "python" / "python.exe")], **wine)
    linux = Answers([sys.executable])
    rounds: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(options.rounds):
            for name, figures in measured(options.place, Path(folder), options.seconds, windows, linux):
                rounds.setdefault(name, []).append(figures)
    for name, each in rounds.items():
        print(name)
        for key in each[0]:
            values = [one[key] for one in each]
            print(f"    {key:16} {statistics.median(values):.4g} [{min(values):.4g}, {max(values):.4g}]")


if __name__ == "__main__":
    main()
