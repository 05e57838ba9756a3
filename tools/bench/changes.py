"""Energy that changes of a running scene give a hand (hapsim/cordis/stored_energy.py), in virtual time.

    tools/bench/changes [--drags 10000] [--seconds 25]

The first case is a stiffness modulated at twice the eigenfrequency, K = 400 (1 + depth sin 2wt), on a device with twice
the declared friction: the energy given to its hand. The second is a cell without links. In the others a hand knocks
while sliders of passive scenes are dragged at random, or a scene is adopted again and again: no run may be stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from energy_guard import knocks, passive_scenes
from numpy.typing import NDArray

from hapsim.errors import GuardError, UsageError
from hapsim.loop.transport import PythonTransport
from hapsim.running import Session, run
from hapsim.scene import Scene, parse_scene

K, MASS = 400.0, 0.2
ADOPTED_EVERY = 100  # drags


class Ticking:
    """Transport of a loop in virtual time that acts before each sample."""

    def __init__(self, device: PythonTransport, act: Callable[[int], None]) -> None:
        self._device, self._act, self._sample = device, act, 0

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Receives from the device; acts before each sample."""
        count = self._device.receive(buffer, timeout_ns)
        if count > 0:
            self._act(self._sample)
            self._sample += 1
        return count

    def send(self, frame: bytes) -> int:
        """Sends to the device."""
        return self._device.send(frame)


class Outcome(NamedTuple):
    """Result of a run."""

    ending: str
    why: str
    position: NDArray[np.float64]
    """m"""
    asked: NDArray[np.float64]
    """N"""
    spent: float
    """J, that changes added."""
    slowed: int
    """Samples in which one was slowed."""


def changed_while_it_runs(
    scene: Scene, duration: float, act: Callable[[Session, int], None], **options: Any
) -> Outcome:
    """Runs it with the energy guard; `act`: called before each sample, with the session and the sample."""
    sessions: list[Session] = []

    def tick(sample: int) -> None:
        if sessions and not sessions[0]._over.is_set():
            act(sessions[0], sample)

    options = {"judges_energy": True, "duration": duration, "on_start": sessions.append} | options
    try:
        trace, why = run(scene, between=lambda device: Ticking(device, tick), **options), ""
    except GuardError as error:
        trace, why = error.trace, str(error)
    if trace is None:
        raise RuntimeError(why)
    tank = sessions[0]._loop.record.tank
    asked = trace.asked_force[:, 0]
    return Outcome(trace.report.ending, why, trace.position[:, 0], asked, float(tank.spent), int(tank.slowed_ticks))


def spring(stiffness: float = K, friction: float = 1.0, velocity: float = 0.1, **modules: Any) -> Scene:
    """A hand on a spring, before a device with this friction that declares 1 N·s/m."""
    document = {
        "version": 1,
        "rate": 1000,
        "device": {"mass": MASS, "friction": 1.0, "clock": "lockstep", "delay": 1},
        "mock": {"friction": friction, "initial": {"velocity": velocity}},
        "modules": {
            "hand": {"type": "device", "channel": 0},
            "wall": {"type": "ground"},
            "touch": {"type": "spring", "between": ["hand", "wall"], "stiffness": stiffness},
            **modules,
        },
    }
    return parse_scene(json.dumps(document))


def pumped(depth: float, seconds: float, every: int = 10) -> tuple[Outcome, float]:
    """K modulated at twice the eigenfrequency, by a set every so many samples: (what came of it, J given)."""
    omega, friction = np.sqrt(K / MASS), 2.0

    def act(session: Session, sample: int) -> None:
        if sample % every == 0:
            stiffness = K * (1.0 + depth * np.sin(2.0 * omega * sample * 1e-3))
            session.set({"touch": {"stiffness": float(stiffness)}}, over=every * 1e-3)

    outcome = changed_while_it_runs(spring(friction=friction), seconds, act)
    speed = np.diff(outcome.position) * 1e3
    return outcome, float(np.sum(friction * speed * speed) * 1e-3 + 0.5 * MASS * (speed[-1] ** 2 - speed[0] ** 2))


def dragged(scene: Scene, drags: int, seed: int, adopts: bool = False) -> Outcome:
    """Stiffness, damping, distance and the wall's position set at random, within what is passive; or adopted, with
    another module that comes and goes."""
    chance, every = random.Random(seed), 20
    modules, stiffness = scene.modules, max(getattr(link, "stiffness", 0.0) for link in scene.links.values())

    def act(session: Session, sample: int) -> None:
        if sample % every:
            return
        changes: dict[str, dict[str, float]] = {"wall": {"position": chance.uniform(-0.02, 0.02)}}
        share = chance.uniform(0.0, 0.5 if adopts else 1.0)  # of a stiffness that is just passive
        for name, link in scene.links.items():
            changes[name] = {key: share * getattr(link, key) for key in ("stiffness", "damping") if key in link.live}
            if "distance" in link.live:
                changes[name]["distance"] = chance.uniform(-0.02, 0.0)
        over = chance.choice((0.0, 0.01, 0.05, 0.3))
        if not adopts:
            session.set(changes, over)
        elif not session._loop.is_replacing:
            link = {"type": "spring", "between": ["hand", "ball"], "stiffness": chance.uniform(0.0, 0.5) * stiffness}
            ball: dict[str, Any] = {"type": "mass", "mass": 1.0, "position": chance.uniform(-0.05, 0.05)}
            extra = {"ball": ball, "tied": link} if "ball" not in session.scene.modules else {}
            document = scene.model_dump(mode="json", exclude_none=True)
            document["modules"] = {name: modules[name].model_dump(exclude_none=True) for name in modules} | extra
            for name, values in changes.items():
                document["modules"][name] |= values
            with contextlib.suppress(UsageError):  # of one that is predicted unstable
                session.adopt(parse_scene(json.dumps(document)), over)

    duration = drags * every / scene.rate
    return changed_while_it_runs(scene, duration, act, excitation=knocks(scene, duration, seed))


def main() -> int:
    parser = argparse.ArgumentParser("tools/bench/changes", description=__doc__)
    parser.add_argument("--drags", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=25.0)
    arguments = parser.parse_args()
    print(
        "| depth | J given to the hand | J added by changes | samples slowed | largest swing, mm |\n"
        "|---|---|---|---|---|"
    )
    for depth in (0.2, 0.35, 0.5, 0.65):
        outcome, given = pumped(depth, arguments.seconds)
        peak = 1e3 * np.abs(outcome.position).max()
        print(f"| {depth} | {given:.3g} | {outcome.spent:.3g} | {outcome.slowed} | {peak:.3g} |", flush=True)
    wrong = []
    for adopts in (False, True):
        each = 100 if adopts else 250
        number = arguments.drags // each // (10 if adopts else 1)
        found = [dragged(drawn.scene, each, n, adopts) for n, drawn in enumerate(passive_scenes(number, seed=5))]
        stopped = [one for one in found if one.ending != "done"]
        slowed = sum(one.slowed > 0 for one in found)
        print(
            f"{number} passive scenes, {each} {'adoptions' if adopts else 'drags'} each: "
            f"{len(stopped)} stopped, {slowed} slowed"
        )
        wrong += stopped
    for one in wrong:
        print(f"WRONG: {one.why}", file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
