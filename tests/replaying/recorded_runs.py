"""Random scenes that run in real time on a pseudo-terminal, with faults on the wire, and are changed meanwhile."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from random_scenes import random_scenes
from wire_session import injector_of

import hapsim
from hapsim.bringup.faults.relay import Relay
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.device.ports import raw_port
from hapsim.errors import RunError, SceneError, UsageError
from hapsim.scene import Scene, parse_scene

_LOST = ("kind: drop, direction: from_device, probability: 0.02, after_samples: 20",)


def random_scene(seed: int) -> Scene:
    """A stable one, whose device is late now and then; some sense velocities, some are corrected."""
    chance = random.Random(seed)
    document: dict[str, Any] = yaml.safe_load(next(random_scenes(1, seed)))
    document["device"]["clock"] = chance.choice(("device", "host"))
    document["device"]["delay"] = 1.0
    document["mock"] = {"misses": 0.02, "noise": 1e-6, "seed": seed, "initial": {"position": 0.003, "velocity": 0.05}}
    if seed % 3 == 0:
        document["device"] |= {"correction": chance.choice(("poles", "predictor"))}
    try:
        return parse_scene(yaml.safe_dump(document), "random scene")
    except SceneError:  # a correction that this scene cannot have
        document["device"].pop("correction", None)
        return parse_scene(yaml.safe_dump(document), "random scene")


def recorded(scene: Scene, path: Path, late: Path, seed: int, seconds: float) -> Any:
    """Runs it for some seconds with random changes and markers, and positions that are lost; `late` is the record from
    about the middle on. Returns the trace."""
    chance = random.Random(seed)
    # A busy machine may have the device stop: the record is as good.
    with (
        _behind_faults(scene, seed) as lossy,
        contextlib.suppress(RunError, UsageError),
        hapsim.start(lossy, record=path) as session,
    ):
        session.mark("begun")
        for begins_late in (False, True):
            if begins_late:
                session.stop_recording()
                session.record(late)
            end = time.monotonic() + 0.5 * seconds
            while time.monotonic() < end and not session.wait(chance.uniform(0.0, 0.03)):
                if chance.random() < 0.2:
                    with contextlib.suppress(UsageError):
                        session.adopt(_other(session.scene, chance), over=chance.choice((0.0, 0.01, 0.05)))
                else:
                    _set_something(session, chance)
    return session.trace


def _set_something(session: Any, chance: random.Random) -> None:
    numbers = [one for one in session.parameters.values() if one.kind == "number" and one.part in session.scene.modules]
    if numbers:
        one = chance.choice(numbers)
        with contextlib.suppress(UsageError):
            change = {one.part: {one.key: one.value * chance.uniform(0.5, 1.2)}}
            session.set(change, over=chance.choice((0.0, 0.005, 0.05)))


def _other(scene: Scene, chance: random.Random) -> Scene:
    """Returns the scene with one link more or less."""
    document = scene.model_dump(mode="json", exclude_none=True)
    if "more" in document["modules"]:
        del document["modules"]["more"]
    else:
        between = ["hand0", "wall"]
        document["modules"]["more"] = {"type": "viscoelastic", "stiffness": chance.uniform(1, 40), "between": between}
    return parse_scene(yaml.safe_dump(document), "another")


@contextlib.contextmanager
def _behind_faults(scene: Scene, seed: int) -> Iterator[Scene]:
    with (
        serving(assemble_mock(scene)) as device,
        raw_port(device, 2_000_000) as port,
        Relay(port, injector_of(*_LOST, seed=seed)) as relay,
    ):
        thread = threading.Thread(target=relay.run)
        thread.start()
        try:
            yield scene.model_copy(update={"device": scene.device.model_copy(update={"port": relay.name})})
        finally:
            relay.stop()
            thread.join()
