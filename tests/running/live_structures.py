"""A running loop whose scene is changed, and the same worked out without a loop.

The loop runs in virtual time against the mock in memory, and comes back every 65 ticks, because its ring is small:
there the scene is changed. What happened is worked out once more without a loop, on the positions that were recorded:
both scenes by themselves, and the force between them as it is promised.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.cordis.offline import start, take_over, tick, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values
from hapsim.cordis.succession import take_over_from
from hapsim.device.connection import arm, describe, disarm
from hapsim.device.open_connection import open_connection
from hapsim.loop import endings
from hapsim.loop.compiled_loop import run_loop
from hapsim.running.assemble_loop import LoopMemory, assemble_loop
from hapsim.running.changed_scene import differs_in_live_parameters_alone
from hapsim.running.changes import LiveScene
from hapsim.scene import Scene

RATE = 1000.0
OVER = 0.02
SAMPLES = 20
Modules = dict[str, dict[str, Any]]

HANDS: Modules = {"hand": {"type": "device", "channel": 0}, "thumb": {"type": "device", "channel": 1}}
STRING: dict[str, Any] = {"type": "string", "masses": 9, "mass": 0.01, "stiffness": 400.0}


def scene_of(modules: Modules, scheme: str = "cordis", **differences: Any) -> Scene:
    device = {"mass": 0.2, "friction": 2.0, "clock": "lockstep", "force_limit": 50.0}
    mock = {"initial": {"velocity": [0.2, -0.1]}}
    document = {"version": 1, "rate": RATE, "scheme": scheme, "device": device, "mock": mock, "modules": modules}
    return Scene.model_validate(document | differences)


class Change(NamedTuple):
    """A scene that was adopted before the row of this number."""

    row: int
    scene: Scene


class Runner:
    """A loop that comes back every 65 ticks, all of them recorded."""

    def __init__(self, scene: Scene, loop: LoopMemory) -> None:
        self.loop, self.live = loop, LiveScene(scene, loop)
        self.changes = [Change(0, scene)]
        self._parts: list[np.ndarray] = []
        self.rows = 0

    def go(self) -> None:
        """65 ticks."""
        assert run_loop(self.loop.record) == endings.RING_FULL
        self._parts.append(self.loop.ring.drain())
        self.rows += self._parts[-1].size

    def adopt(self, scene: Scene, over: float = OVER) -> None:
        self.live.adopt(scene, over)
        self.changes.append(Change(self.rows, scene))

    @property
    def sample(self) -> np.ndarray:
        return np.concatenate([part["sample"] for part in self._parts])

    @property
    def position(self) -> np.ndarray:
        """(N, channels) m."""
        counts = np.concatenate([part["position_counts"] for part in self._parts])
        return counts * self.loop.record.io.position_scale[: counts.shape[1]]

    @property
    def asked(self) -> np.ndarray:
        """(N, channels) N."""
        return np.concatenate([part["asked_force"] for part in self._parts])


@contextlib.contextmanager
def running(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Iterator[Runner]:
    monkeypatch.setattr("hapsim.running.assemble_loop._RING_ROWS", 128)
    with open_connection(scene, "loopback") as connection:
        description: Description = describe(connection)
        loop = assemble_loop(scene, connection, description)
        arm(connection, description, schema.LOCKSTEP, 100)
        try:
            yield Runner(scene, loop)
        finally:
            disarm(connection, loop.wire)


class Expected(NamedTuple):
    """Worked out without a loop: forces in N, and where each is between an older scene's and a newer one's."""

    force: np.ndarray
    older: np.ndarray
    newer: np.ndarray


def work_out(runner: Runner) -> tuple[Expected, Program]:
    """The forces of a run's scenes on the positions that it recorded; and the last scene's program, at the end."""
    position = runner.position
    changes = {change.row: change.scene for change in runner.changes}
    scene = changes.pop(0)
    program, older, left = compile_scene(scene), None, 0
    start(program, position[0])
    channels = position.shape[1]
    forces = np.zeros((3, *position.shape))
    still = np.zeros(channels)
    for n, measured in enumerate(position):
        if n in changes and differs_in_live_parameters_alone(scene, changes[n]):
            scene = changes[n]
            program.parameters.post(parameter_values(scene), SAMPLES)
        elif n in changes:
            older, older_scene, scene, left = program, scene, changes[n], SAMPLES
            program = compile_scene(scene)
            take_over_from(older, older_scene, program, scene)
            take_over(older, program, measured)
            program.parameters.post(parameter_values(scene), SAMPLES)
        for one, into in ((older, forces[1, n]), (program, forces[2, n])):
            if one is not None:
                update_parameters(one)
                tick(one, measured, still, into)
        left = max(left - 1, 0)
        s = 1.0 - left / SAMPLES
        weight = s * s * (3.0 - 2.0 * s)
        forces[0, n] = forces[1, n] + weight * (forces[2, n] - forces[1, n]) if left else forces[2, n]
        if left == 0:
            older = None
            forces[1, n] = forces[2, n]
    return Expected(*forces), program


BEGIN: Modules = HANDS | {
    "wall": {"type": "ground"},
    "bob": {"type": "mass", "mass": 0.05, "velocity": 0.3},
    "rod": {"type": "viscoelastic", "between": ["hand", "bob"], "stiffness": 200.0, "damping": 0.1},
    "rest": {"type": "spring", "between": ["bob", "wall"], "stiffness": 300.0},
    "nail": {"type": "viscoelastic", "between": ["thumb", "wall"], "stiffness": 500.0, "damping": 1.0},
}


ON_ONE_LINK: Modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground", "position": 0.001}}


def swing(ticks: int) -> np.ndarray:
    """(N, 1) m: a hand that moves to and fro, and stands still for a while in between."""
    t = np.arange(ticks) / RATE
    return (0.004 * np.sin(2.0 * np.pi * 11.0 * t) * (np.abs(t - 0.06) > 0.01))[:, None]


def played(scene: Scene, positions: np.ndarray, change: Scene | None = None, at: int = 0) -> tuple[np.ndarray, Program]:
    """The forces (N, 1) in a hand at these positions; before tick `at`, another scene takes over."""
    program, still, force = compile_scene(scene), np.zeros(1), np.zeros((len(positions), 1))
    start(program, positions[0])
    for n, measured in enumerate(positions):
        if change is not None and n == at:
            older, program = program, compile_scene(change)
            take_over_from(older, scene, program, change)
            take_over(older, program, measured)
        update_parameters(program)
        tick(program, measured, still, force[n])
    return force, program


LONE: Modules = {"lone": {"type": "mass", "mass": 0.1, "velocity": 0.1}, "first": {"type": "ground", "position": 1.0}}
