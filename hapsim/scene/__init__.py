"""The scene file: YAML -> `Scene`, errors with file:line:column, and a JSON schema for editors.

`load_scene` goes through four steps: `syntax` composes YAML nodes, `document` reads values from them and
remembers their places, pydantic checks each part, `cross_checks` checks the parts against each other; `error_messages`
words what pydantic finds. Nothing is imported before it is asked for, so that naming this room costs nothing. Public is
what `__all__` names.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .device import Clock, Device, Hold, Sampling
    from .load import load_scene, parse_scene
    from .mock import Initial, Mock, MockDevice
    from .modules import (
        Buffer,
        Cell,
        Damper,
        DevicePoint,
        Friction,
        Ground,
        Link,
        Mass,
        Membrane,
        Module,
        Nonlinear,
        Plectrum,
        Pluck,
        Spring,
        String,
        Structure,
        ViscoElastic,
    )
    from .scene import VERSION, Scene, SchemeName
    from .schema import scene_schema

_EXPORTS = {
    "device": ("Clock", "Device", "Hold", "Sampling"),
    "load": ("load_scene", "parse_scene"),
    "mock": ("Initial", "Mock", "MockDevice"),
    "modules": (
        "Buffer",
        "Cell",
        "Damper",
        "DevicePoint",
        "Friction",
        "Ground",
        "Link",
        "Mass",
        "Membrane",
        "Module",
        "Nonlinear",
        "Plectrum",
        "Pluck",
        "Spring",
        "String",
        "Structure",
        "ViscoElastic",
    ),
    "scene": ("VERSION", "Scene", "SchemeName"),
    "schema": ("scene_schema",),
}
_HOMES = {name: home for home, names in _EXPORTS.items() for name in names}

__all__ = [
    "VERSION",
    "Buffer",
    "Cell",
    "Clock",
    "Damper",
    "Device",
    "DevicePoint",
    "Friction",
    "Ground",
    "Hold",
    "Initial",
    "Link",
    "Mass",
    "Membrane",
    "Mock",
    "MockDevice",
    "Module",
    "Nonlinear",
    "Plectrum",
    "Pluck",
    "Sampling",
    "Scene",
    "SchemeName",
    "Spring",
    "String",
    "Structure",
    "ViscoElastic",
    "load_scene",
    "parse_scene",
    "scene_schema",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
