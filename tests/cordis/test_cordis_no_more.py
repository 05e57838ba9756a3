"""A tick calls what the types of module that a scene has do, and nothing of those that it lacks; so is it compiled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.compiling import entry
from hapsim.compiling.native import array_at
from hapsim.cordis.program import PART_TYPES, Program, compile_scene
from hapsim.scene import Scene

LISTS = ("initialize", "retarget", "add_forces", "integrate")
LINK: dict[str, Any] = {"between": ["ball", "hand"]}
VALUES: dict[str, Any] = {"mass": 0.01, "stiffness": 100.0}
TABLES = "contacts, curves, detents and clicks"
TABLE = ("initialize", "retarget", "add_forces")
CURVE = [[-0.1, -1.0], [0.1, 1.0]]

#: One module of each type by the name of the type, and the lists in which it is called. A mass, which the links hold,
#: stands in every scene here.
MODULES: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "grounds": ({"type": "ground"}, ("retarget",)),
    "cells": ({"type": "cell", **VALUES}, ("add_forces",)),
    "strings": ({"type": "string", "masses": 5, **VALUES}, ("initialize", "integrate")),
    "stiff strings": ({"type": "string", "masses": 5, "bending": 9.0, **VALUES}, ("initialize", "integrate")),
    "membranes": ({"type": "membrane", "rows": 2, "columns": 3, **VALUES}, ("initialize", "integrate")),
    "visco-elastic links": ({"type": "viscoelastic", "stiffness": 9.0, **LINK}, ("add_forces",)),
    "visco-elastic links (centred damper)": (
        {"type": "viscoelastic", "stiffness": 9.0, "damper": "centred", **LINK},
        ("initialize", "add_forces"),
    ),
    "visco-elastic links (filtered damper)": (
        {"type": "viscoelastic", "stiffness": 9.0, "damper": "filtered", "cutoff": 50.0, **LINK},
        ("initialize", "add_forces"),
    ),
    "visco-elastic links (sensed damper)": (
        {"type": "viscoelastic", "stiffness": 9.0, "damper": "sensed", **LINK},
        ("add_forces",),
    ),
    "visco-elastic links with a scale": (
        {"type": "viscoelastic", "stiffness": 9.0, "between": ["hand", "other"], "gain": {"force": 0.5}},
        ("add_forces",),
    ),
    "springs": ({"type": "spring", "stiffness": 9.0, **LINK}, ("add_forces",)),
    "dampers": ({"type": "damper", "damping": 1.0, **LINK}, ("add_forces",)),
    TABLES: ({"type": "buffer", "stiffness": 9.0, **LINK}, TABLE),
    "forces over velocity": ({"type": "nonlinear", "force_over_velocity": CURVE, **LINK}, TABLE),
    "friction links": ({"type": "friction", "force": 1.0, "stiffness": 9.0, **LINK}, ("initialize", "add_forces")),
    "sine detents": ({"type": "detent", "pitch": 0.1, "depth": 1.0, **LINK}, ("add_forces",)),
    "detents that hold": ({"type": "detent", "pitch": 0.1, "depth": 1.0, "hold_until": 0.6, **LINK}, TABLE),
    "curves with two branches": (
        {
            "type": "nonlinear",
            "force_over_distance": {"press": CURVE, "release": [[-0.1, -1.5], [0.1, 0.5]], "turn": 0.1},
            **LINK,
        },
        ("initialize", "add_forces"),
    ),
    "proxies and their links": ({"type": "proxy", "hand": "hand", **VALUES}, TABLE),
    "pick-ups": ({"from": "ball", "of": "velocity"}, ("add_forces",)),
    "plectra": ({"type": "plectrum", "stiffness": 9.0, "release": 0.1, **LINK}, ("add_forces",)),
}

#: Those of the plane.
IN_PLANE: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "visco-elastic links in the plane": (MODULES["visco-elastic links"][0], ("add_forces",)),
    "springs in the plane": (MODULES["springs"][0], ("add_forces",)),
    "dampers in the plane": (MODULES["dampers"][0], ("add_forces",)),
    "contacts, curves and clicks in the plane": (MODULES[TABLES][0], TABLE),
    "plectra in the plane": (MODULES["plectra"][0], ("add_forces",)),
    "friction links in the plane": (MODULES["friction links"][0], ("initialize", "add_forces")),
    "shapes": ({"type": "shape", "form": {"disc": 0.1}, "stiffness": 9.0, **LINK}, ("initialize", "add_forces")),
    "guides": (
        {"type": "guide", "through": [[0.0, 0.0], [0.1, 0.0]], "stiffness": 9.0, **LINK},
        ("initialize", "add_forces"),
    ),
}


def scene_of(modules: Mapping[str, Any]) -> Scene:
    hands = {name: {"type": "device", "channel": i} for i, name in enumerate(("hand", "other"))}
    always = hands | {"ball": {"type": "mass", "mass": 0.1, "position": 0.01}}
    sound = {name: one for name, one in modules.items() if "of" in one}
    modules = always | {name: one for name, one in modules.items() if name not in sound}
    document = {"version": 1, "rate": 1000, "device": {"mass": 0.2}, "modules": modules, "sound": sound}
    return Scene.model_validate(document)


def with_types(names: Sequence[str]) -> Scene:
    return scene_of({f"m{i}": MODULES[name][0] for i, name in enumerate(names)})


def in_plane(names: Sequence[str]) -> Scene:
    points = {"hand": {"type": "device", "channels": [0, 1]}, "ball": {"type": "mass", "mass": 0.1}}
    modules = points | {f"m{i}": IN_PLANE[name][0] for i, name in enumerate(names)}
    return Scene.model_validate({"version": 1, "rate": 1000, "space": 2, "device": {"mass": 0.2}, "modules": modules})


_words_at = array_at(np.uint64)


@entry
def copy_pairs(calls, pairs):
    words = _words_at(calls.pairs, 2 * calls.count)
    for i in range(2 * calls.count):
        pairs[i] = words[i]


def calls_in(program: Program) -> dict[str, NDArray[np.uint64]]:
    """Returns a tick's calls by list: (calls, 2), addresses of actions and of their numbers."""
    found = {}
    for name in LISTS:
        calls = program.record[name]
        pairs = np.zeros(2 * int(calls.count), np.uint64)
        copy_pairs(calls, pairs)
        found[name] = pairs.reshape(-1, 2)
    return found


def test_every_type_of_module_is_here() -> None:
    assert {"masses", *MODULES, *IN_PLANE} == {kind.name for kind in PART_TYPES}


@pytest.mark.thorough(keep=9)
@pytest.mark.parametrize("name", [*MODULES, *IN_PLANE])
def test_a_type_of_module_adds_its_own_calls_and_no_other(name: str) -> None:
    make = with_types if name in MODULES else in_plane
    without, having = (calls_in(compile_scene(make(names))) for names in ([], [name]))
    assert {each: len(calls) for each, calls in without.items()} == dict.fromkeys(LISTS, 0) | {"integrate": 1}
    for each in LISTS:
        more = Counter(having[each][:, 0].tolist()) - Counter(without[each][:, 0].tolist())
        assert more.total() == (each in (MODULES | IN_PLANE)[name][1]), each
        # What a mass does stays the very same code.
        assert set(without[each][:, 0].tolist()) <= set(having[each][:, 0].tolist())


def test_modules_of_one_type_are_one_call_however_many_there_are() -> None:
    one, many = (calls_in(compile_scene(with_types(["springs"] * count))) for count in (1, 20))
    assert {each: calls[:, 0].tolist() for each, calls in one.items()} == {
        each: calls[:, 0].tolist() for each, calls in many.items()
    }


def test_a_scene_of_every_type_has_the_calls_of_all_and_each_with_numbers_of_its_own() -> None:
    program = compile_scene(with_types(list(MODULES)))
    for each, calls in calls_in(program).items():
        expected = sum(each in lists for _, lists in MODULES.values()) + (each == "integrate")
        # Dampers and visco-elastic links are one function; so are the borders of both kinds of string, and what curves
        # over distance and over velocity work out.
        shared = {"add_forces": 1, "initialize": 2, "retarget": 1}.get(each, 0)
        assert len(calls) == expected == len(set(calls[:, 0].tolist())) + shared == len(set(calls[:, 1].tolist()))
    assert len(program.parts) == len(PART_TYPES) - len(IN_PLANE)


COMPILED = """
import json, sys
from hapsim.compiling.progress import on_compilation
from hapsim.cordis.program import compile_scene
from hapsim.scene import Scene

for document in json.loads(sys.argv[1]):
    told = []
    with on_compilation(told.append):
        compile_scene(Scene.model_validate(document))
    print(json.dumps(sorted(name for name in told if "." in name)))
"""


@pytest.mark.thorough
def test_what_is_compiled_for_a_scene_is_what_its_types_do_and_once(tmp_path: Path) -> None:
    """A process that begins with nothing kept; each scene finds what the ones before it had compiled."""
    scenes = [with_types(names) for names in ([], ["grounds", "springs"], ["springs"] * 3, [TABLES, "springs"])]
    documents = json.dumps([scene.model_dump() for scene in scenes])
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", COMPILED, documents]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    told = [json.loads(line) for line in done.stdout.splitlines()]
    ground_and_spring = ["linear_links.add_spring_forces", "points.retarget"]
    assert told == [
        ["points.integrate"],
        ground_and_spring,
        [],
        ["table_links.add_table_forces", "table_links.retarget"],
    ]
