"""The scene file: YAML -> `Scene`, errors with file:line:column, and a JSON schema for editors.

`load_scene` goes through three steps: `yaml_document` reads values and their places, pydantic checks each part,
`cross_checks` checks the parts against each other. `yaml_file` words what pydantic finds. Nothing is imported
before it is asked for, so that importing this package costs nothing. Public is what `__all__` names.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .choices import WITH_CUTOFF, DamperScheme, Hold, Sampling, SchemeName
    from .device import Clock, Device
    from .drive import Transmission
    from .load import load_scene, parse_scene, scene_schema
    from .mock import Cogging, ForceNoise, Hand, Initial, Mock, MockDevice, Saturation
    from .modules import *  # noqa: F403
    from .modules.detents import *  # noqa: F403
    from .modules.links import *  # noqa: F403
    from .modules.point_modules import *  # noqa: F403
    from .modules.structures import *  # noqa: F403
    from .modules.surfaces import *  # noqa: F403
    from .scene import VERSION, Scene
    from .values import Branches, Known, Span

_MODULES = (
    "modules.point_modules",
    "modules.structures",
    "modules.links",
    "modules.detents",
    "modules.surfaces",
    "modules",
)
_HOMES = ("choices", "values", "device", "mock", *_MODULES, "scene", "load")  # the light ones first

__all__ = [
    "VERSION",
    "WITH_CUTOFF",
    "Branches",
    "Clock",
    "Cogging",
    "DamperScheme",
    "Device",
    "ForceNoise",
    "Hand",
    "Hold",
    "Initial",
    "Known",
    "Mock",
    "MockDevice",
    "Sampling",
    "Saturation",
    "Scene",
    "SchemeName",
    "Span",
    "Transmission",
    "load_scene",
    "parse_scene",
    "scene_schema",
]
"""Public names, in addition to `__all__` of `modules` and every class of its MODULE_TYPES."""


def __getattr__(name: str) -> object:
    if not name.startswith("_") and name not in _HOMES:
        for home in _HOMES:
            if name in vars(module := import_module(f".{home}", __name__)):
                return vars(module)[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    modules = import_module(".modules", __name__)
    return sorted([*__all__, *modules.__all__, *(kind.__name__ for kind in modules.MODULE_TYPES.values())])
