"""A scene with other values, which are named by path as in sweeps: `touch.stiffness`, `device.delay`, `rate`."""

from __future__ import annotations

import copy
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from typing import Annotated, Any, get_args

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from hapsim.errors import UsageError
from hapsim.units import Units

from .device import Device
from .issue import did_you_mean, one_of, quote
from .load import scene_from_document
from .mock import Mock
from .quantity import expectation_of
from .scene import Scene
from .schemas import UNEXPECTED
from .written_units import QUANTITY, UnitError, has_dimension, in_si

Value = float | str

_MOST_MEANT = 3  # names that a suggestion has
_FIXED = (".type", ".between")
_TOP = ("rate", "substeps", "scheme", "precision")


class Varied:
    """A scene whose values can be changed by path: `touch.stiffness`, `device.delay`, `mock.hand.force`, `rate`. Values
    are as in the scene's file, in SI units."""

    def __init__(self, scene: Scene, without: Container[str] = ()) -> None:
        """`without`: paths that are not to be changed."""
        self._scene = scene
        self._document = scene.document
        self.name = scene.path or "the scene"
        self._fields = {path: one for path, one in _fields_of(scene).items() if path not in without}
        self.known = sorted(self._fields)
        """All paths, sorted."""

    @property
    def document(self) -> dict[str, Any]:
        """Returns the scene unchanged."""
        return copy.deepcopy(self._document)

    def require(self, paths: Iterable[str]) -> None:
        """Raises UsageError for a path that the scene does not have."""
        for path in paths:
            if path.endswith(_FIXED) and path.rpartition(".")[0] in {**self._scene.modules, **self._scene.sound}:
                raise UsageError(
                    f"found '{path}', expected a value: a module of another type, or between other ends, is "
                    "another scene, so change the file"
                )
            if path not in self.known:
                of_links = (
                    one
                    for one in self.known
                    if not _is_of_device(one) and one.partition(".")[0] not in self._scene.ports
                )
                example = next((one for one in of_links if one.endswith(".stiffness")), "rate")
                expected = f"expected a parameter of {self.name}, such as {example}"
                raise UsageError(f"found '{path}', {expected}{self._suggestion(path)}")

    def in_si(self, path: str, value: Any) -> Any:
        """Returns a quantity such as "2 N/mm" as a number, and any other value as it is. Raises UsageError for a unit
        that does not fit."""
        return si_of(value, path, self._linear_unit(path), self._units(path))

    def unit(self, path: str) -> str:
        """Returns the unit of a parameter; "" where it has none."""
        unit = self._linear_unit(path)
        return self._units(path).name(unit) if unit != "1" else ""

    def _linear_unit(self, path: str) -> str:
        expected = expectation_of(self._fields[path])
        return expected.unit if expected else ""

    def _units(self, path: str) -> Units:
        name = path.rpartition(".")[0]
        return (self._scene.units_at(name) if name in self._scene.modules else self._scene.units).si

    def expected(self, path: str, value: Value) -> str:
        """Returns what a parameter takes where it does not take this value; else ""."""
        field = self._fields[path]
        try:
            adapter: TypeAdapter[Any] = TypeAdapter(Annotated[field.annotation, path, *field.metadata])  # type: ignore[arg-type]
            adapter.validate_python(value)
        except ValidationError as error:
            fault = error.errors(include_url=False)[0]
            if fault["type"] == UNEXPECTED:
                return self._units(path).filled(fault["ctx"]["of_motion"])
            return str(fault.get("ctx", {}).get("expected", ""))
        return ""

    def _suggestion(self, path: str) -> str:
        """Returns the end of a sentence: the whole names of which `path` is the last part, or the nearest name."""
        whole = sorted((one for one in self.known if one.endswith(f".{path}")), key=_is_of_device)
        meant = [one for one in whole if not _is_of_device(one)] or whole
        if not meant:
            return did_you_mean(path, self.known)
        return f"; did you mean {one_of(map(quote, meant[:_MOST_MEANT]))}?"

    def scene(self, values: Mapping[str, Any]) -> Scene:
        """Returns the scene with these values, without its `path`; None stands for what a file leaves out. Raises
        SceneError if they are not valid."""
        document = self.document
        for path, value in values.items():
            part = document
            *above, key = self._keys(path)
            for one in above:
                part = part.setdefault(one, {})
            if value is None:
                part.pop(key, None)
            else:
                part[key] = as_written(value)
        return scene_from_document(document, self._scene)

    def _keys(self, path: str) -> list[str]:
        if _is_of_device(path) or path in _TOP:
            return path.split(".")
        if (device := path.partition(".")[0]) in self._scene.ports:
            return ["devices", device, *path.split(".")[1:]]
        name, _, key = path.rpartition(".")  # a part's name may have a point in it
        return ["modules" if name in self._document["modules"] else "sound", name, key]


def changed_scene(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Returns the scene with these changes, as `Scene.changed` does."""
    if not isinstance(changes, Mapping):
        raise UsageError(f'found {changes!r}, expected paths and values, such as {{"touch.stiffness": "2 N/mm"}}')
    varied, values = Varied(scene), dict[str, Any]()
    for path, value in by_path(changes, varied.known.__contains__):
        if path in values:
            raise UsageError(f"{path}: found it twice, expected each value once")
        if value != {} or not any(one.startswith(f"{path}.") for one in varied.known):  # else no change of a part
            values[path] = value
    varied.require(values)
    return varied.scene(values)


def by_path(changes: Mapping[str, Any], is_value: Callable[[str], bool], above: str = "") -> Iterator[tuple[str, Any]]:
    """Yields path and value of each change; these may be nested, or named by path. `is_value`: whether a path names a
    value, which may be a mapping."""
    for name, value in changes.items():
        path = f"{above}{name}"
        if isinstance(value, Mapping) and value and not is_value(path):
            yield from by_path(value, is_value, f"{path}.")
        else:
            yield path, value


def si_of(value: Any, path: str, unit: str, units: Units) -> Any:
    """Returns a quantity such as "2 N/mm" as a number, and any other value as it is; of a list each. `unit`: of its
    field, as in `in_si`. Raises UsageError, with the path, for a unit that does not fit."""
    if isinstance(value, list | tuple):
        return [si_of(one, path, unit, units) for one in value]
    if not isinstance(value, str) or not QUANTITY.match(value) or not has_dimension(unit):
        return value
    try:
        return in_si(value, unit, units.motions)
    except UnitError as error:
        raise UsageError(f"{path}: found {error.found}, expected {units.filled(error.expected(unit))}") from None


def as_written(value: Any) -> Any:
    """Returns a value as a scene's file has it: a whole number without a point, a list without tuples and arrays."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [as_written(one) for one in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _is_of_device(path: str) -> bool:
    return path.partition(".")[0] in ("device", "mock", "devices", "mocks")


def _fields_of(scene: Scene) -> dict[str, FieldInfo]:
    """Returns the field of each path of a scene."""
    found = {key: Scene.model_fields[key] for key in _TOP}
    for name in scene.ports:
        found |= _fields(name, Device) | _fields(f"devices.{name}", Device) | _fields(f"mocks.{name}", Mock)
    if not scene.ports:
        found |= _fields("device", Device) | _fields("mock", Mock)
    for name, part in (*scene.modules.items(), *scene.sound.items()):
        found |= _fields(name, type(part))
    return {path: one for path, one in found.items() if not path.endswith(_FIXED)}


def _fields(name: str, model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Returns the fields below a part of the scene by path, those of its own parts among them."""
    found: dict[str, FieldInfo] = {}
    for key, field in model.model_fields.items():
        path = f"{name}.{field.alias or key}"
        kinds = field.annotation, *get_args(field.annotation)  # of a part, or of a part or None
        part = next((one for one in kinds if isinstance(one, type) and issubclass(one, BaseModel)), None)
        found |= _fields(path, part) if part and not expectation_of(field) else {path: field}
    return found
