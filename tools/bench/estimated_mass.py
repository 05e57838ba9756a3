"""The mass that `correction: adaptive` estimates of random devices, beside what it is; whether its uncertainty holds.

    tools/bench/estimated_mass [--devices 100] [--first 0] [--only KIND ...] [--json FILE]
    tools/bench/estimated_mass --sensor 0.05 0.5 [--noise 1e-6 1e-5] [--devices 100]

Mocks in memory at 1 kHz, 0.1 to 0.4 kg, the span that is declared, on a spring and damper of 300 to 30 000 N/m, for
three seconds, pushed with 2.5 N for 8 ms every 75 ms. Each has sensor noise (none, or up to 10 µm), counts of 1 nm to
24 µm, and in turn: nothing else, a host that stalls for 10 to 50 ms, forces that are late, dry friction, a hand that
pushes slowly (up to 2 N below 5 Hz), a hand that knocks (up to 3 N for 5 to 25 ms). During a stall the device goes on,
its positions wait, and the newest is answered, as behind a port.

With --sensor the same devices have each noise of --noise, without a sensor of acceleration and with one of each of the
given noises in m/s² rms. The last row has the samples after a grip, in steps of 10, from which on the estimate is
within 5 % of the new mass: four grips on three springs, with the same pushes.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.device.mock import firmware
from hapsim.device.mock.record import MOCK
from hapsim.errors import HapsimError
from hapsim.running import Excitation, run
from hapsim.scene import Device, DevicePoint, Ground, Initial, Mock, Scene, Span, ViscoElastic

RATE, SECONDS, LEAST, MOST = 1000.0, 3.0, 0.1, 0.4
KINDS = ("alone", "stalls", "late", "dry friction", "slow hand", "knocks")
PUSHES = Excitation(0, 2.5, 8, 75, start=0, first=False)
_SAMPLES = round(RATE * SECONDS)


class Tried(NamedTuple):
    """A device: its scene, and at every sample the hand's push in N, and for how many samples the host stalls; -1: the
    position is lost."""

    kind: str
    scene: Scene
    hand: NDArray[np.float64]
    stalls: NDArray[np.int64]


def random_device(seed: int, noise: float | None = None, sensor: float | None = None) -> Tried:
    """The same for the same seed. `noise`: in its place, m rms. `sensor`: of accelerations, with this noise, m/s²."""
    random = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    mass, k = (math.exp(random.uniform(*np.log(ends))) for ends in ((LEAST, MOST), (300.0, 30_000.0)))
    b = 2.0 * random.uniform(0.05, 0.7) * math.sqrt(k * mass)
    mock: dict[str, Any] = {
        "mass": mass,
        "noise": float(random.choice([0.0, 10.0 ** random.uniform(-7.0, -5.0)])),
        "seed": seed,
        "quantum": 10.0 ** random.uniform(-9.0, math.log10(24e-6)),
        "initial": Initial(velocity=0.1),
    }
    if noise is not None:
        mock["noise"] = noise
    hand, stalls = np.zeros(2 * _SAMPLES), np.zeros(2 * _SAMPLES, np.int64)
    if kind == "stalls":
        stalls[np.cumsum(random.integers(60, 400, 40)) % _SAMPLES] = random.integers(10, 51, 40)
    elif kind == "late":
        mock["misses"] = random.uniform(0.005, 0.05)
    elif kind == "dry friction":
        mock["coulomb"] = random.uniform(0.01, 0.3)
    elif kind == "slow hand":
        hertz, newton = random.uniform(0.2, 5.0, 3), random.uniform(0.2, 2.0) * random.dirichlet(np.ones(3))
        times = np.arange(hand.size) / RATE
        hand = np.sin(2.0 * np.pi * np.outer(times, hertz) + random.uniform(0.0, 6.0, 3)) @ newton
    elif kind == "knocks":
        for begin in np.cumsum(random.integers(100, 700, 30)):
            shape = random.uniform(-3.0, 3.0) * np.sin(np.linspace(0.0, np.pi, random.integers(5, 25)))
            end = min(begin + shape.size, hand.size)
            hand[begin:end] += shape[: max(end - begin, 0)]
    return Tried(kind, scene_of(k, b, mock, sensor), hand, stalls)


def scene_of(stiffness: float, damping: float, mock: dict[str, Any], sensor: float | None) -> Scene:
    """Returns the scene of a mock."""
    own: dict[str, Any] = {"sensors": ("acceleration",)} if sensor is not None else {}
    return Scene(
        version=1,
        rate=RATE,
        device=Device(clock="lockstep", mass=Span(least=LEAST, most=MOST), friction=1.0, correction="adaptive", **own),
        mock=Mock(**mock, **({"acceleration_noise": sensor} if sensor is not None else {})),
        modules={
            "hand": DevicePoint(channel=0),
            "wall": Ground(),
            "touch": ViscoElastic(between=("hand", "wall"), stiffness=stiffness, damping=damping),
        },
    )


class Disturbed:
    """A mock in memory that a hand pushes, and whose host stalls."""

    def __init__(self, mock: Any, tried: Tried) -> None:
        self._transport, self._tried = mock, tried
        memory = (ctypes.c_char * MOCK.itemsize).from_address(int(mock.record.context))
        self._mock = np.frombuffer(memory, MOCK).view(np.recarray)[0]

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        return self._transport.receive(buffer, timeout_ns)

    def send(self, frame: bytes) -> int:
        n = int(self._mock.board.n)
        self._mock.bodies[0].push = self._tried.hand[n % self._tried.hand.size]
        code = self._transport.send(frame)
        if int(self._mock.board.n) > n:
            stall = int(self._tried.stalls[n % self._tried.stalls.size])
            if stall < 0:
                self._mock.board.out = 0
            for later in range(n + 1, n + 1 + abs(stall)):
                self._mock.bodies[0].push = self._tried.hand[later % self._tried.hand.size]
                firmware.take_sample(self._mock, 0)
        return int(code)


def estimated(
    seed: int, seconds: float = SECONDS, noise: float | None = None, sensor: float | None = None
) -> dict[str, Any]:
    """Returns the estimate for this device, and its true values. `noise`, `sensor`: of `random_device`."""
    tried = random_device(seed, noise, sensor)
    disturbed = tried.kind in ("stalls", "slow hand", "knocks")
    trace = run(
        tried.scene,
        duration=seconds,
        transport="loopback",
        excitation=PUSHES,
        between=(lambda mock: Disturbed(mock, tried)) if disturbed else None,
    )
    report, mock, touch = trace.report, tried.scene.mock_device, tried.scene.modules["touch"]
    (found,), (uncertainty,), (explained,) = (
        report.estimated_mass_kg, report.estimated_mass_uncertainty_kg, report.mass_explained
    )  # fmt: skip
    return {
        "seed": seed,
        "kind": tried.kind,
        "mass_kg": mock.mass[0],
        "estimated_kg": found,
        "uncertainty_kg": uncertainty,
        "off": (found - mock.mass[0]) / uncertainty,
        "explained": explained,
        "known": uncertainty < 0.5 * (MOST - LEAST),
        "noise_m": mock.noise,
        "quantum_m": mock.quantum[0],
        "stiffness": touch.stiffness,
        "damping": touch.damping,
        "coulomb": mock.coulomb,
        "misses": mock.misses,
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Returns the table of a page."""
    lines = ["| | devices | known | off by, median and most | stated, median | within 1, 2, 3 | at an end, wrongly |"]
    lines.append("|---|" + "---|" * 6)
    for kind in (*KINDS, "all"):
        of_kind = [row for row in rows if kind in (row["kind"], "all")]
        known = [row for row in of_kind if row["known"]]
        if not known:
            continue
        off = [abs(row["estimated_kg"] / row["mass_kg"] - 1.0) for row in known]
        stated = [row["uncertainty_kg"] / row["mass_kg"] for row in known]
        within = ", ".join(f"{np.mean([abs(row['off']) <= n for row in known]):.0%}" for n in (1, 2, 3))
        at_end = [row for row in of_kind if not 1.001 * LEAST < row["estimated_kg"] < 0.999 * MOST]
        ends = sum(abs(row["off"]) > 3.0 or not row["known"] for row in at_end)
        words = [kind, len(of_kind), len(known), f"{np.median(off):.1e}, {max(off):.1e}", f"{np.median(stated):.1e}"]
        lines.append("| " + " | ".join(map(str, [*words, within, ends])) + " |")
    return "\n".join(lines)


GRIPS = ((0.1, 0.38), (0.38, 0.1), (0.2, 0.3), (0.3, 0.2))
LINKS = ((500.0, 2.0), (2000.0, 5.0), (10_000.0, 20.0))
_GRIP_S, _STEP, _LATEST = 1.0, 10, 800  # s; samples


def samples_to_follow(
    masses: tuple[float, float], link: tuple[float, float], noise: float, sensor: float | None
) -> int:
    """Returns the samples after a grip from which on the estimate is within 5 % of the new mass."""
    mock = {"mass": masses[0], "grips": ((_GRIP_S, masses[1]),), "noise": noise, "seed": 1}
    scene = scene_of(*link, mock, sensor)
    for after in range(_LATEST, 0, -_STEP):
        report = run(scene, duration=_GRIP_S + after / RATE, transport="loopback", excitation=PUSHES).report
        if abs((report.estimated_mass_kg[0] or 0.0) / masses[1] - 1.0) > 0.05:
            return after + _STEP
    return _STEP


def sensor_table(seeds: range, noises: list[float], sensors: list[float]) -> str:
    """Returns the table with and without a sensor of acceleration."""
    cases = [(noise, sensor) for noise in noises for sensor in (None, *sensors)]
    words = [f"{noise:.0e} m" + (f", {sensor:g} m/s²" if sensor is not None else "") for noise, sensor in cases]
    columns = [[estimated(seed, SECONDS, *case) for seed in seeds] for case in cases]
    lines = ["| off by, rms; stated, median | " + " | ".join(words) + " |", "|---" * (1 + len(cases)) + "|"]
    for kind in (*KINDS, "all"):
        cells = []
        for rows in columns:
            known = [row for row in rows if kind in (row["kind"], "all") and row["known"]]
            off = math.sqrt(np.mean([(row["estimated_kg"] / row["mass_kg"] - 1.0) ** 2 for row in known]))
            cells.append(f"{off:.1e}; {np.median([row['uncertainty_kg'] / row['mass_kg'] for row in known]):.1e}")
        lines.append(f"| {kind} | " + " | ".join(cells) + " |")
    within = [f"{np.mean([abs(row['off']) <= 3.0 for row in rows]):.0%}" for rows in columns]
    grips = []
    for case in cases:
        found = [samples_to_follow(masses, link, *case) for masses in GRIPS for link in LINKS]
        most = f"{max(found)}" if max(found) <= _LATEST else f"over {_LATEST}"
        grips.append(f"{np.median(found):.0f}, {most}")
    for name, cells in (("within 3 stated", within), ("samples after a grip, median and most", grips)):
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        "tools/bench/estimated_mass", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--devices", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--only", nargs="+", choices=KINDS)
    parser.add_argument("--json", type=Path, help="keep every device")
    parser.add_argument("--sensor", nargs="+", type=float, help="noises of a sensor of acceleration, m/s² rms")
    parser.add_argument("--noise", nargs="+", type=float, default=[1e-6, 1e-5], help="of the positions with it, m rms")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.devices)
    if arguments.sensor:
        print(sensor_table(seeds, arguments.noise, arguments.sensor))
        return 0
    rows = []
    for seed in seeds:
        if arguments.only and KINDS[seed % len(KINDS)] not in arguments.only:
            continue
        try:
            rows.append(estimated(seed))
        except HapsimError as error:
            print(f"{seed}: {error}", file=sys.stderr)
            continue
        if abs(rows[-1]["off"]) > 3.0 or not rows[-1]["known"]:
            print({key: f"{one:.4g}" if isinstance(one, float) else one for key, one in rows[-1].items()})
    print(table(rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
