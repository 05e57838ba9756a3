"""What is sound in a scene that has faults, so that the checks across its parts reach as far as they can."""

from collections.abc import Iterable
from functools import cache
from typing import Any

from pydantic import TypeAdapter, ValidationError

from .cross_checks import PER_CHANNEL_PARTS
from .issue import Issue, Path
from .modules import MODULE_TYPES, Module, ModuleContext


def sound_modules(modules: object) -> ModuleContext:
    """What can be known of the modules while some of them are faulty."""
    if not isinstance(modules, dict):
        return ModuleContext({}, {"": None})
    types = {name: module.get("type") if isinstance(module, dict) else None for name, module in modules.items()}
    kinds = {name: MODULE_TYPES.get(kind) if isinstance(kind, str) else None for name, kind in types.items()}
    both = {name: _sound_part(kind, modules[name]) for name, kind in kinds.items() if kind is not None}
    faulty = {name: wrong for name, (_, wrong) in both.items() if wrong}
    return ModuleContext({name: module for name, (module, _) in both.items()}, kinds, faulty)


def _sound_part(kind: type[Module], data: Any) -> tuple[Module, frozenset[str]]:
    """The module with its sound fields, and which of its fields are not."""
    try:
        return kind.model_validate(data), frozenset()
    except ValidationError as error:
        faulty = frozenset(str(detail["loc"][0]) for detail in error.errors(include_url=False))
        sound = [field for field in kind.model_fields if field in data and field not in faulty]
        values = {field: _adapter(kind, field).validate_python(data[field]) for field in sound}
        return kind.model_construct(None, **values), faulty


@cache
def _adapter(kind: type[Module], field: str) -> TypeAdapter[Any]:
    return TypeAdapter(kind.model_fields[field].rebuild_annotation())


def sound_fields(data: dict[str, Any], issues: Iterable[Issue]) -> dict[Path, dict[str, object]]:
    """The fields of the device and the mock that nothing was found in."""
    faulty = {issue.path[:length] for issue in issues for length in range(len(issue.path) + 1)}
    sound: dict[Path, dict[str, object]] = {}
    for path in PER_CHANNEL_PARTS:
        part: Any = data
        for step in path:
            part = part.get(step) if isinstance(part, dict) else None
        fields = part if isinstance(part, dict) else {}
        sound[path] = {name: value for name, value in fields.items() if (*path, name) not in faulty}
    return sound
