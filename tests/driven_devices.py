"""Devices with a belt and a lagging motor, their loop written out in SI units: referee of the theory and of the mock.

Motor, handle and whatever hangs on it are masses at absolute places, moved by scipy's matrix exponential between the
changes of the force. The loop is one matrix from a sample to the next; nothing of it comes from hapsim.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

T = 1e-3
Hung = tuple[float, float, float]
"""A mass, kg, on a spring, N/m, and a damper, N·s/m, to the one before it; the first hangs on the handle."""


@dataclass(frozen=True)
class Device:
    """Device on a wall (K, B), SI units; without ``motor_mass`` motor and handle are one."""

    mass: float = 0.2
    friction: float = 1.0
    own_spring: float = 0.0
    belt: float = 0.0
    belt_damping: float = 0.0
    motor_mass: float = 0.0
    reads_handle: bool = False
    brakes_handle: bool = False
    lag: float = 0.0
    delay: float = 1.0
    hold: str = "zoh"
    K: float = 2000.0
    B: float = 5.0
    hung: tuple[Hung, ...] = ()

    @property
    def yaml(self) -> str:
        """Scene of it."""
        sides = [("motor", "handle")[at] for at in (self.reads_handle, self.brakes_handle)]
        belt = f"stiffness: {self.belt!r}, damping: {self.belt_damping!r}, motor_mass: {self.motor_mass!r}"
        belt = f"transmission: {{{belt}, sensor: {sides[0]}, friction_at: {sides[1]}}}, " if self.motor_mass else ""
        return f"""version: 1
rate: {1.0 / T}
device:
  {{mass: {self.mass!r}, friction: {self.friction!r}, stiffness: {self.own_spring!r}, {belt}motor_lag: {self.lag!r},
  delay: {self.delay!r}, hold: {self.hold}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {self.K!r}, damping: {self.B!r}}}
"""


def belted(resonance_hz: float, ratio: float = 0.02, share: float = 0.25, **others: object) -> Device:
    """Returns a device whose motor and handle swing against each other so, without a hand."""
    mass = float(others.get("mass", 0.2))  # type: ignore[arg-type]
    reduced, omega = mass * share * (1.0 - share), 2.0 * math.pi * resonance_hz
    belt = {"belt": reduced * omega**2, "belt_damping": 2.0 * ratio * reduced * omega, "motor_mass": share * mass}
    return Device(**{**belt, **others})  # type: ignore[arg-type]


def random_device(seed: int) -> Device:
    """Returns a device with a belt, a lag or both, on a wall that is often stable."""
    rng = np.random.default_rng(seed)
    mass, elastic = 10 ** rng.uniform(-1.5, 0.3), rng.random() < 0.8
    lag = 10 ** rng.uniform(-5.0, -2.7) if rng.random() < 0.5 or not elastic else 0.0
    others = {
        "mass": mass,
        "friction": mass * rng.uniform(0.0, 15.0),
        "own_spring": 0.0 if rng.random() < 0.7 else mass * rng.uniform(0.0, 2000.0),
        "lag": lag,
        "delay": float(rng.choice([0.0, 0.37, 1.0, 1.0, 1.6, 2.0])),
        "hold": str(rng.choice(["zoh", "zoh", "ramp"])),
        "K": mass * 10 ** rng.uniform(2.5, 4.3),
        "B": mass * rng.uniform(0.0, 40.0),
    }
    if not elastic:
        return Device(**others)  # type: ignore[arg-type]
    sides = {"reads_handle": bool(rng.random() < 0.5), "brakes_handle": bool(rng.random() < 0.5)}
    return belted(10 ** rng.uniform(1.5, 3.0), rng.uniform(0.0, 0.1), rng.uniform(0.1, 0.6), **others, **sides)


class Plant:
    """Moving parts: ``rates`` (n, n) of the state, ``force`` (n,) of the commanded force, ``push`` (n,) of the hand's;
    ``reading``, ``handle`` (n,): their positions."""

    def __init__(self, device: Device) -> None:
        motor, handle = (0, 1) if device.motor_mass else (0, 0)
        masses = [device.motor_mass, device.mass - device.motor_mass] if device.motor_mass else [device.mass]
        count = len(masses) + len(device.hung)
        inertia, damping, stiffness = np.zeros((3, count, count))

        def join(one: int, other: int | None, k: float, b: float) -> None:
            way = np.zeros(count)
            way[one] = 1.0
            if other is not None:
                way[other] = -1.0
            stiffness[:] += k * np.outer(way, way)
            damping[:] += b * np.outer(way, way)

        join(handle if device.brakes_handle else motor, None, 0.0, device.friction)
        join(handle, None, device.own_spring, 0.0)
        if device.motor_mass:
            join(motor, handle, device.belt, device.belt_damping)
        for at, (mass, k, b) in enumerate(device.hung, len(masses)):
            join(at, handle if at == len(masses) else at - 1, k, b)
            masses.append(mass)
        inertia = np.diag(1.0 / np.array(masses))
        lagged = int(device.lag > 0.0)
        size = 2 * count + lagged
        self.rates, self.force, self.push = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        self.rates[:count, count : 2 * count] = np.eye(count)
        self.rates[count : 2 * count, : 2 * count] = -inertia @ np.hstack([stiffness, damping])
        self.push[count + handle] = inertia[handle, handle]
        at_motor = inertia[motor, motor]
        if lagged:
            self.rates[count + motor, -1], self.rates[-1, -1], self.force[-1] = (
                at_motor,
                -1 / device.lag,
                1 / device.lag,
            )
        else:
            self.force[count + motor] = at_motor
        self.reading = np.eye(size)[handle if device.reads_handle else motor]
        self.handle = np.eye(size)[handle]


def pieces(device: Device) -> list[tuple[float, dict[int, float], dict[int, float]]]:
    """Returns the pieces of a sample period: duration, s, and the weights of the forces, by age in samples, in the
    level at its begin and in the slope, 1/s."""
    whole = math.floor(device.delay + 1e-12)
    fraction = device.delay - whole
    found = []
    for duration, newest, since in ((fraction, whole + 1, 1.0 - fraction), (1.0 - fraction, whole, 0.0)):
        if device.hold == "zoh":
            level, slope = {newest: 1.0}, dict[int, float]()
        else:
            level, slope = {newest: since, newest + 1: 1.0 - since}, {newest: 1.0 / T, newest + 1: -1.0 / T}
        found += [(duration * T, level, slope)] if duration > 1e-12 else []
    return found


def transition(device: Device) -> np.ndarray:
    """Returns the matrix of the loop from a sample to the next. The state: moving parts, forces by age from 1 on, the
    last reading."""
    plant, ages = Plant(device), math.floor(device.delay) + 3
    size = len(plant.rates)
    state = np.eye(size + ages + 1)
    force = -(device.K + device.B / T) * (plant.reading @ state[:size]) + device.B / T * state[-1]
    forces = [force, *state[size:-1]]
    moved = state[:size]
    for duration, level, slope in pieces(device):
        whole = np.zeros((size + 2, size + 2))
        whole[:size, :size], whole[:size, size], whole[size, size + 1] = plant.rates, plant.force, 1.0
        flow = expm(duration * whole)
        at, up = (sum(weight * forces[age] for age, weight in one.items()) + 0.0 * force for one in (level, slope))
        moved = flow[:size, :size] @ moved + np.outer(flow[:size, size], at) + np.outer(flow[:size, size + 1], up)
    return np.vstack([moved, forces[:ages], plant.reading @ state[:size]])


def poles(device: Device) -> np.ndarray:
    """Returns the poles by decreasing modulus, without the memories at zero."""
    found = np.linalg.eigvals(transition(device))
    found = found[np.argsort(-np.abs(found), kind="stable")]
    return found[np.abs(found) > 1e-6]


def radius(device: Device) -> float:
    """Returns the largest modulus of a pole."""
    return float(np.abs(np.linalg.eigvals(transition(device))).max())


def felt(device: Device) -> tuple[float, float]:
    """Returns k and b of the two slowest motions, on the whole mass: of an oscillation, or of two that creep."""
    s = np.log(poles(device).astype(complex)) / T
    one, other = s[np.argsort(np.abs(s), kind="stable")[:2]]
    return device.mass * (one * other).real, -device.mass * (one + other).real


def impedance(device: Device, hertz: float, points: int = 12) -> complex:
    """Returns the force of a hand that pushes the handle with a pure oscillation, over the part of the handle's
    velocity at this frequency. The motion is followed through a sample period; Gauss's rule takes its mean."""
    plant, s = Plant(device), 2j * math.pi * hertz
    size, loop = len(plant.rates), transition(device).astype(complex)
    # The push is one more state, which turns; then the motion at the samples is that of one equation.
    pushed = np.zeros((size + 1, size + 1), complex)
    pushed[:size, :size], pushed[:size, size], pushed[size, size] = plant.rates, plant.push, s
    by_push = np.zeros(len(loop), complex)
    by_push[:size] = expm(T * pushed)[:size, size]
    state = np.linalg.solve(np.exp(s * T) * np.eye(len(loop)) - loop, by_push)
    force = -(device.K + device.B / T) * (plant.reading @ state[:size]) + device.B / T * state[-1]
    forces, moved, mean, begin = [force, *state[size:-1]], state[:size], 0.0j, 0.0
    for duration, level, slope in pieces(device):
        at, up = (sum(weight * forces[age] for age, weight in one.items()) for one in (level, slope))
        whole = np.zeros((size + 3, size + 3), complex)
        whole[: size + 1, : size + 1] = pushed
        whole[:size, size + 1], whole[size + 1, size + 2] = plant.force, 1.0
        start = np.array([*moved, np.exp(s * begin), at, up])
        for node, weight in zip(*np.polynomial.legendre.leggauss(points), strict=True):
            when = 0.5 * duration * (1.0 + node)
            mean += (
                0.5
                * duration
                * weight
                / T
                * (plant.handle @ (expm(when * whole) @ start)[:size])
                * np.exp(-s * (begin + when))
            )
        moved, begin = (expm(duration * whole) @ start)[:size], begin + duration
    return complex(1.0 / (s * mean))


def largest_errors(seeds: Iterable[int], prediction_of: Callable[[Device], Any]) -> tuple[np.ndarray, int]:
    """Returns the largest errors of the spectral radius, of k (relative) and of b (relative to it, or to a twentieth of
    the critical damping) over random devices; and the number of those without a pair, each of which has a reason."""
    off, without = np.zeros(3), 0
    for seed in seeds:
        device = random_device(seed)
        prediction = prediction_of(device)
        (part,) = prediction.parts
        off[0] = max(off[0], abs(prediction.spectral_radius - radius(device)))
        if part.felt.reason:
            without += 1
            continue
        k, b = felt(device)
        least = 0.1 * math.sqrt(abs(k) * device.mass)
        errors = abs(part.felt.k[0, 0] / k - 1.0), abs(part.felt.b[0, 0] - b) / max(abs(b), least)
        off[1:] = np.maximum(off[1:], errors)
    return off, without
