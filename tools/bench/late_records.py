"""Begins records at random moments of runs in virtual time, and replays them.

`tools/bench/late_records [--records N]`: the shipped scenes in turn, and random scenes; hands are pushed, live values
change at once or along ramps of up to a minute, links come and go along crossfades. A guard or the end of the device's
counts may end a run: its record is as good. The loop runs in Python, so that the records stay short. A line for each
record that differs from its replay, then how many were the same, and what was under way when they began.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import random
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from random_scenes import random_scenes

import hapsim
from hapsim.errors import RunError, SceneError, UsageError
from hapsim.replaying.replay import Comparison, Record, compare
from hapsim.running.session_options import PeriodicExcitation
from hapsim.scene import Scene, parse_scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
_OVER = (0.0, 0.02, 5.0, 60.0)  # s, of changes
_PUSHES = 997  # samples, of which the scene's rates are no multiple


def scenes(seed: int) -> Iterator[tuple[str, Scene]]:
    """Yields the shipped scenes and random ones in turn, each in virtual time, without end."""
    chance = random.Random(seed)
    shipped = [*CONFIGS.glob("*.yaml"), *CONFIGS.glob("boards/*.yaml")]
    while True:
        for path in chance.sample(sorted(shipped), len(shipped)):
            yield path.name, _in_virtual_time(yaml.safe_load(path.read_text("utf-8")), path)
            number, document = _random_document(chance)
            try:
                yield f"random scene {number}, corrected", _in_virtual_time(document, None, correction="predictor")
            except SceneError:  # it cannot be
                yield f"random scene {number}", _in_virtual_time(document, None)


def _random_document(chance: random.Random) -> tuple[int, dict[str, Any]]:
    """Returns a random scene of at most four channels, and its number."""
    while True:
        number = chance.randrange(1000)
        document = yaml.safe_load(next(random_scenes(1, number)))
        if sum(one["type"] == "device" for one in document["modules"].values()) <= 4:
            return number, document


def _in_virtual_time(document: dict[str, Any], path: Path | None, **more: Any) -> Scene:
    device = {key: one for key, one in document["device"].items() if key != "port"} | {"clock": "lockstep", **more}
    return parse_scene(yaml.safe_dump(document | {"device": device}), str(path or "random scene"))


def record_late(scene: Scene, path: Path, seed: int, seconds: float = 0.1) -> None:
    """Runs a scene with pushes and changes, and records it from some moment on, for some seconds."""
    chance = random.Random(seed)
    forces = np.random.default_rng(seed).normal(0.0, 0.2 * min(scene.device.force_limit, 5.0), _PUSHES)
    pushes = PeriodicExcitation(chance.randrange(scene.channels), forces)
    with (
        contextlib.suppress(RunError, UsageError),
        hapsim.start(scene, excitation=pushes, keep=False, portable=True) as session,
    ):
        while not session.state().sample:
            time.sleep(1e-3)
        for records in (False, True):
            if records:
                session.record(path)
            end = time.monotonic() + chance.uniform(0.2, 1.0) * seconds
            while time.monotonic() < end and not session.wait(chance.uniform(0.0, 0.02)):
                _change(session, chance)


def _change(session: Any, chance: random.Random) -> None:
    live = [one for one in session.parameters.values() if one.kind == "number" and one.part != "mock.hand"]
    with contextlib.suppress(UsageError):  # one that the scene cannot have
        if live and chance.random() < 0.8:
            one = chance.choice(live)
            session.set({one.part: {one.key: one.value * chance.uniform(0.5, 1.2)}}, over=chance.choice(_OVER))
        else:
            session.adopt(_other(session.scene, chance), over=chance.choice(_OVER[:3]))


def _other(scene: Scene, chance: random.Random) -> Scene:
    """Returns the scene with one spring more or less."""
    document = scene.model_dump(mode="json", exclude_none=True)
    if not document["modules"].pop("more", None):
        ends = [next(iter(scene.device_points)), next(iter(scene.grounds), "more_ground")]
        document["modules"] |= {"more": {"type": "spring", "stiffness": chance.uniform(1.0, 20.0), "between": ends}}
    return parse_scene(yaml.safe_dump(document), scene.path or "random scene")


def replayed(path: Path, sound_file: Path | None = None) -> tuple[Record, Comparison]:
    """Returns a record and its replay beside it."""
    record = Record(path)
    return record, compare(record, None, sound_file, with_curves=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--records", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    seen: collections.Counter[str] = collections.Counter()
    with tempfile.TemporaryDirectory() as directory:
        for number, (name, scene) in enumerate(scenes(options.seed)):
            if seen["records"] == options.records:
                break
            print(f"{number} {name}", end="\r", file=sys.stderr, flush=True)
            path = Path(directory) / f"{number}.trace"
            record_late(scene, path, options.seed + number)
            if not path.exists():
                seen["runs that ended before"] += 1
                continue
            record, found = replayed(path)
            state = record.run.state
            seen["records"] += 1
            seen["begun in a crossfade"] += state is not None and len(state.scenes) > 2
            seen["with changes"] += found.changes > 0
            seen["rows"] += found.ticks
            seen["bytes of state"] += 0 if state is None else len(state.blocks)
            seen["identical"] += found.difference is None
            if found.difference is not None:
                print(
                    f"{number} {name}: row {found.difference.tick} of {found.ticks}, {found.difference.what}",
                    flush=True,
                )
            path.unlink()
    print(", ".join(f"{name}: {count}" for name, count in sorted(seen.items())))


if __name__ == "__main__":
    main()
