"""The live parameters of a scene, which may change while it runs, with value, unit and bounds.

They are built from the scene and the declarations of its types: a new module's live fields appear by themselves.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any, Literal

import numpy as np

from hapsim.cordis.program import fixed_modules
from hapsim.errors import UsageError
from hapsim.scene import Ground, Hand, Mock, Scene
from hapsim.scene.issue import did_you_mean, quote
from hapsim.scene.modules import Module
from hapsim.scene.quantity import expectation_of
from hapsim.scene.section import Section
from hapsim.scene.sound_channels import PickUp
from hapsim.scene.varied import by_path, si_of
from hapsim.scene.words import Input, Output

Kind = Literal["number", "numbers", "word", "points"]
Value = float | str | tuple[Any, ...] | dict[str, Any]

MOCK_HAND = "mock.hand"
"""The part whose parameters are those of the hand that holds the mock."""

OUTPUTS, MOCK_INPUTS = "outputs", "mock.inputs"
"""The parts whose parameters are bits of the digital words: no values of a scene, and not saved."""

LivePart = Module | PickUp | Hand

_DECADES = 1.5  # of a logarithmic slider on either side of the value
_REACH = {"m": 0.05, "rad": 1.0, "N": 10.0, "N·m": 1.0, "N/m": 1000.0, "N·s/m": 10.0}  # of a slider around 0, by unit


@dataclass(frozen=True)
class Parameter:
    """A value that may change while the scene runs."""

    name: str
    """Module or pick-up and field, such as "touch.stiffness"."""
    kind: Kind
    """Type of the value: a number; numbers, one for each channel; a word; or points, a table's [x, y]."""
    value: Value
    unit: str
    description: str
    least: float | None = None
    """Bounds of a number; None without a bound."""
    most: float | None = None
    is_least_excluded: bool = False
    """True if the number must be above `least`."""
    words: tuple[str, ...] = ()
    """Choices of a word."""
    range: tuple[float, float] | None = None
    """Range that the scene's file gives it: what a slider shows. The value may leave it."""

    @property
    def part(self) -> str:
        """Name of its module or pick-up."""
        return self.name.rpartition(".")[0]

    @property
    def key(self) -> str:
        """Name of its field."""
        return self.name.rpartition(".")[2]

    @property
    def is_logarithmic(self) -> bool:
        """True if a slider should be logarithmic: the number is never negative, and above 0 now; over a range of the
        file, if it spans two decades."""
        if self.range is not None:
            return self.kind == "number" and 0.0 < self.range[0] <= 0.01 * self.range[1]
        return self.kind == "number" and self.least == 0.0 and isinstance(self.value, float) and self.value > 0.0

    @property
    def span(self) -> tuple[float, float]:
        """Ends of a slider: the range of the file, else around the value, within the bounds."""
        if self.range is not None:
            return self.range
        value = self.value if isinstance(self.value, float) else 0.0
        if self.is_logarithmic:
            low, high = value * 10.0**-_DECADES, value * 10.0**_DECADES
        else:
            reach = max(_REACH.get(self.unit, 1.0), 2.0 * abs(value))
            low, high = -reach, reach
        least, most = self.least, self.most
        return max(low, -math.inf if least is None else least), min(high, math.inf if most is None else most)


def parts_of(scene: Scene) -> dict[str, LivePart]:
    """Returns the parts with live parameters, by name: the modules, the pick-ups, and the hand that holds the mock. In
    the plane the coordinates of a ground, "post.x" and "post.y", stand for it."""
    grounds, modules = scene.grounds, dict[str, LivePart]()
    for name, one in scene.modules.items():
        modules |= {at: grounds[at] for at in scene.coordinates_of(name)} if isinstance(one, Ground) else {name: one}
    mocks = {mock_hand_of(name): scene.mocks.get(name) for name in scene.ports} or {MOCK_HAND: scene.mock}
    return {**modules, **scene.sound, **{name: (mock or Mock()).hand for name, mock in mocks.items()}}


def mock_hand_of(device: str) -> str:
    """Returns the part whose parameters are those of the hand that holds the mock of one of several devices."""
    return f"mocks.{device}.hand"


def words_of(scene: Scene) -> dict[str, Mapping[str, Input | Output]]:
    """Returns outputs and inputs, by the part of their parameters."""
    return {part: table for part, table in ((OUTPUTS, scene.outputs), (MOCK_INPUTS, scene.inputs)) if table}


def checked_words(scene: Scene, changes: Any) -> dict[str, dict[str, int]]:
    """Returns what `changes` has for outputs and inputs of the mock, by part and name. Raises UsageError for what these
    cannot have."""
    found: dict[str, dict[str, int]] = {}
    for part, table in words_of(scene).items() if isinstance(changes, Mapping) else ():
        if not isinstance(changes.get(part), Mapping):
            continue
        found[part] = {}
        for name, value in changes[part].items():
            one = table.get(name)
            if one is None:
                expected = f"expected one of {', '.join(table)}{did_you_mean(str(name), table)}"
                raise UsageError(f"{part}: found '{name}', {expected}")
            if isinstance(one, Output) and not one.is_set_by_programs:
                raise UsageError(
                    f"{part}.{name}: it follows {one.when or one.of}; expected an output that programs set"
                )
            most = one.most if isinstance(one, Output) else 1
            if not is_number(value) or not 0 <= value <= most or value % 1:
                raise UsageError(f"{part}.{name}: found {shown(value)}, expected a whole number from 0 to {most}")
            found[part][name] = int(value)
    return found


def modules_of(scene: Scene, parts: Mapping[str, Any]) -> dict[str, Module]:
    """Returns the modules of a scene, in the order of the file, with the values of its `parts_of`."""

    def with_values(name: str, module: Module) -> Module:
        if name in parts:
            return parts[name]
        return module.model_copy(update={"position": tuple(parts[at].position for at in scene.coordinates_of(name))})

    return {name: with_values(name, module) for name, module in scene.modules.items()}


def parameters_of(scene: Scene, has_mock: bool) -> dict[str, Parameter]:
    """Returns every live parameter of a scene, by name. `has_mock`: its device is the mock of this process."""
    fixed, found = fixed_modules(scene), {}
    for name, part in parts_of(scene).items():
        if name in fixed or (name == MOCK_HAND and not has_mock):
            continue
        values = part.model_dump(by_alias=True)
        for key in (*part.live, *part.crossfaded):
            if values.get(key) is not None:
                found[f"{name}.{key}"] = _parameter(f"{name}.{key}", type(part), key, values[key], scene)
    return found


def word_parameters(scene: Scene, values: Mapping[str, int]) -> dict[str, Parameter]:
    """Returns the parameters of digital words, by name. `values`: their present ones, by name."""

    def parameter(name: str, value: int) -> Parameter:
        """Returns the parameter of an output or an input."""
        part, _, key = name.rpartition(".")
        most = float(scene.outputs[key].most) if part == OUTPUTS else 1.0
        description = "Output that programs set" if part == OUTPUTS else "Input that the mock reads; 1: it is on"
        return Parameter(name, "number", float(value), "", description, 0.0, most, range=(0.0, most))

    return {name: parameter(name, value) for name, value in values.items()}


def python_values(value: Any) -> Any:
    """Returns a value with the numbers in it, such as numpy's, as Python's own, which records and events can hold."""
    if isinstance(value, Mapping):
        return {name: python_values(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [python_values(one) for one in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return float(value) if isinstance(value, Decimal | Fraction) else value


def is_number(value: object) -> bool:
    """Returns whether a value is a number: true and false are none, nor is a whole one too large for a float."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) <= sys.float_info.max
    return isinstance(value, float)


def shown(value: object) -> str:
    """Returns a value that was found, in a sentence."""
    return f"{value:g}" if is_number(value) else quote(value) if isinstance(value, str) else quote(repr(value))[1:-1]


def by_part(changes: Mapping[str, Any], scene: Scene) -> dict[str, Any]:
    """Returns changes that are nested, or named by path ("touch.stiffness"), as values by part and key, in SI units:
    "2 N/mm" is 2000. What belongs to no part stays as it is, for `changed` to refuse. Raises UsageError for a unit that
    does not fit."""
    parts, found = parts_of(scene), dict[str, Any]()
    known = {*parts, *words_of(scene)}
    for path, value in by_path(changes, lambda one: one not in known and one.rpartition(".")[0] in known):
        part, _, key = path.rpartition(".")
        if part and path not in known:
            field = type(parts[part]).model_fields.get(key) if part in parts else None
            expected = expectation_of(field) if field else None
            units = scene.units_at(part).si
            found.setdefault(part, {})[key] = si_of(value, path, expected.unit, units) if expected else value
        else:
            found[path] = value
    return found


def changes_from(values: Mapping[str, Any], parameters: Mapping[str, Parameter]) -> dict[str, dict[str, Any]]:
    """Returns values by full name ("touch.stiffness") in `Session.set`'s form. UsageError for an unknown name."""
    changes: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        if name not in parameters:
            raise UsageError(
                f"found '{name}', expected the name of a live parameter{did_you_mean(str(name), list(parameters))}"
            )
        parameter = parameters[name]
        changes.setdefault(parameter.part, {})[parameter.key] = value
    return changes


def _parameter(name: str, kind: type[Section], key: str, value: Any, scene: Scene) -> Parameter:
    unit, description, least, most, is_excluded, words = _declared(kind, key)
    if isinstance(value, dict) or (isinstance(value, tuple) and value and isinstance(value[0], tuple)):
        return Parameter(name, "points", value, unit, description)
    if isinstance(value, str):
        return Parameter(name, "word", value, unit, description, words=words)
    if name.startswith(MOCK_HAND) and scene.channels > 1:
        value = value if isinstance(value, tuple) else (value,) * scene.channels
    several = isinstance(value, tuple)
    part, shown = name.rpartition(".")[0], scene.units_at(name.rpartition(".")[0]).si.name(unit)
    own = Parameter(name, "numbers" if several else "number", value, shown, description, least, most, is_excluded)
    return replace(own, range=scene.ranges.get((*_place_of(part, scene), key)))


def _place_of(part: str, scene: Scene) -> tuple[str, str]:
    """Returns where the scene's file has a part: its section and its name there."""
    if part == MOCK_HAND:
        return "mock", "hand"
    return ("sound", part) if part in scene.sound else ("modules", part.partition(".")[0])


@cache
def _declared(kind: type[Section], key: str) -> tuple[str, str, float | None, float | None, bool, tuple[str, ...]]:
    """Returns unit, description, bounds and words of a field, as its type declares them."""
    field, alias = next((one, name) for name, one in kind.model_fields.items() if key in (name, one.alias))
    expectation = expectation_of(field)
    schema = kind.model_json_schema(by_alias=True)["properties"][field.alias or alias]
    numbers = [schema, *schema.get("anyOf", []), *schema.get("oneOf", [])]
    bounds = {word: one[word] for one in reversed(numbers) for word in one if word.lower().endswith("imum")}
    least = bounds.get("minimum", bounds.get("exclusiveMinimum"))
    words = tuple(str(word) for word in schema.get("enum", ()))
    unit, description = "", field.description or ""
    if expectation is not None:
        unit, description = expectation.unit.removeprefix("1").removeprefix("/(SI unit)"), expectation.description
    return unit, description, least, bounds.get("maximum"), "exclusiveMinimum" in bounds, words
