"""Random changes of live parameters, and their verdicts: as hapsim remembers them, and from nothing."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hapsim.prediction import memory, surely_shaken_by
from hapsim.prediction.predict import _wherever, is_soon_stable
from hapsim.running.changed_scene import changed
from hapsim.running.live_parameters import changes_from, parameters_of
from hapsim.scene import Scene, parse_scene
from hapsim.scene.shipped import shipped_scene, shipped_scenes
from hapsim.theory.network import LARGE
from tests.verdict_scenes import as_scene, verdict_scene

LARGE_ONES = ("bowed_string", "struck_membrane", "two_devices")
"""Scenes of hundreds of states: from nothing each verdict takes tens of milliseconds, in one state of its contacts. And
one of several devices, whose clocks have many phases."""
_HARD = ("brakes", "toggles")  # of tests/verdict_scenes.py
_HEAD = {"version": 1, "rate": 1000, "space": 2, "device": {"mass": 0.2, "friction": 1.0, "force_limit": 10.0}}


def random_maze(chance: random.Random) -> Scene:
    """Returns a scene of 3 to 6 walls that meet and overlap, half of them with a mass beside the hand."""
    shape = {"type": "shape", "between": ["hand", "board"], "damping": 4.0}
    room = shape | {"form": {"box": [0.08, 0.08]}, "side": "inside", "stiffness": 1200.0}
    modules: dict[str, Any] = {
        "hand": {"type": "device", "channels": [0, 1]},
        "board": {"type": "ground"},
        "room": room,
    }
    for number in range(chance.randint(2, 5)):
        ends = [[round(chance.uniform(-0.03, 0.03), 3) for _ in "xy"] for _ in "ab"]
        form = {"capsule": ends, "radius": 0.002} if ends[0] != ends[1] else {"disc": 0.004}
        rubs = {"friction_coefficient": chance.choice([0.0, 0.3])}
        modules[f"w{number}"] = shape | {"form": form, "stiffness": chance.uniform(200.0, 1200.0)} | rubs
    if chance.random() < 0.5:
        modules["ball"] = {"type": "mass", "mass": 0.05, "position": [0.035, 0.035]}
        modules["rod"] = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 20.0, "damping": 0.2}
    return parse_scene(json.dumps(_HEAD | {"modules": modules}))


def row_of_walls(values: Mapping[str, Mapping[str, float]]) -> Scene:
    """Returns discs of 4 mm in a row, 20 mm apart, with these values."""
    modules: dict[str, Any] = {"hand": {"type": "device", "channels": [0, 1]}, "board": {"type": "ground"}}
    for number, (name, own) in enumerate(values.items()):
        at = 0.02 * number
        form = {"capsule": [[at, 0.02], [at, 0.03]], "radius": 0.004}
        modules[name] = {"type": "shape", "between": ["hand", "board"], "form": form, "damping": 4.0, **own}
    return parse_scene(json.dumps(_HEAD | {"modules": modules}))


def cell_and_string(stiffness: float) -> Scene:
    """Returns a hand that moves a cell by a rod of this stiffness, N/m, beside a string that nothing touches."""
    modules = {
        "hand": {"type": "device", "channel": 0},
        "bell": {"type": "cell", "mass": 0.05, "stiffness": 100.0, "damping": 0.1},
        "rod": {"type": "viscoelastic", "between": ["hand", "bell"], "stiffness": stiffness, "damping": 0.5},
        "gut": {"type": "string", "masses": 30, "mass": 0.001, "stiffness": 500.0, "damping": 0.01},
    }
    device = {"mass": 0.2, "friction": 1.0}
    return parse_scene(json.dumps({"version": 1, "rate": 1000, "device": device, "modules": modules}))


def random_scene(seed: int) -> Scene:
    """Returns a scene that ships, a maze, or one of the kinds that are hard to judge."""
    chance, kind = random.Random(seed), seed % (len(_HARD) + 6)
    if kind < len(_HARD):
        return as_scene(verdict_scene(_HARD[kind], seed))
    if kind < len(_HARD) + 3:
        name = chance.choice([name for name in shipped_scenes() if name not in LARGE_ONES])
        return parse_scene(shipped_scene(name), name)
    return random_maze(chance)


def random_changes(scene: Scene, chance: random.Random, count: int) -> Iterator[Scene]:
    """Yields scenes, each with one live parameter or two changed since the one before, by little or by a lot."""
    for _ in range(count):
        parameters = {name: one for name, one in parameters_of(scene, has_mock=False).items() if one.kind == "number"}
        if not parameters:
            return
        values: dict[str, float] = {}
        for name in chance.sample(sorted(parameters), min(len(parameters), chance.choice([1, 1, 2]))):
            value, (low, high) = parameters[name].value, parameters[name].span
            assert isinstance(value, float)
            times = chance.choice([1.0 + 0.1 * chance.random(), 10.0 ** chance.uniform(-1.0, 1.5)])
            is_place = name.endswith("position")
            values[name] = chance.uniform(0.1 * low, 0.1 * high) if is_place or not value else value * times
        scene = changed(scene, changes_from(values, parameters))
        yield scene


def verdict_on(scene: Scene) -> Sequence[Any]:
    """Returns what a change and an arming say of a scene: words and numbers."""
    soon, shaking, judge = is_soon_stable(scene, LARGE), surely_shaken_by(scene), _wherever(scene).judge
    states = judge.states.words, judge.states.unjudged, judge.states._verdicts[0]  # in the plane all unlike places
    return soon, shaking, shaking and shaking.sentence(scene.units), judge.is_stable, *states


def forget() -> None:
    """Makes the next verdict one from nothing."""
    memory.VERDICTS.clear()
    _wherever.cache_clear()


def unlike_verdicts(seed: int, count: int) -> tuple[int, int, list[str]]:
    """Makes changes of a scene; returns the number of verdicts, how many of these refuse it, and for each that is
    another one from nothing a sentence."""
    chance, scene, unlike, refused, made = random.Random(seed), random_scene(seed), [], 0, 0
    forget()
    remembered = [(one, verdict_on(one)) for one in (scene, *random_changes(scene, chance, count))]
    for one, verdict in remembered:
        forget()
        made, refused = made + 1, refused + (verdict[1] is not None)
        if repr(anew := verdict_on(one)) != repr(verdict):
            unlike.append(f"scene {seed}, verdict {made}: {verdict} is remembered, {anew} is found")
    return made, refused, unlike
