"""Simulated masses whose position a device follows, their loop written out in SI units: referee of theory and mock.

The histories of all positions are kept, and one sample is worked out as the equations stand; the columns of the loop's
matrix are its answers to ones. Nothing of it comes from hapsim.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

T = 1e-3
PRESSED = 2e-3  # m, by which a wall is pressed
KINDS = ("free", "wall", "spring", "chain")
Link = tuple[float, float, float]
"""A mass, kg (0: the ground), on a spring, N/m, and a damper, N·s/m, to the one before it; the first to X."""


@dataclass(frozen=True)
class Loop:
    """One simulated mass in a hand, SI units. ``servo_hz`` 0: the device follows exactly."""

    kind: str = "free"
    mass: float = 0.2
    damping: float = 5.0
    hand_stiffness: float = 2000.0
    hand_damping: float = 0.0
    hand_mass: float = 0.0
    delay: float = 1.0
    servo_hz: float = 0.0
    servo_damping: float = 1.0
    links: tuple[Link, ...] = ()

    @property
    def yaml(self) -> str:
        """Scene of it, with the same hand on the mock."""
        servo = f"servo: {{bandwidth: {self.servo_hz!r}, damping: {self.servo_damping!r}}}, " if self.servo_hz else ""
        wall, rest = 0.0, 0.0
        if self.kind == "wall":  # the hand presses it from the start, at rest
            wall = PRESSED
            rest = -self.links[0][1] * wall / self.hand_stiffness
        hand = f"stiffness: {self.hand_stiffness!r}, damping: {self.hand_damping!r}, mass: {self.hand_mass!r}"
        at = ["hand", *(f"m{i}" if mass else "ground" for i, (mass, _, _) in enumerate(self.links))]
        kind = "buffer" if self.kind == "wall" else "viscoelastic"
        lines = [
            f"  {name}: {{type: mass, mass: {m!r}}}" for name, (m, _, _) in zip(at[1:], self.links, strict=True) if m
        ]
        for i, (_, k, b) in enumerate(self.links):
            ends = f"between: [{at[i]}, {at[i + 1]}], stiffness: {k!r}, damping: {b!r}"
            lines.append(f"  link{i}: {{type: {kind}, {ends}}}")
        modules = "\n".join(lines)
        return f"""version: 1
rate: {1.0 / T}
device:
  {{mode: admittance, simulated_mass: {self.mass!r}, simulated_damping: {self.damping!r}, delay: {self.delay!r},
  {servo}assumed_hand: {{{hand}}}, clock: lockstep}}
mock: {{hand: {{{hand}, position: {rest!r}}}, quantum: 1e-11, force_sensor: {{limit: 20}}}}
modules:
  hand: {{type: device, channel: 0}}
  ground: {{type: ground, position: {wall!r}}}
{modules}
"""

    @property
    def spring(self) -> float:
        """Stiffness that holds X, N/m: that of the hand and of links to the ground."""
        return self.hand_stiffness + sum(k for m, k, _ in self.links if not m)

    def transition(self) -> np.ndarray[Any, Any]:
        """Returns the matrix from a sample to the next."""
        whole, masses = math.floor(self.delay), sum(1 for m, _, _ in self.links if m)
        part, depth = self.delay - whole, math.floor(self.delay) + 4
        w = 2.0 * math.pi * self.servo_hz
        pieces = [expm(t * _servo(w, self.servo_damping)) for t in (part * T, (1.0 - part) * T)]

        def sample(state: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
            past, rest = state[:depth], state[depth:]  # X[n], X[n-1], ...
            points, before = rest[:masses], rest[masses : 2 * masses]
            x, v, x1, x2 = rest[2 * masses :]
            if not w:
                x, x1, x2 = ((1.0 - part) * past[at] + part * past[at + 1] for at in (whole, whole + 1, whole + 2))
                v = (past[whole] - past[whole + 1]) / T
            f = -self.hand_stiffness * x - self.hand_damping * v - self.hand_mass * (x - 2.0 * x1 + x2) / T**2
            here, there, forces = [past[0], *points], [past[1], *before], np.zeros(masses + 1)
            for i, (m, k, b) in enumerate(self.links):
                stretch = here[i] - (here[i + 1] if m else 0.0)
                was = there[i] - (there[i + 1] if m else 0.0)
                pull = k * stretch + b * (stretch - was) / T
                forces[i] -= pull
                if m:
                    forces[i + 1] += pull
            forces[0] += f - self.damping * (past[0] - past[1]) / T
            heavy = [self.mass, *(m for m, _, _ in self.links if m)]
            new, *moved = (
                2.0 * now - then + T**2 / m * force
                for now, then, m, force in zip(here, there, heavy, forces, strict=True)
            )
            commands, servo = [new, *past], np.array([x, v])
            for age, piece in zip((whole + 1, whole), pieces, strict=True):
                servo = (piece @ [*servo, commands[age]])[:2]
            device = [*servo, x, x1] if w else [0.0] * 4
            return np.array([new, *past[:-1], *moved, *points, *device])

        size = depth + 2 * masses + 4
        return np.column_stack([sample(one) for one in np.eye(size)])

    def pair(self) -> tuple[float, float, float]:
        """Returns the spectral radius, and m and b of the slowest poles; NaN if these are no pair."""
        poles = np.linalg.eigvals(self.transition())
        slow = sorted(poles, key=lambda z: -abs(z))
        radius, first = abs(slow[0]), slow[0]
        if self.kind == "chain" or not abs(first.imag) > 1e-9:
            return radius, math.nan, math.nan
        s = np.log(first) / T
        m = self.spring / abs(s) ** 2
        return radius, m, -2.0 * m * s.real - self.hand_damping


def _servo(w: float, ratio: float) -> np.ndarray[Any, Any]:
    """Rates of position, velocity and command."""
    return np.array([[0.0, 1.0, 0.0], [-(w**2), -2.0 * ratio * w, w**2], [0.0, 0.0, 0.0]])


def random_loop(seed: int) -> Loop:
    """Returns a loop, mostly a stable one; the same for the same seed."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    mass, kh = math.exp(rng.uniform(math.log(0.05), 0.0)), math.exp(rng.uniform(math.log(100.0), math.log(4000.0)))
    delay = float(rng.choice([0.0, 1.0, 2.0, rng.uniform(0.0, 3.0)]))
    hz = float(rng.choice([0.0, math.exp(rng.uniform(math.log(20.0), math.log(400.0)))]))
    lag = (delay - 0.5) * T + 2.0 / (2.0 * math.pi * hz) if hz else delay * T
    bh, swing = rng.uniform(0.0, 5.0), math.sqrt(kh * mass)
    damping = max(0.0, kh * lag + rng.uniform(-0.05, 0.6) * swing - bh)
    links: list[Link] = []
    if kind in ("wall", "spring"):
        links = [(0.0, rng.uniform(50.0, 2000.0), rng.uniform(0.0, 3.0))]
    elif kind == "chain":
        links = [
            (rng.uniform(0.01, 0.5), rng.uniform(50.0, 2000.0), rng.uniform(0.1, 3.0))
            for _ in range(rng.integers(1, 4))
        ]
        links += [(0.0, rng.uniform(50.0, 2000.0), rng.uniform(0.1, 3.0))] * int(rng.integers(0, 2))
    own = (mass, damping, kh, bh, float(rng.choice([0.0, 0.1 * mass])), delay, hz, float(rng.uniform(0.5, 1.5)))
    return Loop(kind, *map(float, own), tuple((float(m), float(k), float(b)) for m, k, b in links))


def largest_errors(
    seeds: Iterable[int], predicted: Callable[[Loop], tuple[float, float, float]]
) -> tuple[list[float], int, int]:
    """Returns how far ``predicted``, a function like `Loop.pair`, is off at most: spectral radius, m over M, b over M/T
    times 1000; and how many loops have a pair, and how many are unstable."""
    worst, pairs, unstable = np.zeros(3), 0, 0
    for seed in seeds:
        loop = random_loop(seed)
        radius, m, b = loop.pair()
        found = predicted(loop)
        assert math.isnan(found[1]) == math.isnan(m), (seed, loop)
        off = np.array(
            [found[0] - radius, (found[1] - m) / loop.mass, (found[2] - b) / (loop.damping + loop.hand_damping)]
        )
        worst = np.fmax(worst, np.abs(off))
        pairs, unstable = pairs + (not math.isnan(m)), unstable + (radius > 1.0)
    return worst.tolist(), pairs, unstable
