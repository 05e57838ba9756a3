"""Random stable scenes of every module, scheme, precision, clock and number of channels."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any, get_args

import yaml

import hapsim
from hapsim.scene import WITH_CUTOFF, DamperScheme, SchemeName

_DAMPERS: tuple[dict[str, Any], ...] = tuple(
    {"damper": name} | ({"cutoff": 200.0} if name in WITH_CUTOFF else {}) for name in get_args(DamperScheme)
)
_STRING = {"type": "string", "mass": 0.01, "stiffness": 100.0, "damping": 0.01}
_MATTER: tuple[dict[str, Any], ...] = (
    {"type": "mass", "mass": 0.1},
    {"type": "cell", "mass": 0.1, "stiffness": 50.0, "damping": 0.1},
    _STRING | {"masses": 20},
    _STRING | {"masses": 12, "bending": 20.0},
    {"type": "membrane", "rows": 4, "columns": 5, "mass": 0.01, "stiffness": 50.0, "damping": 0.01},
)
_LINKS: tuple[dict[str, Any], ...] = (
    {"type": "spring", "stiffness": 50.0},
    {"type": "damper", "damping": 0.1},
    {"type": "buffer", "stiffness": 50.0, "damping": 0.1, "distance": 0.001},
    {"type": "nonlinear", "force_over_distance": [[-0.01, -1.0], [0.0, 0.0], [0.01, 1.0]]},
    {"type": "friction", "force": 0.2, "stiffness": 50.0, "damping": 0.1},
    {"type": "plectrum", "stiffness": 50.0, "damping": 0.1, "release": 0.002},
)
_POINT_IN = {"string": ".3", "membrane": ".1.2"}


def random_scenes(number: int, seed: int) -> Iterator[str]:
    """`number` scenes, as YAML."""
    chance = random.Random(seed)
    found = 0
    while found < number:
        text = yaml.safe_dump(_random_document(chance), sort_keys=False)
        if hapsim.predict(hapsim.parse_scene(text, "random scene"), with_margins=False).stable:
            found += 1
            yield text


def _random_document(chance: random.Random) -> dict[str, Any]:
    modules: dict[str, Any] = {"wall": {"type": "ground"}}
    for channel in range(chance.choice((1, 1, 2, 3, 4, 8, 16))):
        hand, point = f"hand{channel}", f"point{channel}"
        modules[hand] = {"type": "device", "channel": channel}
        matter = chance.choice(_MATTER)
        modules[point] = matter
        end = point + _POINT_IN.get(matter["type"], "")
        touch = {"type": "viscoelastic", "stiffness": 50.0, "damping": 0.1} | chance.choice(_DAMPERS)
        for number, link in enumerate((touch, *chance.sample(_LINKS, chance.randrange(3)))):
            other = "wall" if link["type"] != "viscoelastic" and chance.random() < 0.5 else end
            modules[f"link{channel}_{number}"] = link | {"between": [hand, other]}
    return {
        "version": 1,
        "rate": chance.choice((1000, 2000)),
        "scheme": chance.choice(get_args(SchemeName)),
        "precision": chance.choice(("single", "double")),
        "device": {"mass": 0.3, "friction": 1.0, "clock": chance.choice(("device", "host", "lockstep"))},
        "modules": modules,
    }
