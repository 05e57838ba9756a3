"""Counts, noise and lost frames with the law on the board, beside the host's law: how a hand moves and is pushed.

    tools/bench/board_rough [--seeds 3]

A whole host, past its guards, answers a simulated device of 0.2 kg and 1 N·s/m, which follows lines at 10 kHz. With the
host's law it holds forces, which act a local period later. A wire loses this share of the frames both ways.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "loop"))

from board_device import MASS, RATE, STEPS, Line, force_of, scene_with
from loop_rig import arrive
from test_loop_board_exchange import COUNT, NEWTON, Host

from firmware_protocol import schema
from firmware_protocol.frames import frame_to_host
from hapsim.loop.portable import _on_force_sent as on_force_sent

H, FRICTION, LIVES = 1.0 / (RATE * STEPS), 1.0, 20
LINKS: dict[str, dict[str, Any]] = {
    "spring, 2000 N/m, 5 N·s/m": {"type": "viscoelastic", "stiffness": 2000, "damping": 5},
    "corner, 2000|500 N/m": {"type": "nonlinear", "force_over_distance": [[-0.01, -20], [0, 0], [0.01, 5]]},
    "wall, 2000 N/m, 5 N·s/m": {"type": "buffer", "stiffness": 2000, "damping": 5},
}


class HoldingHost(Host):
    """A loop with the host's law, as lines without stiffness."""

    def answer(self, x: float, *, kind: int = schema.POSITION, gap: int = 1, after_ms: float = 0.0) -> Line:  # noqa: ARG002
        self.number += gap
        now = 10**9 + self.number * 10**6
        arrive(self.loop, frame_to_host(self.loop.wire, kind, self.number % 4096, [round(x / COUNT)]), now)
        on_force_sent(self.loop.record, now)
        (row,) = self.loop.ring.drain()
        force = float(row["force_counts"][0]) * NEWTON
        return force, 0.0, 0.0, force, force


def moved(link: dict[str, Any], law: str, delay: int, chance: Any, **rough: float) -> tuple[Any, Any]:
    """Returns places, m, and forces, N, of a second, by local period. `rough`: quantum and noise of the readings, m;
    lost share of frames; the hand's press, N, its place and its speed."""
    scene = scene_with({"touch": link}, device={"law": law, "delay": delay, "soft_start": 0.0})
    host = Host(scene) if law == "board" else HoldingHost(scene, lines=None)
    quantum, noise, lost = rough.get("quantum", COUNT), rough.get("noise", 0.0), rough.get("lost", 0.0)
    decay = math.exp(-FRICTION / MASS * H)
    glide = (1.0 - decay) * MASS / FRICTION
    x, v, force, gap, age = rough.get("place", 0.0), rough.get("speed", 0.0), 0.0, 1, LIVES
    line, past, due, path = ((0.0,) * 5, x), deque([x] * STEPS, STEPS), {}, []
    for n in range(1000):
        for step in range(STEPS):
            read = round((x + noise * chance.normal()) / quantum) * quantum
            if step == 0 and chance.random() < lost:
                gap += 1
            elif step == 0:
                kind = schema.POSITION_HELD if n > delay and n not in due else schema.POSITION
                answer, gap = host.answer(read, kind=kind, gap=gap), 1
                due |= {n + delay: (answer, read)} if chance.random() >= lost else {}
            if step == 0:
                age = 0 if n in due else age + 1
                (f, k, *rest), at = line if age < LIVES else ((0.0,) * 5, read)
                line = due.pop(n, ((f, max(k, 0.0), *rest), at))
            acts, force = force, force_of(line[0], read - line[1], (read - past[-1]) / (STEPS * H))
            past.appendleft(read)
            push = acts + rough.get("press", 0.0)
            x, v = x + glide * v + (H - glide) / FRICTION * push, decay * v + (1.0 - decay) / FRICTION * push
            path.append((x, acts))
    places, forces = np.array(path).T
    return places, forces


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    resting = [
        {"quantum": q, "noise": e} for q, e in ((1e-6, 0.0), (1e-5, 0.0), (1e-4, 0.0), (1e-7, 2e-6), (1e-5, 2e-6))
    ]
    losing = [{"lost": share, "speed": -0.2} for share in (0.0, 0.01, 0.1, 0.5)]
    for name, link in LINKS.items():
        press = {"press": -0.05, "place": -2.5e-5} if name.startswith("wall") else {"speed": -0.02}
        for rough in [press | one for one in resting] + losing + [one | {"press": -0.5} for one in losing]:
            for delay in (1, 3):
                found = []
                for law in ("host", "board"):
                    every = [moved(link, law, delay, np.random.default_rng(i), **rough) for i in range(options.seeds)]
                    swing, hiss = (max(one(path) for path in every) for one in (_swing, _hiss))
                    found.append(f"{law} {swing:9.2f} µm {hiss:6.3f} N {max(np.abs(f).max() for _, f in every):6.2f} N")
                words = ", ".join(f"{key} {value:g}" for key, value in rough.items())
                print(f"{name}, delay {delay}, {words}: swing, rms and most force: {'; '.join(found)}", flush=True)


def _swing(path: tuple[Any, Any]) -> float:
    return float(np.ptp(path[0][-2000:])) * 1e6


def _hiss(path: tuple[Any, Any]) -> float:
    return float(path[1][-2000:].std())


if __name__ == "__main__":
    main()
