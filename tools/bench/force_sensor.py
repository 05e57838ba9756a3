"""The guards of a force sensor and of commands (hapsim/loop/guards) with simulated hands, in virtual time.

    tools/bench/force_sensor [--runs 400] [--seed 1]

A hand is a mass on the handle beyond the force sensor, a spring and a damper to where it wants to be, and it moves
there and elsewhere in strokes of 0.08 to 0.8 s, with tremor; a violent one knocks, too. All of these are drawn. A wall
or nothing is behind the handle, whose servo follows exactly or with 50 Hz. The loop is that of `hapsim run`, which gets
its positions and forces one by one. A run lasts two seconds. How far and how fast the handle moves is counted from the
fault on; a run that ends rightly needs no more. The handle has a travel of 1 m to either side, where it is lost.
"""

from __future__ import annotations

import argparse
import math
import random
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import yaml

from firmware_protocol import schema
from firmware_protocol.decoder import use_format
from firmware_protocol.description import Description, Servo
from firmware_protocol.frames import frame_to_host
from hapsim.device.connection import Connection
from hapsim.loop import endings
from hapsim.loop.guards import guard_that_ended, in_words
from hapsim.loop.guards.force_sensor import BAD_FORCE
from hapsim.loop.hooks import EndedRun
from hapsim.loop.portable import _on_force_sent, _take_and_compose
from hapsim.loop.transport import descriptor_transport
from hapsim.running.assemble_loop import LoopMemory, assemble_loop
from hapsim.running.session_options import RunOptions
from hapsim.scene import Scene, parse_scene

RATE, RANGE_N, COUNT_N, COUNT_M = 1000.0, 50.0, 0.01, 1e-6
SECONDS, LOST_M = 3.0, 1.0
STROKES_S = {"usual": (0.08, 0.8), "violent": (0.08, 0.8), "steady": (0.8, 3.0)}
TREMOR_N = {"usual": 0.4, "violent": 0.4, "steady": 0.05}
BEGINS_S = 0.3  # of a fault

Sensor = Callable[[float, float], float]
"""Function of a force (N) and a time (s) that returns the shown force, N."""


def _dead_at(level: float) -> Sensor:
    return lambda force, t: force if t < BEGINS_S else level


def _keeps() -> Sensor:
    """Returns a sensor that keeps what it showed last."""
    last = [0.0]

    def shows(force: float, t: float) -> float:
        last[0] = force if t < BEGINS_S else last[0]
        return last[0]

    return shows


FAULTS: dict[str, Callable[[], Sensor]] = {
    "right": lambda: lambda force, _t: force,
    "inverted": lambda: lambda force, _t: -force,
    "keeps its count": _keeps,
    "dead at zero": lambda: _dead_at(0.0),
    "at the end of its range": lambda: _dead_at(2.0 * RANGE_N),
    "drifts by 0.5 N/s": lambda: lambda force, t: force + 0.5 * max(t - BEGINS_S, 0.0),
}


def scene_of(
    *, wall: float | None = None, servo_hz: float = 0.0, mass: float = 0.2, damping: float = 5.0, **device: Any
) -> Scene:
    """A simulated mass, and a wall of 2000 N/m at `wall` (m)."""
    own: dict[str, Any] = {"mode": "admittance", "simulated_mass": mass, "simulated_damping": damping}
    own |= {"assumed_hand": {"stiffness": 300}, "clock": "lockstep", "energy_limit": 1e9} | device
    if servo_hz:
        own["servo"] = {"bandwidth": servo_hz}
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}}
    if wall is not None:
        at = {"type": "ground", "position": wall}
        buffer = {"type": "buffer", "between": ["hand", "wall"], "stiffness": 2000, "damping": 0, "distance": 0.0}
        modules |= {"wall": at, "touch": buffer}
    return parse_scene(yaml.safe_dump({"version": 1, "rate": RATE, "device": own, "modules": modules}), "bench.yaml")


def armed(scene: Scene, **options: Any) -> LoopMemory:
    """Returns a loop for a device with a force sensor, that gets its frames from this program."""
    c = scene.channels
    one = scene.device.servos(c)[0]
    servo = Servo((10.0,) * c, (100.0,) * c, (one.bandwidth if one else 0.0,) * c, (one.damping if one else 1.0,) * c)
    description = Description(
        "bench",
        scene.rate,
        0b111,
        200,
        (COUNT_M,) * c,
        (1e-9,) * c,
        (10.0,) * c,
        hand_force_scale=(COUNT_N,) * c,
        hand_force_range=(RANGE_N,) * c,
        sensors=schema.SENSES_FORCE | schema.FOLLOWS_COMMANDS,
        servo=servo,
    )
    connection = Connection(transport=descriptor_transport(0), name="bench", close=lambda: None)
    loop = assemble_loop(scene, connection, description, RunOptions(**{"judges_sign": True} | options))
    loop.connection = connection  # type: ignore[attr-defined]
    use_format(loop.inbox.decoder, loop.wire)
    return loop


def answer(loop: LoopMemory, number: int, position: float, force: float) -> tuple[int, float]:
    """Lets the loop answer a sample with this position (m) and sensed force (N). Returns its code and command, m."""
    counts = [round(position / COUNT_M), round(max(-RANGE_N, min(force, RANGE_N)) / COUNT_N)]
    data = frame_to_host(loop.wire, schema.POSITION, number % schema.SAMPLE_MODULUS, counts)
    loop.inbox.bytes[: len(data)] = np.frombuffer(data, np.uint8)
    loop.inbox.start, loop.inbox.stop = 0, len(data)
    now = round(number * 1e9 / RATE)
    code, _ = _take_and_compose(loop.record, now)
    _on_force_sent(loop.record, now)
    return int(code), float(loop.record.io.command_counts[0]) * COUNT_M


class Handle:
    """A handle that follows commands of the delay 1 exactly, or by a servo of `hz`."""

    def __init__(self, hz: float = 0.0) -> None:
        self._w = 2.0 * math.pi * hz
        self.position, self.velocity, self._due = 0.0, 0.0, 0.0

    def move(self, command: float) -> None:
        """Moves it by a sample, in whose beginning the command was decided."""
        target, self._due, step = self._due, command, 1.0 / RATE
        if self._w:  # critically damped, exactly
            off, along = self.position - target, self.velocity + self._w * (self.position - target)
            fades = math.exp(-self._w * step)
            self.position = target + fades * (off + along * step)
            self.velocity = fades * (self.velocity - self._w * along * step)
        else:
            self.position, self.velocity = target, (target - self.position) / step


class Hand:
    """A hand that wants to be elsewhere again and again."""

    def __init__(self, seed: int, kind: str = "usual") -> None:
        draw = random.Random(seed)
        self.stiffness, self.mass = math.exp(draw.uniform(math.log(50.0), math.log(2000.0))), draw.uniform(0.01, 0.12)
        self.damping = draw.uniform(0.1, 1.0) * math.sqrt(self.stiffness * (self.mass + 0.2))
        samples = round(SECONDS * RATE) + 1
        self.home = np.zeros(samples)
        at, last = 0.1, 0.0
        while at < SECONDS:
            lasts, to = math.exp(draw.uniform(*map(math.log, STROKES_S[kind]))), draw.uniform(-0.06, 0.06)
            share = np.clip((np.arange(samples) / RATE - at) / lasts, 0.0, 1.0)
            self.home[share > 0.0] = (last + (to - last) * (10 * share**3 - 15 * share**4 + 6 * share**5))[share > 0.0]
            at, last = at + lasts + draw.uniform(0.0, 0.3), to
        tremor_hz, turn, size = draw.uniform(6.0, 12.0), draw.uniform(0.0, 6.3), draw.uniform(0.0, TREMOR_N[kind])
        self.push = size * np.sin(2.0 * math.pi * tremor_hz * np.arange(samples) / RATE + turn)
        for _ in range(6 if kind == "violent" else 0):
            begin, lasts = draw.randrange(60, samples - 30), draw.randrange(3, 20)
            self.push[begin : begin + lasts] += draw.uniform(-45.0, 45.0) * np.hanning(lasts + 2)[1:-1]
        self._noise, self._moved, self._before = draw, 0.0, 0.0

    def force(self, n: int, position: float) -> float:
        """Returns the force on the handle at a sample, N, with the noise of a sensor."""
        velocity, self._moved = (position - self._before) * RATE, self._moved
        acceleration, self._moved, self._before = (velocity - self._moved) * RATE, velocity, position
        own = self.stiffness * (self.home[n] - position) - self.damping * velocity - self.mass * acceleration
        return float(own + self.push[n] + self._noise.gauss(0.0, 0.02))


class Nobody:
    """A handle alone, of `mass` (kg), and the noise of its sensor, N rms."""

    def __init__(self, seed: int, mass: float = 0.05, noise: float = 0.02) -> None:
        self._draw, self._mass, self._rms, self._positions = random.Random(seed), mass, noise, [0.0, 0.0]

    def force(self, _n: int, position: float) -> float:
        """Returns the force on the sensor at a sample, N."""
        before, now = self._positions
        self._positions = [now, position]
        return -self._mass * (position - 2.0 * now + before) * RATE**2 + self._draw.gauss(0.0, self._rms)


class Outcome(NamedTuple):
    """The end of a run."""

    ending: str
    why: int
    """Reason of the guard of the force sensor; 0: another guard, or none."""
    seconds: float
    way: float
    """m, of the handle since the fault, or since the start."""
    speed: float
    """m/s, likewise."""
    tests: int
    sentence: str


def play(
    scene: Scene,
    hand: Any,
    sensor: Sensor = lambda force, _t: force,
    *,
    handle: Handle | None = None,
    seconds: float = SECONDS,
) -> Outcome:
    """Runs a scene in a hand, until a guard ends it or it is lost."""
    loop = armed(scene)
    one = scene.device.servos(1)[0]
    handle = handle or Handle(one.bandwidth if one else 0.0)
    begun, most, fastest, code, n = 0.0, 0.0, 0.0, endings.RECEIVED, 0
    for n in range(round(seconds * RATE)):
        shown = sensor(hand.force(n, handle.position), n / RATE)
        code, command = answer(loop, n, handle.position, shown)
        most, fastest = max(most, abs(handle.position - begun)), max(fastest, abs(handle.velocity))
        if code != endings.RECEIVED or abs(handle.position) > LOST_M:
            break
        if n == round(BEGINS_S * RATE) and sensor(1.0, 0.0) == 1.0:
            begun, most, fastest = handle.position, 0.0, 0.0
        handle.move(command)
    guard = guard_that_ended(code)
    report: Any = type("Report", (), {"ticks": n + 1})
    sentence = guard.sentence(EndedRun(loop.record, report, scene, loop.setting)) if guard else ""
    ending = "done" if code == endings.RECEIVED else in_words(code)
    why = int(loop.record.force_sensor.why) if code == BAD_FORCE else 0
    return Outcome(ending, why, n / RATE, most, fastest, int(loop.record.force_sensor.tests), sentence)


def runs(fault: str, servo_hz: float, kind: str, count: int, seed: int) -> list[Outcome]:
    """Returns the outcomes of `count` hands."""
    outcomes = []
    for number in range(count):
        wall = 0.02 if number % 2 else None
        scene = scene_of(wall=wall, servo_hz=servo_hz, damping=14.0 if servo_hz else 5.0)
        hand = Nobody(seed + number) if kind == "nobody" else Hand(seed + number, kind)
        outcomes.append(play(scene, hand, FAULTS[fault]()))
    return outcomes


def main() -> None:
    """Prints a row for each fault, servo and kind of hand."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--hands", default="usual,violent,steady,nobody")
    parser.add_argument("--servos", type=float, nargs="+", default=[0.0, 50.0], help="Hz; 0: exact")
    options = parser.parse_args()
    print("fault, servo, hand: runs ended, by what | way mm median, 95 %, most | fastest m/s | s median | tests")
    for fault in options.faults.split(","):
        for servo_hz in options.servos:
            for kind in options.hands.split(","):
                found = runs(fault, servo_hz, kind, options.runs, options.seed)
                ended = [one for one in found if one.ending != "done"]
                reasons = {(one.ending, one.why) for one in ended}
                why = {
                    f"{words} {code}": sum((one.ending, one.why) == (words, code) for one in ended)
                    for words, code in reasons
                }
                ways = np.percentile([1e3 * one.way for one in found], [50, 95, 100])
                speeds = np.percentile([one.speed for one in found], [50, 95, 100])
                print(
                    f"{fault}, {servo_hz:g} Hz, {kind}: {len(ended)}/{len(found)} {why} | "
                    f"{', '.join(f'{one:.3g}' for one in ways)} | {', '.join(f'{one:.2g}' for one in speeds)} | "
                    f"{np.median([one.seconds for one in found]):.3g} | {np.mean([one.tests for one in found]):.2g}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
