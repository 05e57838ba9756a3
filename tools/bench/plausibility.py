"""Scenes with one wrong unit or one factor of a thousand: how many are warned about, and with which hint.

The scenes are those that ship and random sensible ones; of each one value is spoiled. A test draws from here, too.
"""

from __future__ import annotations

import argparse
import copy
import math
import random
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml

import hapsim
from hapsim.errors import SceneError, UsageError
from hapsim.prediction import configuration_of, predict, unlikely, warnings_about
from hapsim.scene import parse_scene

SHIPPED = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))

_MM, _MICRO, _PART = ("mm", 1e3), ("µm", 1e6), ("÷ 1000", 1e-3)
_TIMES = ("× 1000", 1e3)
_LENGTH = (_MM, _PART)
SLIPS: dict[str, tuple[tuple[str, float], ...]] = {
    "mass": (("g", 1e3), _PART),
    "friction": (("g/s", 1e3), ("N·s/mm", 1e-3)),
    "damping": (("g/s", 1e3), ("N·s/mm", 1e-3)),
    "stiffness": (_TIMES, ("N/mm", 1e-3)),
    "delay": (("seconds", math.nan), _TIMES),
    "rate": (("kHz", 1e-3), ("period in s", math.nan), _TIMES),
    "force_limit": (("mN", 1e3), _PART),
    "force": (("mN", 1e3), _PART),
    "static": (("mN", 1e3), _PART),
    "coulomb": (("mN", 1e3), _PART),
    "travel": _LENGTH,
    "position": _LENGTH,
    "distance": _LENGTH,
    "pitch": _LENGTH,
    "depth": (("mN", 1e3), _PART),
    "release": _LENGTH,
    "by": _LENGTH,
    "velocity": (("mm/s", 1e3), _PART),
    "force_over_distance": (("mm", 1e3), ("m ÷ 1000", 1e-3), ("mN", 1e3), ("N ÷ 1000", 1e-3)),
    "quantum": (_MM, _MICRO),
    "noise": (_MM, _MICRO),
    "energy_limit": (_TIMES, _PART),
    "soft_start": (("ms", 1e3), _PART),
    "turnaround": (("ms", 1e3), _PART),
    "cutoff": (("kHz", 1e-3), _TIMES),
    "baud": (("kbit/s", 1e-3), _TIMES),
}
"""Wrong units and slips, by key: the text in place of the unit, and the factor on the value."""


class Spoiled(NamedTuple):
    """A scene with one wrong value."""

    path: str
    slip: str
    right: float
    """The value before; of several, the largest."""
    text: str

    @property
    def key(self) -> str:
        """The wrong key; of those that device and scene both have, with its place."""
        place, _, key = self.path.rpartition(".")
        return f"{key} ({place.partition('.')[0]})" if key in ("mass", "stiffness", "position") else key


def spoiled_scenes(number: int, seed: int) -> Iterator[Spoiled]:
    """Yields scenes with one wrong value each, half of them from scenes that ship and half from random ones."""
    chance = random.Random(seed)
    shipped = [yaml.safe_load(path.read_text(encoding="utf-8")) for path in SHIPPED]
    for index in range(number):
        scene = copy.deepcopy(chance.choice(shipped)) if index % 2 else sensible_scene(chance)
        path, holder, key = chance.choice(list(_keys_of(scene, "")))
        slip, factor = chance.choice(SLIPS[key])
        value = holder[key]
        right = max((abs(one) for one in _flat(value)), default=0.0)
        if slip == "seconds":
            holder[key] = value / scene["rate"]
        elif slip == "period in s":
            holder[key] = 1.0 / value
        elif key == "force_over_distance":
            column = int("N" in slip)
            right = max(abs(point[column]) for point in value)
            holder[key] = [[one * factor if i == column else one for i, one in enumerate(point)] for point in value]
        else:
            holder[key] = _times(value, factor, whole=key == "baud")
        yield Spoiled(path, slip, right, yaml.safe_dump(scene, sort_keys=False, allow_unicode=True))


def _keys_of(part: dict[str, Any], path: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    """The numbers of a scene that can be spoiled, other than 0: path, the mapping that has it, and its key there."""
    for key, value in part.items():
        if isinstance(value, dict):
            yield from _keys_of(value, f"{path}{key}.")
        elif key in SLIPS and any(_flat(value)):
            yield f"{path}{key}", part, key


def _flat(value: Any) -> list[float]:
    if isinstance(value, list):
        return [one for entry in value for one in _flat(entry)]
    return [float(value)] if isinstance(value, int | float) else []


def _times(value: Any, factor: float, *, whole: bool) -> Any:
    if isinstance(value, list):
        return [_times(one, factor, whole=whole) for one in value]
    if not isinstance(value, int | float):
        return value
    return max(round(value * factor), 1) if whole else value * factor


def sensible_scene(chance: random.Random) -> dict[str, Any]:
    """A device and a scene as people build them, as a document: 5 g to 3 kg, 200 Hz to 20 kHz, up to the stability
    limit in stiffness. Every one is predicted stable."""
    while True:
        scene = _random_scene(chance)
        if predict(parse_scene(yaml.safe_dump(scene), "by chance"), with_margins=False).stable:
            return scene


def _random_scene(chance: random.Random) -> dict[str, Any]:
    def among(least: float, most: float) -> float:
        return float(f"{math.exp(chance.uniform(math.log(least), math.log(most))):.3g}")

    rate, mass, limit = round(among(200, 20000)), among(0.005, 3.0), among(0.2, 50.0)
    device = {
        "clock": "lockstep",
        "mass": mass,
        "friction": chance.choice((0.0, among(0.05, 5.0))) if mass > 0.02 else among(0.01, 0.5),
        "delay": chance.choice((0, 0.5, 1, 1.5, 2)),
        "hold": chance.choice(("zoh", "zoh", "impulse", "ramp")),
        "force_limit": limit,
    }
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    scene = {"version": 1, "rate": rate, "device": device, "mock": {}, "modules": modules}
    loop = configuration_of(hapsim.parse_scene(yaml.safe_dump(scene), "empty"), 0)
    damping = among(0.01, 0.3) * mass * rate / (1.0 + 2.0 * device["delay"])
    most = float(loop.stable_stiffness(damping)[1])
    stiffness = among(10.0, max(0.95 * most, 10.1)) if most > 10.0 else 10.0
    damping = float(f"{damping:.3g}")
    between = ["hand", "wall"]
    modules["touch"] = chance.choice(
        (
            {"type": "viscoelastic", "between": between, "stiffness": stiffness, "damping": damping},
            {"type": "buffer", "between": between, "stiffness": stiffness, "damping": damping, "distance": -0.002},
        )
    )
    _add_modules(chance, among, scene)
    reach = min(0.01, 2.0 * limit / sum(module.get("stiffness", 0.0) for module in modules.values()))
    start = among(0.1 * reach, reach)
    scene["mock"] |= {"initial": {"position": start if start > 1e-5 else 0.0, "velocity": among(0.01, 0.5)}}
    scene["mock"] |= chance.choice(({}, {"quantum": 1.7e-5}, {"quantum": 1e-6, "noise": among(1e-6, 1e-5)}))
    scene["mock"] |= chance.choice(({}, {"coulomb": among(0.005, 0.3) * limit}, {"turnaround": 2e-4}, {"baud": 115200}))
    device |= chance.choice(({}, {"stiffness": among(10, 300)}, {"soft_start": 0.05, "energy_limit": 0.02 * limit}))
    device |= chance.choice(({}, {"travel": [-0.05, 0.05], "origin": "here"}, {"travel": [0.0, among(0.05, 0.3)]}))
    return scene


def _add_modules(chance: random.Random, among: Any, scene: dict[str, Any]) -> None:
    """One thing more beside the first link, or nothing."""
    rate, limit, modules = scene["rate"], scene["device"]["force_limit"], scene["modules"]
    kind = chance.choice(("", "click", "rub", "string", "ball", "pick", "floor", "notch"))
    if kind == "click":
        at, peak = among(0.001, 0.01), among(0.1, 1.0) * limit
        curve = [[-2 * at, -peak], [-1.2 * at, -0.5 * peak], [-at, -peak], [0, 0]]
        modules["click"] = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": curve}
    elif kind == "notch":
        notch = {"pitch": among(0.001, 0.02), "depth": among(0.05, 0.5) * limit, "shape": "sine"}
        modules["notch"] = {"type": "detent", "between": ["hand", "wall"]} | notch
    elif kind == "rub":
        rub = {"force": among(0.03, 0.5) * limit, "stiffness": among(10.0, 1000.0), "damping": 0.1}
        modules["rub"] = {"type": "friction", "between": ["hand", "wall"]} | rub
    elif kind in ("string", "pick"):
        mass = among(1e-5, 1e-3)
        tight = {"stiffness": among(0.05, 0.5) * mass * rate**2, "damping": among(1e-4, 1e-2) * mass * rate}
        modules["string"] = {"type": "string", "masses": chance.randrange(8, 40), "mass": mass} | tight
        grip = {"between": ["hand", "string.3"], "stiffness": max(0.3 * tight["stiffness"], 10.0), "damping": 0.05}
        more = {"type": "viscoelastic"} if kind == "string" else {"type": "plectrum", "release": among(5e-4, 5e-3)}
        modules["grip"] = grip | more
    elif kind == "ball":
        mass = among(0.005, 0.5)
        modules["ball"] = {"type": "mass", "mass": mass, "position": 0.001}
        modules["rope"] = {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 50.0, "damping": 0.1}
    elif kind == "floor":
        modules["floor"] = {"type": "ground", "position": -among(0.01, 0.1)}
        modules["stop"] = {
            "type": "buffer",
            "between": ["hand", "floor"],
            "stiffness": among(100, 3000),
            "damping": 1.0,
        }


class Verdict(NamedTuple):
    """Result of a scene with one wrong value."""

    kind: str
    """named: a hint names the wrong key; other: a hint names another; unstable, refused; silent."""
    is_right: bool
    """True if the hint gives the original value."""
    hint: str


def judge(spoiled: Spoiled) -> Verdict:
    """Returns hapsim's result for this scene, from `check` or before arming."""
    try:
        scene = parse_scene(spoiled.text, "s.yaml")
    except SceneError as error:
        return Verdict("refused", False, str(error))
    hints = unlikely(scene)
    for hint in hints:
        if re.match(rf"{re.escape(spoiled.path)}(\[\d+\])?: ", hint) or f" {spoiled.path} " in hint:
            written = re.search(r", write (\S+)\.(?: |$)", hint)
            is_right = written is not None and math.isclose(abs(float(written[1])), spoiled.right, rel_tol=1e-3)
            return Verdict("named", is_right, hint)
    if hints:
        return Verdict("other", False, hints[0])
    try:
        warnings = warnings_about(scene, predict(scene, with_margins=False))
    except UsageError as error:
        return Verdict("refused", False, str(error))
    return Verdict("predicted", False, warnings[0]) if warnings else Verdict("silent", False, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--sensible", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hints", action="store_true", help="print the hint of each scene")
    options = parser.parse_args()
    kinds = ("named", "other", "predicted", "refused", "silent")
    rows: dict[tuple[str, str], Counter[str]] = {}
    for spoiled in spoiled_scenes(options.scenes, options.seed):
        verdict = judge(spoiled)
        rows.setdefault((spoiled.key, spoiled.slip), Counter())[verdict.kind] += 1
        rows[spoiled.key, spoiled.slip]["right"] += verdict.is_right
        if options.hints:
            print(f"{spoiled.path}, {spoiled.slip}, {spoiled.right:g}: {verdict.kind}: {verdict.hint}")
    print(f"| key | written | scenes | {' | '.join(('named', 'with the right value', *kinds[1:]))} |")
    print(f"|---|---|{'---|' * (len(kinds) + 2)}")
    rows["all", ""] = sum(rows.values(), Counter())
    for (key, slip), counted in sorted(rows.items(), key=lambda row: (row[0][0] == "all", row[0])):
        cells = (counted["named"], counted["right"], *(counted[kind] for kind in kinds[1:]))
        print(f"| {key} | {slip} | {sum(counted[kind] for kind in kinds)} | {' | '.join(map(str, cells))} |")
    chance = random.Random(options.seed)
    sensible = (parse_scene(yaml.safe_dump(sensible_scene(chance)), "s.yaml") for _ in range(options.sensible))
    warned = [hint for scene in sensible for hint in unlikely(scene)]
    shipped = [hint for path in SHIPPED for hint in unlikely(hapsim.load_scene(path))]
    print(f"\n{options.sensible} sensible scenes: {len(warned)} hints; {len(SHIPPED)} that ship: {len(shipped)}.")
    print("\n".join(warned + shipped))


if __name__ == "__main__":
    main()
