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

_EXPORTS = {
    "choices": ("WITH_CUTOFF", "DamperScheme", "Hold", "Sampling", "SchemeName"),
    "device": ("Clock", "Device"),
    "load": ("load_scene", "parse_scene", "scene_schema"),
    "mock": ("Hand", "Initial", "Mock", "MockDevice"),
    "quantity": ("Known", "Span"),
    "scene": ("VERSION", "Scene"),
}
_HOMES = {name: home for home, names in _EXPORTS.items() for name in names}

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
    home = _HOMES.get(name, "modules" if name[:1].isupper() else "")
    found = getattr(import_module(f".{home}", __name__), name, None) if home else None
    if found is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return found


def __dir__() -> list[str]:
    return sorted([*__all__, *import_module(".modules", __name__).__all__])
