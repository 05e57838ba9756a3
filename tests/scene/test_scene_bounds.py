"""Bounds that a value may lie on: there a scene loads, and the schema takes it; a digit further neither does."""

from collections.abc import Callable
from math import inf, nextafter
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from hapsim.scene import parse_scene, scene_schema

Number = float | int
Faults = Callable[[str], list[str]]

BELOW_0 = nextafter(0.0, -inf)
BETWEEN = {"between": ["hand", "wall"]}
MODULES: dict[str, dict[str, Any]] = {
    "viscoelastic": {**BETWEEN, "stiffness": 1.0},
    "spring": {**BETWEEN, "stiffness": 1.0},
    "damper": {**BETWEEN, "damping": 1.0},
    "buffer": {**BETWEEN, "stiffness": 1.0},
    "plectrum": {**BETWEEN, "stiffness": 1.0, "release": 1.0},
    "detent": {**BETWEEN, "pitch": 1.0, "depth": 1.0, "shape": "snap"},
    "click": {**BETWEEN, "travel": 1.0, "peak": 1.0, "drop": 1.0, "bottom": 1.0},
    "nonlinear": {**BETWEEN},
    "mass": {"mass": 1.0},
    "friction": {**BETWEEN, "force": 0.0, "stiffness": 1.0},
    "cell": {"mass": 1.0, "stiffness": 1.0},
    "proxy": {"mass": 1.0, "stiffness": 1.0, "hand": "hand"},
    "string": {"masses": 100_000, "mass": 1.0, "stiffness": 1.0},
    "membrane": {"rows": 2, "columns": 2, "mass": 1.0, "stiffness": 1.0},
}
#: (part of the scene or type of module, key, the bound, the nearest number beyond it)
INCLUSIVE: list[tuple[str, str, Number, Number]] = [
    ("device", "baud", 1, 0),
    ("device", "baud", 100_000_000, 100_000_001),
    ("device", "friction", 0.0, BELOW_0),
    ("device", "stiffness", 0.0, BELOW_0),
    ("device", "delay", 0.0, BELOW_0),
    ("device", "delay", 1000.0, nextafter(1000.0, inf)),
    ("device", "soft_start", 10.0, nextafter(10.0, inf)),
    ("mock", "friction", 0.0, BELOW_0),
    ("mock", "stiffness", 0.0, BELOW_0),
    ("mock", "delay", 0.0, BELOW_0),
    ("mock", "delay", 1000.0, nextafter(1000.0, inf)),
    ("mock", "coulomb", 0.0, BELOW_0),
    ("mock", "noise", 0.0, BELOW_0),
    ("mock", "seed", 0, -1),
    ("mock", "seed", 2**32 - 1, 2**32),
    ("hand", "channel", 0, -1),
    ("hand", "channel", 15, 16),
    *((link, "stiffness", 0.0, BELOW_0) for link in ("viscoelastic", "spring", "buffer", "plectrum")),
    *((link, "damping", 0.0, BELOW_0) for link in ("viscoelastic", "damper", "buffer", "plectrum", "friction")),
    *((link, "damping", 0.0, BELOW_0) for link in ("detent", "click")),
    ("detent", "depth", 0.0, BELOW_0),
    ("detent", "sharpness", 1.0, nextafter(1.0, 0.0)),
    ("click", "drop", 0.0, BELOW_0),
    ("friction", "force", 0.0, BELOW_0),
    ("friction", "static", 0.0, BELOW_0),
    *((one, key, 0.0, BELOW_0) for one in ("cell", "proxy", "string", "membrane") for key in ("stiffness", "damping")),
    *((structure, "friction", 0.0, BELOW_0) for structure in ("string", "membrane")),
    ("string", "bending", 0.0, BELOW_0),
    *((one, "mass", 1e-18, 0.0) for one in ("device", "mass", "cell", "proxy", "string", "membrane")),
    *(("click", key, 1e-18, 0.0) for key in ("travel", "peak", "bottom")),
    ("friction", "stiffness", 1e-18, 0.0),
    ("plectrum", "release", 1e-18, 0.0),
    ("detent", "pitch", 1e-8, 0.0),  # ten counts of the mock
    ("string", "masses", 2, 1),
    ("string", "masses", 100_000, 100_001),
    ("pluck", "at", 0, -1),
    ("pluck", "at", 99_999, 100_000),
    *(("membrane", key, 2, 1) for key in ("rows", "columns")),
    *(("membrane", key, 300, 301) for key in ("rows", "columns")),
]


def scene_with(part: str, key: str, value: Number) -> str:
    """A small good scene in which one value is this."""
    document: dict[str, Any] = {
        "version": 1,
        "rate": 1000,
        "device": {"mass": 0.2},
        "mock": {},
        "modules": {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}},
    }
    if part in ("device", "mock"):
        document[part][key] = value
    elif part == "hand":
        document["modules"]["hand"][key] = value
    elif part == "pluck":
        document["modules"]["it"] = {"type": "string", **MODULES["string"], "pluck": {key: value, "by": 0.01}}
    else:
        document["modules"]["it"] = {"type": part, **MODULES[part], key: value}
    return yaml.safe_dump(document, sort_keys=False)


@pytest.fixture(scope="module")
def takes() -> Callable[[str], bool]:
    """Returns a function that checks a text against the schema."""
    validator = Draft202012Validator(scene_schema())
    return lambda text: validator.is_valid(yaml.safe_load(text))


@pytest.mark.parametrize(("part", "key", "bound", "beyond"), INCLUSIVE)
def test_a_value_may_lie_on_its_bound_and_no_further(
    faults: Faults, takes: Callable[[str], bool], part: str, key: str, bound: Number, beyond: Number
) -> None:
    at_the_bound, too_far = scene_with(part, key, bound), scene_with(part, key, beyond)
    parse_scene(at_the_bound)
    assert takes(at_the_bound)
    (fault,) = faults(too_far)
    assert f" {key}: found " in fault
    assert not takes(too_far)


@pytest.mark.parametrize("key", ["friction", "stiffness"])
def test_so_may_every_number_of_a_list(faults: Faults, good: str, key: str) -> None:
    two = good + f"  left: {{type: device, channel: 1}}\nmock: {{{key}: [1, X]}}\n"
    parse_scene(two.replace("X", "0"))
    (fault,) = faults(two.replace("X", repr(BELOW_0)))
    assert f" {key}[1]: found -5e-324, expected a number >= 0" in fault


PLANE = """
version: 1
rate: 1000
space: 2
device: {mass: 0.2}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground}
  it: {type: shape, between: [hand, post], form: {polygon: [[0, 0], [APART, 0], [0.01, 0], [0.01, 0.02]]}, stiffness: 1}
"""
LESS, BELOW, ABOVE = nextafter(1e-18, 0.0), nextafter(1e-12, 0.0), nextafter(1e12, inf)


@pytest.mark.parametrize(
    ("part", "key", "fitting", "beyond"),
    [
        ("device", "mass", (1e-18, 1e12), (LESS, ABOVE, 5e-324, 1e308)),
        ("device", "friction", (0.0, 1e-18, 1e12), (LESS, ABOVE, 5e-324)),
        ("device", "mass", ({"from": 1e-18, "to": 1e12},), ({"from": LESS, "to": 1.0}, {"from": 1.0, "to": ABOVE})),
        ("device", "travel", ([-1e12, 5e-324],), ([-ABOVE, 0.0],)),
        ("mass", "position", (1e12, -1e12, 5e-324), (ABOVE, -ABOVE)),
        ("detent", "sharpness", (1.0, 1e12), (ABOVE,)),
        (
            "nonlinear",
            "force_over_distance",
            ([[0, -1e12], [1e-12, 1e12]],),
            ([[0, 0], [BELOW, 1]], [[0, 0], [1, ABOVE]]),
        ),
        ("proxy", "mass", (1e12,), (ABOVE,)),
    ],
)
def test_no_number_is_so_large_or_small_that_what_follows_from_it_is_infinite(
    faults: Faults, part: str, key: str, fitting: tuple[Any, ...], beyond: tuple[Any, ...]
) -> None:
    for value in fitting:
        parse_scene(scene_with(part, key, value))
    for value in beyond:
        (fault,) = faults(scene_with(part, key, value))
        assert ", at most 1e+12 in size" in fault or ", at least 1e-18" in fault or ", by 1e-12 or more" in fault


@pytest.mark.parametrize(("apart", "fits"), [(1e-12, True), (BELOW, False), (5e-324, False)])
def test_neighbouring_corners_are_apart(faults: Faults, apart: float, fits: bool) -> None:
    text = PLANE.replace("APART", repr(apart))
    if fits:
        parse_scene(text)
    else:
        (fault,) = faults(text)
        assert fault.endswith("polygon[1]: found a list, expected another place than the one before")
