"""Random scenes with substeps, of a hand on a link, on a mass or on a string, or of two hands on a mass; and which k, b
and growth are measured. Which two poles of a ring-down to look at is all that is taken from the prediction."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

import hapsim
from hapsim.errors import DeviceError
from hapsim.scene import Scene, parse_scene

KINDS = ("link", "mass", "string", "two")
SCHEMES = ("cordis", "semi_implicit", "midpoint", "rk4", "exact")
DAMPERS: tuple[dict[str, Any], ...] = ({}, {"damper": "filtered", "cutoff": 150.0}, {"damper": "sensed"})
DELAYS = (0.0, 0.37, 1.0, 2.0)
QUANTUM, FORCE_LIMIT = 1e-11, 20.0  # m, N


def random_scene(seed: int) -> Scene:
    """The first stable one that this seed draws, in virtual time, the hand in motion."""
    draw = np.random.default_rng(seed)
    while True:
        scene = parse_scene(json.dumps(_document(draw, KINDS[seed % 4])))
        if hapsim.predict(scene, with_margins=False).stable:
            return scene


def with_factor(scene: Scene, link: str, factor: float) -> Scene:
    """The scene with this link's stiffness multiplied, in slower motion, so that its force is not limited."""
    document = json.loads(scene.model_dump_json(exclude_none=True))
    initial = document["mock"]["initial"]
    initial["velocity"] = [one / factor for one in initial["velocity"]]
    document["modules"][link]["stiffness"] *= factor
    return parse_scene(json.dumps(document))


def _document(draw: np.random.Generator, kind: str) -> dict[str, Any]:
    mass, rate = float(draw.choice([0.05, 0.1, 0.3])), float(draw.choice([1000.0, 2000.0]))
    substeps, delay = int(draw.choice([1, 2, 3, 8, int(draw.integers(1, 65)), 64])), float(draw.choice(DELAYS))
    soft = mass * rate**2 * float(draw.uniform(0.002, 0.02))
    damping = mass * rate * float(draw.uniform(0.005, 0.03))
    point = mass * float(draw.uniform(0.02, 0.3))
    most = 0.2 * point * (substeps * rate) ** 2  # a stiffness that the masses follow

    def link(first: str, second: str, stiffness: float, damping: float) -> dict[str, Any]:
        kinds = {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping}
        return kinds | DAMPERS[int(draw.integers(3 if {first, second} & {"hand", "other"} else 2))]

    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    grip = min(soft, most) * float(draw.uniform(0.3, 1.0)), damping * float(draw.uniform(0.3, 1.0))
    if kind == "link":
        modules["touch"] = link("hand", "wall", soft, damping)
    elif kind == "string":
        masses = int(draw.integers(3, 9))
        stiffness = min(2.0 * soft, most / masses) * float(draw.uniform(0.3, 1.0))
        string = {"type": "string", "masses": masses, "mass": point / masses, "stiffness": stiffness}
        modules["gut"] = string | {"damping": 0.05 * damping}
        modules["touch"] = link("hand", f"gut.{int(draw.integers(1, masses))}", grip[0] / masses, 0.1 * grip[1])
    else:
        modules["ball"] = {"type": "mass", "mass": point}
        modules["touch"] = link("hand", "ball", grip[0], grip[1])
        modules["back"] = link("ball", "wall", 0.7 * grip[0], 0.3 * grip[1])
    if kind == "two":
        modules["other"] = {"type": "device", "channel": 1}
        modules["tie"] = link("ball", "other", 0.5 * grip[0], 0.6 * grip[1])
    channels = 2 if kind == "two" else 1
    device = {
        "clock": "lockstep",
        "mass": mass,
        "friction": mass * rate * float(draw.uniform(0.001, 0.005)),
        "delay": delay,
        "hold": str(draw.choice(["zoh", "impulse", "ramp"])),
        "sampling": str(draw.choice(["ideal", "average"])),
        "decimation": str(draw.choice(["last", "mean"])),
        "force_limit": FORCE_LIMIT,
    }
    mock = {"quantum": QUANTUM, "force_quantum": 1e-8, "initial": {"velocity": [0.05, -0.02][:channels]}}
    return {
        "version": 1,
        "rate": rate,
        "substeps": substeps,
        "scheme": str(draw.choice(SCHEMES)),
        "device": device,
        "mock": mock,
        "modules": modules,
    }


def felt(scene: Scene, poles: np.ndarray) -> tuple[float, float]:
    """k and b of a pair of poles, of the first hand's mass."""
    mass = scene.device.masses(scene.channels)[0]
    s = np.log(poles.astype(complex)) * scene.rate
    return float((mass * s[0] * s[1]).real), float((-mass * (s[0] + s[1])).real)


def errors(scene: Scene) -> tuple[float, float]:
    """Returns the relative errors of the measured k and b from the predicted ones; b relative to at least a tenth of
    half the critical damping."""
    prediction = hapsim.predict(scene, with_margins=False)
    poles = np.array(prediction.poles)
    mass, (k, b) = scene.device.masses(scene.channels)[0], felt(scene, poles[:2])
    found = None if {"gut", "tie"} & set(scene.modules) else hapsim.measure(scene)
    if found is not None and max(found.k_uncertainty / abs(k), found.b_uncertainty / abs(b)) < _SURE:
        measured = found.k, found.b
    else:  # a string that hardly moves the hand is seen in its force
        trace = hapsim.run(scene, duration=_RING / scene.rate)
        signals = [one[_START:] / np.std(one[_START:], axis=0) for one in (trace.position, trace.asked_force)]
        every = _rung_poles(np.hstack(signals), poles.size)
        measured = felt(scene, np.array([every[np.argmin(np.abs(every - pole))] for pole in poles[:2]]))
    return abs(measured[0] / k - 1.0), abs(measured[1] - b) / max(abs(b), 0.1 * np.sqrt(abs(k) * mass))


_RING, _START, _ROWS = 4000, 4, 200  # samples
_SURE = 1e-6  # the relative uncertainty that `measure` states: with more, the ring-down has the word


def _rung_poles(position: np.ndarray, order: int) -> np.ndarray:
    """The poles of free motions (samples, signals), by the invariance of their span under a shift (ESPRIT)."""
    count = min(_ROWS, len(position) // 3)
    columns = len(position) - count
    rows = [position[i : i + columns].T for i in range(count)]
    triangle = np.linalg.qr(np.vstack(rows).T, mode="r")  # what the columns span, without their number
    span = np.linalg.svd(triangle.T)[0][:, :order]
    channels = position.shape[1]
    return np.asarray(np.linalg.eigvals(np.linalg.lstsq(span[:-channels], span[channels:], rcond=None)[0]))


def growth(scene: Scene) -> tuple[float, float]:
    """Returns the growth per sample of the least stable motion, measured and predicted."""
    poles = np.array(hapsim.predict(scene, with_margins=False).poles)
    predicted = float(np.log(np.abs(poles[0])))
    try:
        trace = hapsim.run(scene, duration=_RING / scene.rate, unstable=True)
    except DeviceError as error:  # it grew out of the range of its counts
        if error.trace is None:
            raise
        trace = error.trace
    limited = np.flatnonzero(np.abs(trace.asked_force).max(axis=1) > 0.5 * FORCE_LIMIT)
    position = trace.position[_START : limited[0] if limited.size else None]
    if len(position) < 6 * poles.size:  # the masses shake by themselves, from substep to substep
        force = np.abs(trace.asked_force).max(axis=1)
        return float(np.log(force[-1] / force[0])) / force.size, predicted
    every = _rung_poles(position, poles.size)
    return float(np.log(np.abs(every[np.argmin(np.abs(every - poles[0]))]))), predicted
