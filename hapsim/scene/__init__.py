"""The scene file: YAML -> `Scene`, errors with file:line:column, and a JSON schema for editors.

`load_scene` goes through three steps: `yaml_document` reads values and their places, pydantic checks each part,
`cross_checks` checks the parts against each other. `error_messages` words what pydantic finds. Nothing is imported
before it is asked for, so that importing this package costs nothing. Public is what `__all__` names.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .choices import WITH_CUTOFF, DamperScheme, Hold, Sampling, SchemeName
    from .device import Clock, Device
    from .load import load_scene, parse_scene, scene_schema
    from .mock import Hand, Initial, Mock, MockDevice
    from .modules import *  # noqa: F403
    from .quantity import Known, Span
    from .scene import VERSION, Scene

_HOMES = ("choices", "quantity", "device", "mock", "modules", "scene", "load")  # the light ones first

__all__ = [
    "VERSION",
    "WITH_CUTOFF",
    "Clock",
    "DamperScheme",
    "Device",
    "Hand",
    "Hold",
    "Initial",
    "Known",
    "Mock",
    "MockDevice",
    "Sampling",
    "Scene",
    "SchemeName",
    "Span",
    "load_scene",
    "parse_scene",
    "scene_schema",
]
"""Beside all of `modules`."""


def __getattr__(name: str) -> object:
    if not name.startswith("_") and name not in _HOMES:
        for home in _HOMES:
            if name in vars(module := import_module(f".{home}", __name__)):
                return vars(module)[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *import_module(".modules", __name__).__all__])
