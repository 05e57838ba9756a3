"""Description of a compiled scene."""

from __future__ import annotations

import json
import math

from hapsim.cordis.offline import explain
from hapsim.cordis.program import PART_TYPES
from hapsim.documents import plain
from hapsim.scene import Scene

MODULES = {
    "hand": {"type": "device", "channel": 0},
    "wall": {"type": "ground", "position": -0.01},
    "s": {"type": "string", "masses": 9, "mass": 0.001, "stiffness": 300.0},
    "bump": {"type": "buffer", "between": ["hand", "wall"], "stiffness": 1000.0},
    "touch": {"type": "spring", "between": ["hand", "s.4"], "stiffness": 10.0},
}

TABLES = "contacts, curves, detents and clicks"


def scene_of(scheme: str) -> Scene:
    keys = {"version": 1, "rate": 1000, "scheme": scheme, "device": {"mass": 0.2}}
    return Scene.model_validate({**keys, "modules": MODULES})


def test_each_kind_that_a_scene_has_is_reported_with_what_it_costs_and_the_others_by_name() -> None:
    heard: list[str] = []
    told = explain(scene_of("cordis"), heard.append)
    assert {part.name: part.modules for part in told.parts} == {"grounds": 1, "strings": 1, TABLES: 1, "springs": 1}
    assert heard == ["the whole tick", *(part.name for part in told.parts)]
    assert set(told.absent) == {kind.name for kind in PART_TYPES} - {part.name for part in told.parts}
    assert told.points == 11
    assert all(part.bytes > 0 and part.compiled_as for part in told.parts)
    assert [part.name for part in told.parts if math.isnan(part.seconds)] == ["grounds"]
    assert told.bytes > 3 * 8 * told.points
    assert 0.0 < told.seconds < told.period
    assert [part["name"] for part in json.loads(json.dumps(plain(told._asdict())))["parts"]] == heard[1:]


def test_of_another_scheme_its_own_parts_are_reported() -> None:
    told = explain(scene_of("semi_implicit"))
    assert any("semi_implicit" in part.compiled_as for part in told.parts)
    assert told.points == 11


def test_a_hand_on_a_single_link_is_reported_as_any_other_scene() -> None:
    scene = Scene.model_validate(
        {
            "version": 1,
            "rate": 1000,
            "device": {"mass": 0.2},
            "modules": {name: MODULES[name] for name in ("hand", "wall", "bump")},
        }
    )
    told = explain(scene)
    assert told.points == 2
    assert [part.name for part in told.parts] == ["grounds", TABLES]
    assert told.parts[1].seconds > 0.0
