"""Cost of many walls in the plane: a tick, a start and `hapsim check`, beside another version of hapsim.

    tools/bench/walls [--walls 80] [--rounds 15] [--beside CHECKOUT] [--scene]

The walls are thin capsules on a grid, in a room, with exact joints. A hand is pushed about by a random force, so that
it is free for some of the time, and pressed into walls and corners for the rest. All versions get the positions of
that one run. They take turns in processes of their own, with full caches; processor time is measured. --scene prints
the scene's file alone.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hapsim import load_scene
from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene

ROOT = Path(__file__).resolve().parents[2]
PITCH, RADIUS, NODES = 0.008, 0.001, 10  # m, m, and nodes along each side of the grid
SAMPLES = 20_000
_SEED = 1


def scene_of(walls: int) -> str:
    """Returns the file of a scene with a room and `walls` - 1 walls, on different edges of a grid."""
    edges = [
        ((i, j), (i + di, j + dj))
        for i in range(NODES)
        for j in range(NODES)
        for di, dj in ((1, 0), (0, 1))
        if i + di < NODES and j + dj < NODES
    ]
    chosen = np.random.default_rng(_SEED).permutation(len(edges))[: walls - 1]
    middle, side = 0.5 * (NODES - 1), PITCH * (NODES - 1)
    head = f"""\
version: 1
rate: 1000
space: 2
device: {{mass: 0.2, friction: 1.0, delay: 1, force_limit: 10}}
modules:
  hand: {{type: device, channels: [0, 1]}}
  board: {{type: ground}}
  room: {{type: shape, between: [hand, board], form: {{box: [{side:g}, {side:g}]}}, side: inside,
         stiffness: 1200, damping: 4}}
"""
    lines = []
    for number, edge in enumerate(chosen.tolist()):
        ends = [[round((node[0] - middle) * PITCH, 9), round((node[1] - middle) * PITCH, 9)] for node in edges[edge]]
        form = f"{{capsule: {ends}, radius: {RADIUS}}}"
        more = "stiffness: 1200, damping: 4"
        lines.append(f"  w{number}: {{type: shape, between: [hand, board], form: {form}, {more}}}\n")
    return head + "".join(lines)


def way_in(path: str) -> np.ndarray:
    """Returns the positions of a hand of 0.2 kg that a random force of some 1 N pushes about in a scene, (SAMPLES, 2)
    m."""
    program, random = compile_scene(load_scene(path)), np.random.default_rng(_SEED)
    at, v, push, force, way = np.array([0.0041, 0.0043]), np.zeros(2), np.zeros(2), np.zeros((1, 2)), []
    start(program, at)
    for _ in range(SAMPLES):
        way.append(at.copy())
        ticks(program, at[None], np.zeros((1, 2)), force, 1)
        push += 0.005 * -push + 0.1 * random.normal(size=2)
        v += 1e-3 / 0.2 * (force[0] + push - v)
        at += 1e-3 * v
    return np.array(way)


def tick_forever(scene: str, way: str) -> None:
    """Prints the processor time of a tick, ns, for each number of times that it reads. Runs in a process of one
    version."""
    program, positions = compile_scene(load_scene(scene)), np.load(way)
    forces, still = np.zeros_like(positions), np.zeros_like(positions)
    for line in sys.stdin:
        begin = time.process_time()
        for _ in range(int(line)):
            start(program, positions[0])
            ticks(program, positions, still, forces, len(positions))
        print(1e9 * (time.process_time() - begin) / len(positions) / int(line), flush=True)


class Version:
    """A checkout of hapsim, with a process for ticks of each scene."""

    def __init__(self, root: Path, scenes: dict[str, str], folder: str) -> None:
        self._environment: dict[str, Any] = os.environ | {"PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"}
        self._root, self._ticks = root, {}
        for name, path in scenes.items():
            command = [sys.executable, __file__, "--tick", path, f"{folder}/{name}.npy"]
            self._ticks[name] = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=self._environment, cwd=root
            )

    def tick_ns(self, name: str, times: int) -> float:
        process = self._ticks[name]
        assert process.stdin is not None
        assert process.stdout is not None
        print(times, file=process.stdin, flush=True)
        return float(process.stdout.readline())

    def processor_s(self, *words: str) -> float:
        """Returns the processor time of a command of hapsim's, s, with all that it starts."""
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "hapsim", *words]
        done = subprocess.run(
            command, env=self._environment, cwd=self._root, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(f"{' '.join(words)}: {done.stderr}")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def spread(values: list[float], form: str) -> str:
    return f"{statistics.median(values):{form}} [{min(values):{form}}, {max(values):{form}}]"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--walls", type=int, default=80)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--beside", type=Path)
    parser.add_argument("--scene", action="store_true")
    parser.add_argument("--tick", nargs=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.tick:
        tick_forever(*options.tick)
    elif options.scene:
        print(scene_of(options.walls), end="")
    else:
        compare(options)


def compare(options: argparse.Namespace) -> None:
    with tempfile.TemporaryDirectory() as folder:
        walls = Path(folder) / "walls.yaml"
        walls.write_text(scene_of(options.walls))
        scenes = {"maze": str(ROOT / "configs/maze.yaml"), f"{options.walls} walls": str(walls)}
        roots = {"here": ROOT} | ({"beside": options.beside.resolve()} if options.beside else {})
        for name, path in scenes.items():
            np.save(f"{folder}/{name}.npy", way_in(path))
        versions = {name: Version(root, scenes, folder) for name, root in roots.items()}
        for name, loops in zip(scenes, (10, 2), strict=True):
            rounds = [[one.tick_ns(name, loops) for one in versions.values()] for _ in range(options.rounds)]
            for version, each in zip(versions, zip(*rounds, strict=True), strict=True):
                print(f"tick of {name}, {version}: {spread(list(each), '.0f')} ns")
            if len(versions) > 1:
                print(f"  ratio {spread([here / beside for here, beside in rounds], '.3f')}")
        for words in (["run", str(walls), "--duration", "0.01"], ["check", str(walls)]):
            for name, version in versions.items():
                version.processor_s(*words)  # fills the cache
                took = [version.processor_s(*words) for _ in range(3)]
                print(f"{words[0]} of {options.walls} walls, {name}: {spread(took, '.2f')} s of processor time")


if __name__ == "__main__":
    main()
