"""Cost of a step of a string, short and long, next to C programs and to another version of hapsim.

    tools/bench/step [--rounds 15] [--masses 1000 10000 100000] [--beside CHECKOUT]

A hand holds the string at a third of its length. Each program has a process of its own, and they take turns. Processor
time is measured. The C program in place updates two rows of positions with the widest vectors of the processor
(`reference/rows_in_place.c`); the plain one has three rows (`stencil.c`, -O3 -march=native). Their forces are compared
first. *Dead* is a string so quiet that all its numbers are denormals, once in a thread that treats these as zero, as
hapsim's loop does, and once in a thread that does not. Last comes the cost of 48 steps per sample in an exchange in
memory, with a device at 1 kHz and a string of 1000.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from ctypes import POINTER, Structure, byref, c_double, c_int64
from pathlib import Path
from typing import Any

import numpy as np
from steadiness.machine import describe_machine

import hapsim
from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.scene import Device, Scene
from hapsim.speed_accuracy.comparison import Running
from hapsim.speed_accuracy.objects import scene_of
from hapsim.speed_accuracy.strings import StringOfMasses, Timed, hand_link, hand_motion, held_mass
from speed.peers.c_stencil import CStencil
from speed.reference.build import build_c
from speed.reference.memory import pointer, rows

RATE = 44_100.0
_BLOCK, _WIDTH = 1024, 8
_ROUND_S = 0.1
_AGREES = 1e-9  # of the largest force
_BESIDE = "the other hapsim"


class _InPlaceState(Structure):
    _fields_ = (
        ("rows", POINTER(c_double) * 2),
        *((name, c_double) for name in ("centre", "side", "old_centre", "old_side", "mobility")),
        *((name, c_double) for name in ("hand_stiffness", "hand_damping", "hand_before")),
        *((name, c_int64) for name in ("held", "masses", "turn")),
    )


class InPlace:
    """The C program with two rows, its hand moving as `hand_motion` says."""

    def __init__(self, string: StringOfMasses) -> None:
        self._library = build_c("rows_in_place.c").load()
        self._rows = rows(2, string.masses + 3 * _WIDTH)
        mobility = 1.0 / (string.mass * RATE**2)
        damping, (hand_stiffness, hand_damping) = mobility * string.damping * RATE, hand_link(string)
        both = mobility * string.stiffness + damping
        self._state = _InPlaceState((POINTER(c_double) * 2)(*(pointer(row) for row in self._rows)))
        for name, value in {
            "centre": 2.0 - 2.0 * both,
            "side": both,
            "old_centre": 1.0 - 2.0 * damping,
            "old_side": damping,
            "mobility": mobility,
            "hand_stiffness": hand_stiffness,
            "hand_damping": hand_damping * RATE,
            "held": held_mass(string),
            "masses": string.masses,
        }.items():
            setattr(self._state, name, value)
        self._motion, self._forces = hand_motion(_BLOCK, RATE), np.zeros(_BLOCK)

    def advance(self, samples: int) -> None:
        """Simulates samples, the hand's motion over and over."""
        for begin in range(0, samples, _BLOCK):
            self.run(self._motion[: min(_BLOCK, samples - begin)])

    def run(self, motion: np.ndarray) -> np.ndarray:
        """The forces on the hand in N while it moves as told, in m; shape (samples,) both."""
        moved = np.ascontiguousarray(motion)
        forces = self._forces if moved.size <= _BLOCK else np.zeros(moved.size)
        state, size = byref(self._state), c_int64(moved.size)
        self._library.rows_in_place_run(state, size, pointer(moved), pointer(forces))
        return forces[: moved.size]


def string_of(masses: int, rate: float = RATE) -> StringOfMasses:
    """One that is stable, however long: K T²/m = 1/4, B T/m = 1/100."""
    mass = 1e-4
    return StringOfMasses(masses, mass, 0.25 * mass * rate**2, 0.01 * mass * rate)


def _scene(string: StringOfMasses, precision: str) -> Scene:
    return scene_of(string, "cordis", precision, RATE, *hand_link(string))


def _hapsim(string: StringOfMasses, precision: str) -> Callable[[int], object]:
    return Running(_scene(string, precision)).advance


def _plain(string: StringOfMasses) -> Callable[[int], object]:
    run = CStencil(hand=True, plain=True).running(string, RATE)
    run.start_in(np.zeros(string.masses))
    run.hold(*hand_link(string))
    return run.with_hand


def _dead(string: StringOfMasses, precision: str, flushed: bool) -> Callable[[int], object]:
    """The string full of denormals, its hand at 0."""
    scene = _scene(string, precision)
    program, first = compile_scene(scene), numbers_of(scene)["string.0"]
    still, force = np.zeros((2, _BLOCK, 1))
    start(program, still[0])
    quiet = 1e-310 if precision == "double" else 1e-40

    def advance(samples: int) -> None:
        _flush_denormals(False)
        program.rows[:, first : first + string.masses] = quiet
        _flush_denormals(flushed)
        for begin in range(0, samples, _BLOCK):
            ticks(program, still, still, force, min(_BLOCK, samples - begin))
        _flush_denormals(True)

    return advance


def _flush_denormals(on: bool) -> None:
    """Sets the treatment of denormals in this thread."""
    build_c("rows_in_place.c").load().flush_denormals(int(on))


_PROGRAMS: dict[str, Callable[[StringOfMasses], Callable[[int], object]]] = {
    "hapsim": lambda string: _hapsim(string, "double"),
    "C in place": lambda string: InPlace(string).advance,
    "plain C": _plain,
    "hapsim, single": lambda string: _hapsim(string, "single"),
    "dead": lambda string: _dead(string, "double", flushed=True),
    "dead, denormals kept": lambda string: _dead(string, "double", flushed=False),
    "dead, single": lambda string: _dead(string, "single", flushed=True),
    "dead, single, denormals kept": lambda string: _dead(string, "single", flushed=False),
}
_RATIOS = (
    ("hapsim", "C in place"),
    ("hapsim", "plain C"),
    ("hapsim", _BESIDE),
    ("hapsim, single", f"{_BESIDE}, single"),
    ("dead, denormals kept", "dead"),
    ("dead, single, denormals kept", "dead, single"),
)


def _work() -> None:
    """Runs in a process of its own: reads a program and a number of masses per line, prints the µs of a step."""
    timed: dict[tuple[str, int], Timed] = {}
    _flush_denormals(True)
    for line in sys.stdin:
        name, masses = line.rsplit(" ", 1)
        key = name, int(masses)
        if key not in timed:
            timed[key] = Timed(_PROGRAMS[name](string_of(key[1])), 1e6, _ROUND_S)
        print(timed[key].round(), flush=True)


class _Worker:
    """A process for one program, of this state of hapsim or of another; its answers."""

    def __init__(self, name: str, checkout: Path | None = None) -> None:
        self._name = name
        here = Path(__file__).resolve().parents[1]
        command = [sys.executable, "-m", "speed.step", "--work"]  # which finds hapsim where it starts
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=checkout or here.parents[1],
            env={**os.environ, "PYTHONPATH": str(here)},
        )

    def step_us(self, masses: int) -> float:
        """The time of a step, this round."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(f"{self._name} {masses}", file=self._process.stdin, flush=True)
        return float(self._process.stdout.readline())

    def end(self) -> None:
        """Ends the process."""
        self._process.communicate()


def _require_agreement(masses: int) -> None:
    string = string_of(masses)
    scene, motion = _scene(string, "double"), hand_motion(2000, RATE)
    measured, velocity, force = np.zeros((3, motion.size, 1))
    measured[:, 0] = motion
    program = compile_scene(scene)
    start(program, np.zeros(1))
    ticks(program, measured, velocity, force, motion.size)
    apart = float(np.abs(InPlace(string).run(motion) - force[:, 0]).max() / np.abs(force).max())
    if not apart < _AGREES:
        raise SystemExit(f"C in place, {masses} masses: the forces are {apart:.1e} of the largest apart from hapsim's")
    print(f"C in place, {masses} masses: its forces and hapsim's agree to {apart:.1e} of the largest", file=sys.stderr)


def _table(costs: dict[tuple[str, int], list[float]], masses: list[int]) -> None:
    names = list(dict.fromkeys(name for name, _ in costs))
    print("| least, µs a step | " + " | ".join(f"{count} masses" for count in masses) + " |")
    print("|---|" + "---|" * len(masses))
    for name in names:
        print(f"| {name} | " + " | ".join(f"{min(costs[name, count]):.3g}" for count in masses) + " |")
    for one, other in ((one, other) for one, other in _RATIOS if one in names and other in names):
        cells = []
        for count in masses:
            ratios = [a / b for a, b in zip(costs[one, count], costs[other, count], strict=True)]
            cells.append(f"{statistics.median(ratios):.2f} [{min(ratios):.2f}, {max(ratios):.2f}]")
        print(f"| {one} / {other} | " + " | ".join(cells) + " |")


def _in_the_loop(rounds: int) -> None:
    """A hand alone and with a string, in virtual time, taking turns."""
    rate, substeps = 1000.0, 48
    string = string_of(1000, rate * substeps)
    modules = scene_of(string, "cordis", "double", rate * substeps, *hand_link(string)).modules
    shared: dict[str, Any] = {"version": 1, "rate": rate, "substeps": substeps}
    device = Device(clock="lockstep", mass=0.2, friction=1.0)
    scenes = [Scene(device=device, modules=taken, **shared) for taken in ({"hand": modules["hand"]}, modules)]
    added = []
    for _ in range(rounds + 1):
        alone, held = (_exchange_us(scene) for scene in scenes)
        added.append(held - alone)
    added = sorted(added[1:])
    per_step = [1e3 * value / substeps for value in (added[0], statistics.median(added), added[-1])]
    print(f"\n48 steps of a string of 1000 in a sample add {added[0]:.2f} µs to an exchange in memory at the least:")
    print("48 times {:.0f} ns (median {:.0f}, most {:.0f})".format(*per_step))


def _exchange_us(scene: Scene) -> float:
    seconds = 20.0
    begin = time.process_time()
    hapsim.run(scene, duration=seconds, keep=False)
    return 1e6 * (time.process_time() - begin) / (seconds * scene.rate)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--masses", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--beside", type=Path, metavar="CHECKOUT", help="Another state of hapsim, to time too")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        _work()
        return
    for masses in (1001, arguments.masses[0]):
        _require_agreement(masses)
    workers = {name: _Worker(name) for name in _PROGRAMS}
    if arguments.beside:
        for name in ("hapsim", "hapsim, single"):
            workers[name.replace("hapsim", _BESIDE)] = _Worker(name, arguments.beside)
    costs: dict[tuple[str, int], list[float]] = {}
    for i in range(arguments.rounds + 1):  # the first compiles
        print(f"round {i} of {arguments.rounds}", file=sys.stderr)
        for masses in arguments.masses:
            for name, worker in workers.items():
                cost = worker.step_us(masses)
                if i:
                    costs.setdefault((name, masses), []).append(cost)
    for worker in workers.values():
        worker.end()
    machine: dict[str, Any] = describe_machine("cc")
    print(f"{machine['cpu']}, {machine['kernel'].split()[1]}, load {machine['load_at_start']:.1f}\n")
    _table(costs, arguments.masses)
    _in_the_loop(arguments.rounds)


if __name__ == "__main__":
    main()
