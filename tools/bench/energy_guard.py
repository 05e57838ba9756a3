"""The energy guard (hapsim/loop/guards/energy_guard.py) before random scenes, in virtual time.

    tools/bench/energy_guard [--scenes 200] [--seed 1] [--stalls | --wheels]

Unstable scenes, of a spectral radius of 1.002 and more: every one has to be ended, before the hand had more energy than
the limit and what it began with. Passive ones, by hands that flick at up to 2 m/s, into walls, beyond the force limit
and over coarse encoders: none may be. The hand's energy is that of the recorded motion, of which the guard knows
nothing.

With --stalls both again, before a host that stalls for 2 to 18 samples every so often, while the hand knocks with up to
60 % of the force limit: no passive one may be ended by the limit of the scene's own account. With --wheels both with
the wheels and knobs of wheels.py.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from wheels import Drawn, passive_wheels, unstable_wheels

import hapsim
from firmware_protocol import schema
from hapsim.errors import DeviceError, GuardError
from hapsim.loop.guards.energy_guard import LATE
from hapsim.loop.transport import PythonTransport
from hapsim.running import PeriodicExcitation, Session, run
from hapsim.scales import SCALES
from hapsim.scene import Scene, parse_scene
from hapsim.theory import Configuration

LEAST_RADIUS, MOST_RADIUS = 1.002, 1.5
KINDS = ("spring", "spring", "damper", "contact", "mass", "string")
EVERY, STALL = 200.0, (2, 18)  # samples from stall to stall, and of one
FORCE_BYTES = schema.frame_bytes(1, to_device=True)  # once it is armed
TOLERANCE = 1.02  # of energies that are read from positions


class Outcome(NamedTuple):
    """Result of a run."""

    drawn: Drawn
    ending: str
    why: str
    after_s: float
    account: int
    """Account of energy_guard.py that reached its limit."""
    at_limit_s: float
    """Time from the first request of the force limit to the end; 0 if there was none."""
    most_energy: float
    """J, kinetic, of the hand at any time."""
    bound: float
    """J, that it may have had."""

    @property
    def is_ended(self) -> bool:
        """True if the guard ended the run."""
        return self.ending == "scene diverging"

    @property
    def is_late(self) -> bool:
        """True if late forces ended the run."""
        return self.is_ended and self.account == LATE

    @property
    def is_within(self) -> bool:
        """True if the hand's energy stayed within its bound."""
        return self.most_energy <= TOLERANCE * self.bound


def unstable_scenes(number: int, seed: int) -> Iterator[Drawn]:
    """`number` scenes that diverge, started by a small flick."""
    chance, found = random.Random(seed), 0
    while found < number:
        drawn = _unstable(chance)
        if LEAST_RADIUS <= hapsim.predict(drawn.scene, with_margins=False).spectral_radius <= MOST_RADIUS:
            found += 1
            yield drawn


def _unstable(chance: random.Random) -> Drawn:
    rate = chance.choice((500.0, 1000.0, 1000.0, 2000.0))
    mass, kind = _log_uniform(chance, 0.05, 2.0), chance.choice(KINDS)
    stiffness = mass * rate**2 * _log_uniform(chance, 1e-3, 2.0)
    damping = mass * rate * _log_uniform(chance, 1e-4, 1.5) if kind == "damper" else chance.choice((0.0, 0.5, 3.0))
    device: dict[str, Any] = {"mass": mass, "friction": chance.choice((0.0, 1.0)) * chance.uniform(0.0, 5.0)}
    device |= {"delay": chance.choice((0.0, 1.0, 0.37)), "force_limit": chance.uniform(2.0, 20.0)}
    device |= {"hold": chance.choice(("zoh", "zoh", "impulse"))}
    link = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": stiffness, "damping": damping}
    modules: dict[str, Any] = {"touch": link}
    if kind == "contact":
        # The device's own spring presses the hand on it.
        device["stiffness"] = 0.05 * stiffness
        pressed = chance.uniform(0.05, 0.3) * device["force_limit"]
        modules = {"touch": link | {"type": "buffer", "distance": pressed / device["stiffness"]}}
    elif kind == "mass":
        modules = {
            "ball": {"type": "mass", "mass": mass * chance.uniform(0.2, 2.0)},
            "touch": link | {"between": ["hand", "ball"]},
            "held": {"type": "spring", "between": ["ball", "wall"], "stiffness": 0.1 * stiffness},
        }
    elif kind == "string":
        of_string = {"masses": 12, "mass": 0.01, "stiffness": 0.002 * rate**2, "damping": 0.01}
        modules["gut"] = {"type": "string"} | of_string
        modules["bow"] = {"type": "spring", "between": ["hand", "gut.3"], "stiffness": 0.002 * rate**2}
    speed = chance.choice((-1.0, 1.0)) * chance.uniform(0.005, 0.1)
    return Drawn(kind, _scene(rate, device, speed, 1e-9, modules), mass, speed, 60.0)


def passive_scenes(number: int, seed: int) -> Iterator[Drawn]:
    """`number` scenes that no hand makes unstable, up to the limit of that."""
    chance, found = random.Random(seed), 0
    while found < number:
        drawn = _passive(chance)
        if drawn is not None:
            found += 1
            yield drawn


def _passive(chance: random.Random) -> Drawn | None:
    rate, mass = chance.choice((500.0, 1000.0, 1000.0, 4000.0)), _log_uniform(chance, 0.05, 2.0)
    friction, delay = _log_uniform(chance, 0.1, 10.0), chance.choice((0.0, 1.0, 0.37, 2.0))
    damping = chance.choice((0.0, 0.3, 0.8)) * friction
    stiffness = (friction - damping) * rate / (0.5 + delay) * chance.choice((1.0, chance.uniform(0.1, 1.0)))
    hand = Configuration(mass=mass, rate=rate, friction=friction, delay=delay, hold="zoh", sampling="ideal")
    if not hand.is_passive(0.9999 * stiffness, damping):
        return None
    kind = chance.choice(("spring", "contact", "two walls"))
    device: dict[str, Any] = {"mass": mass, "friction": friction, "delay": delay}
    device["force_limit"] = chance.choice((1.0, 0.1)) * chance.uniform(1.0, 20.0)
    link = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 0.9999 * stiffness, "damping": damping}
    modules: dict[str, Any] = {"touch": link}
    if kind != "spring":
        modules = {"touch": link | {"type": "buffer", "distance": -0.01}}
    if kind == "two walls":
        modules["back"] = link | {"type": "buffer", "between": ["wall", "hand"], "distance": -0.01}
    elif kind == "contact":
        device["stiffness"] = _log_uniform(chance, 5.0, 500.0)
    # Of a motion that ends, cut all the way, within the travel for which a scene has credit.
    most = math.sqrt(2.0 * 0.9 * SCALES["linear"].credit * device["force_limit"] / mass)
    speed = max(min(chance.uniform(-2.0, 2.0), most), -most)
    quantum = chance.choice((1e-9, 1e-6, 1e-5, 1e-4))
    return Drawn(kind, _scene(rate, device, speed, quantum, modules), mass, speed, 4.0)


def _scene(rate: float, device: dict[str, Any], speed: float, quantum: float, modules: dict[str, Any]) -> Scene:
    document = {
        "version": 1,
        "rate": rate,
        "device": {"clock": "lockstep", **device},
        "mock": {"quantum": quantum, "initial": {"velocity": speed}},
        "modules": {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, **modules},
    }
    return parse_scene(json.dumps(document), "random scene")


def _log_uniform(chance: random.Random, least: float, most: float) -> float:
    return math.exp(chance.uniform(math.log(least), math.log(most)))


class Stalling:
    """Transport of a loop in virtual time whose host stalls. During a stall the device holds the last force, and its
    positions queue up."""

    def __init__(self, device: PythonTransport, seed: int, every: float = EVERY) -> None:
        self._device, self._chance = device, random.Random(seed)
        self._every = every
        self._last, self._buffer = b"", np.zeros(8192, np.uint8)
        self._left = self._samples()

    def _samples(self) -> int:
        return 1 + int(self._chance.expovariate(1.0 / self._every))

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Receives the waiting bytes; after a stall, all of them."""
        data = self._take(timeout_ns)
        self._left -= 1
        if data and self._left <= 0 and self._last:
            for _ in range(self._chance.randint(*STALL)):
                self._device.send(self._last)  # in lockstep a sample passes with a force, and this is the one it has
                data += self._take(timeout_ns)
            self._left = self._samples()
        buffer[: len(data)] = np.frombuffer(data, np.uint8)
        return len(data)

    def _take(self, timeout_ns: int) -> bytes:
        count = max(self._device.receive(self._buffer, timeout_ns), 0)
        return self._buffer[:count].tobytes()

    def send(self, frame: bytes) -> int:
        """Sends to the device."""
        self._last = frame if len(frame) == FORCE_BYTES else b""
        return self._device.send(frame)


def knocks(scene: Scene, duration: float, seed: int) -> PeriodicExcitation:
    """Returns the knocks of a hand: 2 to 40 ms each, several per second."""
    chance, samples = np.random.default_rng(seed), round(duration * scene.rate)
    forces, at = np.zeros(samples), 0
    while at < samples:
        length = round(chance.uniform(0.002, 0.04) * scene.rate) + 1
        forces[at : at + length] = chance.uniform(-0.6, 0.6) * scene.device.force_limit
        at += length + round(chance.exponential(0.15) * scene.rate)
    return PeriodicExcitation(0, forces)


def judged(drawn: Drawn, stalls: int | None = None) -> Outcome:
    """Runs it with the guard on. `stalls`: a seed, before a host that stalls, with a hand that knocks."""
    options: dict[str, Any] = {"duration": drawn.duration}
    if stalls is not None:
        options["excitation"] = knocks(drawn.scene, drawn.duration, stalls)
        options["between"] = lambda device: Stalling(device, stalls)
    sessions: list[Session] = []
    try:
        trace, why = run(drawn.scene, on_start=sessions.append, judges_energy=True, unstable=True, **options), ""
    except (GuardError, DeviceError) as error:
        if error.trace is None:
            raise
        trace = error.trace
        why = next((word for word in ("swung", "shook") if f"force {word} " in str(error)), "energy")
    device = drawn.scene.device
    first = min(abs(float(trace.asked_force[0, 0])), device.force_limit)
    # What a stretched link gives is known with its first force, and so is what the device's own spring does.
    compliance = 0.5 / max(sum(getattr(link, "stiffness", 0.0) for link in drawn.scene.links.values()), 1e-9)
    bound = 0.5 * drawn.mass * drawn.speed**2 + device.scales(1)[0].energy * device.force_limit
    pressed = max((getattr(link, "distance", 0.0) for link in drawn.scene.links.values()), default=0.0)
    bound += first * max(pressed - first * compliance, first * compliance)
    # What the last forces do before they end: of the sample in which it is found, and of the delay.
    steps = np.abs(np.diff(trace.position[:, 0]))
    bound += (2.0 + device.delay) * device.force_limit * float(np.max(steps, initial=0.0))
    account = int(sessions[0]._loop.record.energy_guard.account)
    reached = np.flatnonzero(np.abs(trace.asked_force[:, 0]) > device.force_limit)
    at_limit_s = (trace.asked_force.shape[0] - reached[0]) / drawn.scene.rate if reached.size else 0.0
    ending, after_s = trace.report.ending, trace.report.duration_s
    return Outcome(drawn, ending, why, after_s, account, at_limit_s, _most_energy(drawn, trace), bound)


def _most_energy(drawn: Drawn, trace: Any) -> float:
    """J: of the hand and the device's own spring, by positions one sample apart."""
    position, rate = trace.position[:, 0], drawn.scene.rate
    if position.size < 2:
        return 0.0
    speed = np.diff(position) * rate
    sprung = 0.5 * drawn.scene.device.stiffnesses(1)[0] * np.minimum(position[1:] ** 2, position[:-1] ** 2)
    quantum = float(trace.position_scale[0]) * rate
    return float(np.max(0.5 * drawn.mass * np.maximum(np.abs(speed) - quantum, 0.0) ** 2 + sprung))


def main() -> int:
    parser = argparse.ArgumentParser("tools/bench/energy_guard", description=__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stalls", action="store_true")
    parser.add_argument("--wheels", action="store_true", help="wheels and knobs in place of handles")
    parser.add_argument("--seconds", type=float, default=60.0, help="at most, each")
    arguments = parser.parse_args()
    seeds = range(arguments.scenes) if arguments.stalls else [None] * arguments.scenes
    kinds = (unstable_wheels, passive_wheels) if arguments.wheels else (unstable_scenes, passive_scenes)
    drawn = [list(scenes(arguments.scenes, arguments.seed)) for scenes in kinds]
    unstable, passive = (
        [
            judged(one._replace(duration=min(one.duration, arguments.seconds)), seed)
            for one, seed in zip(those, seeds, strict=True)
        ]
        for those in drawn
    )
    print("| unstable | scenes | ended: energy, swing, shaking | after, s: median, most | most energy over its bound |")
    print("|---|---|---|---|---|")
    for kind in sorted({one.drawn.kind for one in unstable}):
        print(_row(kind, [one for one in unstable if one.drawn.kind == kind]))
    print(_row("all", unstable))
    print("\n| passive | scenes | ended | by late forces |\n|---|---|---|---|")
    for kind in sorted({one.drawn.kind for one in passive}):
        those = [one for one in passive if one.drawn.kind == kind]
        late = sum(one.is_late for one in those)
        print(f"| {kind} | {len(those)} | {sum(one.ending != 'done' for one in those) - late} | {late} |")
    late = [one for one in unstable if one.at_limit_s > 5.0]
    print(
        f"\n{len(late)} of {len(unstable)} unstable ones went on for more than 5 s from where they reached the limit."
    )
    # A wheel in a detent swings below its force limit, which is all that the guard could end.
    ended = [one for one in unstable if one.at_limit_s > 0.0] if arguments.wheels else unstable
    wrong = [one for one in ended if not (one.is_ended and (one.is_within or arguments.stalls))]
    wrong += [one for one in passive if one.ending != "done" and not one.is_late]
    for one in wrong:
        print(
            f"WRONG: {one.ending} {one.why} after {one.after_s:.3g} s, {one.most_energy:.3g} of {one.bound:.3g} J: "
            f"{one.drawn.kind} {one.drawn.scene.model_dump_json(exclude_none=True)}",
            file=sys.stderr,
        )
    return 1 if wrong else 0


def _row(kind: str, outcomes: list[Outcome]) -> str:
    ended = [one for one in outcomes if one.is_ended]
    why = Counter(one.why for one in ended)
    after = [one.after_s for one in ended] or [math.nan]
    share = max(one.most_energy / one.bound for one in outcomes)
    return (
        f"| {kind} | {len(outcomes)} | {len(ended)}: {why['energy']}, {why['swung']}, {why['shook']} | "
        f"{float(np.median(after)):.2g}, {max(after):.2g} | {share:.2f} |"
    )


if __name__ == "__main__":
    sys.exit(main())
