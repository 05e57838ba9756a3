"""Masses of a string, a membrane and an irregular network that one core moves in real time, with a hand on them.

    tools/bench/capacity [--seconds 2] [--only string ...] [--rates 1000 ...] [--json FILE] [--picture FILE]
                         [--alone] [--from FILE.json]

The device runs at 1 and at 10 kHz; 44.1 and 48 kHz are 45 steps of a device at 980 Hz and 48 of one at 1 kHz. The
processor time of a step alone gives the number of masses that *fit*: their steps take 3/4 of the sample period. The
rest is for the exchange and a late wake-up. With `--alone` the bench stops there.

Otherwise it runs all of them, 2/3, 1/3 and 1/10. A number is *carried* if at most 0.1 % more samples of the device miss
their force than with a hand alone. The mock has its own process and processor, on a pseudo-terminal. Loop and mock run
at nice -20 if the system permits it. Runs with and without masses alternate, up to four times; the quietest run of each
counts. It needs an otherwise idle machine.

Nothing beyond MOST masses is tried. The same run measures a step of the plain C program of `reference/stencil.c`, and
of Faust's mi.lib if it is installed, up to the longest string that it compiles.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import math
import os
import signal
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from steadiness.machine import describe_machine, share_out_processors
from steadiness.mock import mock_device

import hapsim
from hapsim.chart.figure import figure_to
from hapsim.errors import HapsimError
from hapsim.scene import Device, DevicePoint, Mass, Membrane, Scene, String, ViscoElastic
from hapsim.speed_accuracy.comparison import Running
from hapsim.speed_accuracy.strings import Timed, hand_link
from speed.peers.c_stencil import CStencil
from speed.peers.faust_mi import FaustMi
from speed.peers.faust_model import Drive
from speed.step import string_of

STEPS = {1000: (1000.0, 1), 10_000: (10_000.0, 1), 44_100: (980.0, 45), 48_000: (1000.0, 48)}
"""Hz of the scene's steps -> the device's rate, and substeps."""
OBJECTS = ("string", "membrane", "network")
MOST = {"string": 400_000, "membrane": 360_000, "network": 10_000}
_PIECE = {"string": 100_000, "membrane": 90_000}  # what a scene allows of one
_FILLED = 0.75
_SHARES = (1.0, 0.67, 0.33, 0.1)
_ROUNDS = 4
_MORE_MISSES = 1e-3
_HOPELESS = 0.02
_ROUND_S = 0.05
_MASS = 1e-4
_FAUST_MASSES = (100, 200, 400)


def scene_of(kind: str, masses: int, step_rate: int, precision: str, port: str | None = None) -> Scene:
    """So many masses and a hand on one of them; a hand alone for none."""
    rate, substeps = STEPS[step_rate]
    stiffness, damping = 0.2 * _MASS * step_rate**2, 0.01 * _MASS * step_rate
    modules: dict[str, Any] = {"hand": DevicePoint(channel=0)}
    if masses:
        held = _network(modules, masses, stiffness, damping) if kind == "network" else ""
        for i, piece in enumerate(_pieces(kind, masses) if kind != "network" else ()):
            shared = {"mass": _MASS, "stiffness": stiffness, "damping": damping}
            if kind == "string":
                modules[f"s{i}"], held = String(masses=piece, **shared), f"s0.{piece // 3}"
            else:
                rows = math.isqrt(piece)
                modules[f"s{i}"] = Membrane(rows=rows, columns=piece // rows, **shared)
                held = f"s0.{rows // 3}.{rows // 3}"
        modules["touch"] = ViscoElastic(between=("hand", held), stiffness=min(0.1 * stiffness, 200.0))
    device = Device(clock="device", mass=0.2, friction=1.0, port=port)
    numerics: Any = {"substeps": substeps, "precision": precision}
    return Scene(version=1, rate=rate, device=device, modules=modules, **numerics)


def _pieces(kind: str, masses: int) -> list[int]:
    count = -(-masses // _PIECE[kind])
    return [masses // count] * count


def _network(modules: dict[str, Any], masses: int, stiffness: float, damping: float) -> str:
    """A tree of masses with as many links again between any two of them: two links a mass. Returns the held one."""
    rng = np.random.default_rng(1)
    modules |= {f"m{i}": Mass(mass=_MASS) for i in range(masses)}
    for i in range(1, masses):
        ends = max(0, i - 1 - int(rng.integers(50))), int(rng.integers(i))
        for place, end in zip("ab", ends, strict=True):
            link = ViscoElastic(between=(f"m{i}", f"m{end}"), stiffness=0.1 * stiffness, damping=0.1 * damping)
            modules[f"{place}{i}"] = link
    return "m0"


def step_seconds(kind: str, masses: int, step_rate: int, precision: str) -> float:
    """Processor time of a step, without a loop: the least of three rounds."""
    scene = scene_of(kind, masses, step_rate, precision)
    timed = Timed(Running(scene).advance, 1.0, _ROUND_S)
    return min(timed.round() for _ in range(3))


class OnPort:
    """A mock on a pseudo-terminal, for runs of scenes that differ in nothing that the device sees."""

    def __init__(self, port: str, seconds: float) -> None:
        self._port, self._seconds = port, seconds

    def misses(self, scene: Scene) -> float:
        """The share of the device's samples whose force was late or missing; 1 where the run fails."""
        device = scene.device.model_copy(update={"port": self._port})
        scene = scene.model_copy(update={"device": device})
        try:
            with hapsim.start(scene, duration=self._seconds) as session:
                session.wait(None)
            report = session.trace.report
        except HapsimError as error:
            print(f"    {str(error)[:150]}", file=sys.stderr)
            return 1.0
        samples = report.ticks + report.lost_frames
        return (report.deadline_misses + report.lost_frames) / max(samples, 1)


def carried(port: OnPort | None, kind: str, step_rate: int, precision: str) -> dict[str, Any]:
    """One cell of the table; without a `port` only what fits."""
    rate, substeps = STEPS[step_rate]
    budget = 1.0 / (rate * substeps)
    masses = 2000
    for _ in range(3):
        filled = budget / step_seconds(kind, masses, step_rate, precision)
        masses = max(10, min(MOST[kind], round(_FILLED * filled * masses)))
    fits = _rounded(masses)
    found: dict[str, Any] = {"object": kind, "step_rate": step_rate, "precision": precision}
    found |= {"fits": fits, "most": MOST[kind]}
    if port is None:
        return found
    empty = scene_of(kind, 0, step_rate, precision)
    for tried in (_rounded(share * fits) for share in _SHARES):
        scene = scene_of(kind, tried, step_rate, precision)
        pairs: list[tuple[float, float]] = []
        while len(pairs) < _ROUNDS and not _is_decided(pairs):
            pairs.append((port.misses(empty), port.misses(scene)))
        empties, fulls = (min(column) for column in zip(*pairs, strict=True))
        print(f"  {tried}: {100 * fulls:.2f} % late, empty {100 * empties:.2f} %", file=sys.stderr, flush=True)
        if fulls < 1.0 and fulls - empties <= _MORE_MISSES:
            return found | {"masses": tried, "late": fulls, "late_empty": empties}
    return found | {"masses": 0}


def _is_decided(pairs: list[tuple[float, float]]) -> bool:
    """It is carried, or far from that."""
    if len(pairs) < 2:
        return False
    empties, fulls = (min(column) for column in zip(*pairs, strict=True))
    return not _MORE_MISSES < fulls - empties < _HOPELESS


def _rounded(masses: float) -> int:
    """Rounds down to two digits."""
    unit = 10 ** max(0, math.floor(math.log10(max(masses, 1.0))) - 1)
    return int(masses // unit * unit)


def peers(cells: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yields the cost of a step of the plain C program, where hapsim carries a string in double precision, and of
    Faust."""
    for cell in cells:
        if (cell["object"], cell["precision"]) == ("string", "double") and cell["fits"] <= _PIECE["string"]:
            yield _reference("plain C", cell["fits"], _plain_c)
    if not FaustMi(hand=True).available():
        for masses in _FAUST_MASSES:
            yield _reference("Faust mi.lib", masses, _faust)


def _plain_c(masses: int) -> tuple[Callable[[int], object] | None, str]:
    string = string_of(masses)
    run = CStencil(hand=True, plain=True).running(string, 44_100.0)
    run.start_in(np.zeros(masses))
    run.hold(*hand_link(string))
    return run.with_hand, ""


def _faust(masses: int) -> tuple[Callable[[int], object] | None, str]:
    peer = FaustMi(hand=True)
    run = peer.running(string_of(masses), 44_100.0, Drive.HAND)
    return (run.advance if run else None), peer.note


def _reference(
    who: str, masses: int, program: Callable[[int], tuple[Callable[[int], object] | None, str]]
) -> dict[str, Any]:
    """Five rounds in which it and hapsim take turns, both with a string of so many masses."""
    advance, note = program(masses)
    found: dict[str, Any] = {"peer": who, "masses": masses, "note": note}
    if advance is None:
        return found
    ours = Timed(Running(scene_of("string", masses, 44_100, "double")).advance, 1.0, _ROUND_S)
    theirs = Timed(advance, 1.0, _ROUND_S)
    rounds = [(theirs.round(), ours.round()) for _ in range(5)]
    return found | {"step_s": min(a for a, _ in rounds), "ratios": sorted(a / b for a, b in rounds)}


def _go_first() -> bool:
    """Returns whether the system gives this process and its children priority. Real-time scheduling would keep the
    kernel's own worker, which carries a pseudo-terminal's bytes, from a processor that is busy with masses."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, -20)
    except PermissionError:
        return False
    return True


@contextlib.contextmanager
def _mock(step_rate: int, cpus: set[int]) -> Iterator[str]:
    """Yields the port of a mock."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "device.yaml"
        empty = scene_of("", 0, step_rate, "double").model_dump(mode="json", exclude_defaults=True)
        path.write_text(json.dumps(empty | {"version": 1, "mock": {"initial": {"position": 0.002}}}))
        with mock_device(path, cpus) as port:
            yield port


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """All cells, and the peers."""
    of_device, of_loop = share_out_processors()
    first = _go_first()
    machine = describe_machine("cc")
    os.sched_setaffinity(0, of_loop)
    cells: list[dict[str, Any]] = []
    try:
        for step_rate in arguments.rates:
            with contextlib.nullcontext() if arguments.alone else _mock(step_rate, of_device) as port:
                line = OnPort(port, arguments.seconds) if port else None
                for kind, precision in itertools.product(arguments.only, ("double", "single")):
                    print(f"{kind}, {step_rate} Hz, {precision}", file=sys.stderr)
                    cells.append(carried(line, kind, step_rate, precision))
    except KeyboardInterrupt:  # also what SIGTERM becomes
        print("Interrupted: what was measured so far follows.", file=sys.stderr)
    return {"machine": machine, "first": first, "cells": cells, "peers": list(peers(cells))}


def print_report(document: dict[str, Any]) -> None:
    """The table."""
    machine, cells = document["machine"], document["cells"]
    rates = sorted({cell["step_rate"] for cell in cells})
    print(f"{machine['cpu']}, {machine['cores']} cores, load at start {machine['load_at_start']:.1f}; ", end="")
    print(f"before other programs: {'yes' if document['first'] else 'no'}\n")
    print("| masses that fit | " + " | ".join(f"{rate / 1000:g} kHz" for rate in rates) + " |")
    print("|---|" + "---|" * len(rates))
    for kind in OBJECTS:
        for precision in ("double", "single"):
            row = {c["step_rate"]: c for c in cells if (c["object"], c["precision"]) == (kind, precision)}
            if row:
                print(f"| {kind}, {precision} | " + " | ".join(_cell(row.get(rate)) for rate in rates) + " |")
    for peer in document["peers"]:
        if "step_s" in peer:
            least, *_, most = peer["ratios"]
            print(
                f"- {peer['peer']}, a string of {peer['masses']}: {1e6 * peer['step_s']:.3g} µs a step, "
                f"{statistics.median(peer['ratios']):.2f} [{least:.2f}, {most:.2f}] of hapsim's. {peer['note']}"
            )
        else:
            print(f"- {peer['peer']}, a string of {peer['masses']}: {peer['note']}")


def _cell(cell: dict[str, Any] | None) -> str:
    if cell is None:
        return "–"
    least = "≥ " if cell["fits"] == cell["most"] else ""
    carried_too = f"; carried {cell['masses']:,}" if "masses" in cell else ""
    return f"{least}{cell['fits']:,}{carried_too}".replace(",", " ")


def draw(document: dict[str, Any], path: Path) -> None:
    """Masses over the rate of the steps, beside what others have published."""
    with figure_to(path, 6.4, 4.2) as figure:
        axes = figure.subplots()
        for kind, colour in zip(OBJECTS, ("#d95f0e", "#2b6ca3", "0.35"), strict=True):
            for precision, line in (("double", "-"), ("single", ":")):
                found = [c for c in document["cells"] if (c["object"], c["precision"]) == (kind, precision)]
                points = sorted((c["step_rate"], c["fits"]) for c in found)
                if points:
                    axes.plot(*zip(*points, strict=True), line, color=colour, marker="o", label=f"{kind}, {precision}")
        published = (
            ("miPhysics, elements", [(1000, 10_000), (44_100, 400)], "s"),
            ("mi-gen, elements", [(44_100, 1800)], "D"),
        )
        for name, points, marker in published:
            axes.plot(*zip(*points, strict=True), marker, color="black", label=f"{name}, published")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xticks(sorted(STEPS), ["1", "10", "44.1  ", "   48"])
        axes.minorticks_off()
        axes.set_xlabel("steps a second, kHz")
        axes.set_ylabel("masses whose steps fill 3/4 of a core")
        axes.grid(color="0.9", linewidth=0.6)
        axes.legend(frameon=False, fontsize=8)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=2.0, help="Of each run [default: 2]")
    parser.add_argument("--only", nargs="+", choices=OBJECTS, default=list(OBJECTS))
    parser.add_argument("--rates", nargs="+", type=int, choices=STEPS, default=list(STEPS))
    parser.add_argument("--alone", action="store_true", help="Only what fits, without a device")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--from", type=Path, dest="kept", help="Print and draw what --json kept")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    document = json.loads(arguments.kept.read_text(encoding="utf-8")) if arguments.kept else measure(arguments)
    print_report(document)
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if arguments.picture:
        draw(document, arguments.picture)


if __name__ == "__main__":
    main()
