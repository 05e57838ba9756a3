"""Sound of a scene: underruns next to a C client's, latency, and the two clocks.

    tools/bench/sound [--seconds 60] [--rounds 1] [--realtime]    a C client and hapsim, alone and beside busy Python
    tools/bench/sound --minutes 10 [--realtime]                   one run over a pseudo-terminal

Sound goes to JACK's dummy driver, 128 frames at 44.1 kHz. The scene is a string with 48 steps per sample of a device at
1 kHz. The busy Python thread runs in hapsim's process; for the C client it has a process of its own. With `--realtime`
hapsim and JACK request real-time scheduling; JACK extends it to its clients' threads. The bench needs Debian's jackd2
and libportaudio2 and, for the C client, gcc and portaudio19-dev.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import hapsim

_HERE = Path(__file__).parent
_SCENE = """\
version: 1
rate: 1000
substeps: 48
device: {mass: 0.2, clock: device, friction: 1.0}
mock: {initial: {velocity: 0.1}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  rest: {type: viscoelastic, between: [hand, wall], stiffness: 200, damping: 1}
  gut:  {type: string, masses: 60, mass: 0.0005, stiffness: 20000}
  pull: {type: viscoelastic, between: [hand, gut.7], stiffness: 50, damping: 0.1}
sound:
  ear: {from: gut.20, of: velocity, gain: 0.5, highpass: 20}
"""
_BUSY = "n = 0\nwhile True: n += 1"


@contextlib.contextmanager
def running(*command: str) -> Iterator[None]:
    """A program beside this one."""
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


@contextlib.contextmanager
def sound_server(realtime: bool) -> Iterator[None]:
    os.environ |= {"JACK_DEFAULT_SERVER": f"bench{os.getpid()}", "JACK_NO_START_SERVER": "1"}
    scheduling = ("-R", "-P", "60") if realtime else ("--no-realtime",)
    card = "-d", "dummy", "-r", "44100", "-p", "128"
    with running("jackd", "-n", os.environ["JACK_DEFAULT_SERVER"], *scheduling, *card):
        listed = ""
        while "system" not in listed:
            time.sleep(0.1)
            listed = subprocess.run(["hapsim", "sound", "--json"], capture_output=True, check=True, text=True).stdout
        yield


@contextlib.contextmanager
def busy_thread() -> Iterator[None]:
    over = threading.Event()

    def work() -> None:
        n = 0
        while not over.is_set():
            n += 1

    threading.Thread(target=work, daemon=True).start()
    yield
    over.set()


def figures_of(report: Mapping[str, Any]) -> dict[str, object]:
    """Returns the printed values of a report."""
    p50, p99 = report["sound_latency_s"] or (0.0, 0.0)
    return {
        "underruns": report["underruns"],
        "lost frames": report["lost_sound_frames"],
        "ppm": round(report["resampling_ppm"] or 0.0, 2),
        "latency p50, p99 ms": (round(1e3 * p50, 2), round(1e3 * p99, 2)),
        "deadline misses": f"{report['deadline_misses']} of {report['ticks']}",
        "seconds": round(report["duration_s"], 1),
    }


def of_hapsim(seconds: float, realtime: bool) -> dict[str, object]:
    """The report of a run, with its mock in this process."""
    options = {"duration": seconds, "transport": "terminal", "sound": True, "realtime": realtime, "keep": False}
    with hapsim.start(hapsim.parse_scene(_SCENE, "sound"), **options) as session:
        session.wait()
    return figures_of(vars(session.trace.report))


def of_long_run(seconds: float, directory: Path, realtime: bool) -> dict[str, object]:
    """The report of `hapsim run --reconnect` on a mock in a process of its own."""
    port, scene, scheduling = directory / "port", directory / "scene.yaml", ["--realtime"] * realtime
    scene.write_text(_SCENE)
    with running("hapsim", "mock", str(scene), "--link", str(port), *scheduling):
        while not port.exists():
            time.sleep(0.1)
        run = [
            "hapsim",
            "run",
            scene,
            "--port",
            port,
            "--duration",
            str(seconds),
            "--reconnect",
            "--reports",
            directory,
        ]
        answer = subprocess.run([*run, "--sound", "--json", *scheduling], stdout=subprocess.PIPE, check=True)
    report = json.loads(answer.stdout)
    return figures_of(report) | {"reconnections": report["reconnections"]}


def of_c(client: Path, seconds: float) -> dict[str, object]:
    answer = subprocess.run([client, str(seconds)], capture_output=True, check=True, text=True)
    return dict(json.loads(answer.stdout))


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/sound", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--realtime", action="store_true")
    arguments = parser.parse_args()
    realtime = arguments.realtime
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(sound_server(realtime))

        def show(what: str, found: dict[str, object]) -> None:
            print(f"{what:<40}{found}, load {os.getloadavg()[0]:.1f}", flush=True)

        if arguments.minutes:
            show(f"{arguments.minutes:g} minutes", of_long_run(60.0 * arguments.minutes, directory, realtime))
            return
        client = directory / "client"
        subprocess.run(["cc", "-O2", _HERE / "sound_client.c", "-lportaudio", "-lm", "-o", client], check=True)
        for _ in range(arguments.rounds):
            show("C", of_c(client, arguments.seconds))
            with running(sys.executable, "-c", _BUSY):
                show("C, beside busy Python", of_c(client, arguments.seconds))
            show("hapsim", of_hapsim(arguments.seconds, realtime))
            with busy_thread():
                show("hapsim, beside a busy Python thread", of_hapsim(arguments.seconds, realtime))


if __name__ == "__main__":
    main()
