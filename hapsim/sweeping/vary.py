"""A scene with other values: what a point of a sweep makes of it."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel

from hapsim.errors import UsageError
from hapsim.scene import Device, Mock, Scene
from hapsim.scene.issue import did_you_mean
from hapsim.scene.load import scene_from_document
from hapsim.sweeping.points import Value

_TOP = ("rate", "substeps", "scheme", "precision")


class Varied:
    """A scene, of which values can be changed by their paths: `touch.stiffness`, `device.delay`, `mock.hand.force`,
    `rate`. Values are those of the scene's file, in SI units."""

    def __init__(self, scene: Scene) -> None:
        self._document = scene.model_dump(mode="json", exclude_none=True)
        self.name = scene.path or "the scene"
        self.known = sorted(_paths_of(scene))
        """Every path."""

    @property
    def document(self) -> dict[str, Any]:
        """The scene as it is."""
        return copy.deepcopy(self._document)

    def require(self, paths: Iterable[str]) -> None:
        """Raises UsageError for a path that the scene does not have."""
        for path in paths:
            if path not in self.known:
                raise UsageError(
                    f"found '{path}', expected a parameter of {self.name}, such as "
                    f"{_example(self.known)}{did_you_mean(path, self.known)}"
                )

    def scene(self, values: Mapping[str, Value]) -> Scene:
        """Returns the scene with these values, without its `path`. Raises SceneError where it is none."""
        document = self.document
        for path, value in values.items():
            part = document
            *above, key = self._keys(path)
            for one in above:
                part = part.setdefault(one, {})
            part[key] = int(value) if isinstance(value, float) and value.is_integer() else value
        return scene_from_document(document)

    def _keys(self, path: str) -> list[str]:
        head, *rest = path.split(".")
        return [head, *rest] if head in ("device", "mock", *_TOP) else self._keys_of_part(path)

    def _keys_of_part(self, path: str) -> list[str]:
        name, _, key = path.rpartition(".")
        kind = "modules" if name in self._document["modules"] else "sound"
        return [kind, name, key]


def _example(known: list[str]) -> str:
    return next((one for one in known if one.endswith(".stiffness") and not one.startswith(("device", "mock"))), "rate")


def _paths_of(scene: Scene) -> set[str]:
    found = {*_TOP, *_fields("device", Device), *_fields("mock", Mock)} - {"device.port", "device.clock"}
    for name, part in (*scene.modules.items(), *scene.sound.items()):
        found |= {one for one in _fields(name, type(part)) if not one.endswith((".type", ".between"))}
    return found


def _fields(name: str, model: type[BaseModel]) -> set[str]:
    """The paths below a part of the scene, those of its own parts among them."""
    found = set()
    for key, field in model.model_fields.items():
        path, kind = f"{name}.{field.alias or key}", field.annotation
        is_part = isinstance(kind, type) and issubclass(kind, BaseModel)
        found |= _fields(path, kind) if is_part else {path}  # type: ignore[arg-type]
    return found
