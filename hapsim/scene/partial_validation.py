"""What is sound in a scene that has faults, so that the checks across its parts reach as far as they can."""

from collections.abc import Iterable
from typing import Any

from pydantic import ValidationError

from .cross_checks import PER_CHANNEL_PARTS
from .issue import Issue, Path
from .modules import MODULE_TYPES, Module, ModuleContext


def sound_modules(modules: object) -> ModuleContext:
    """What can be known of the modules while some of them are faulty."""
    if not isinstance(modules, dict):
        return ModuleContext({}, {"": None})
    types = {name: module.get("type") if isinstance(module, dict) else None for name, module in modules.items()}
    kinds = {name: MODULE_TYPES.get(kind) if isinstance(kind, str) else None for name, kind in types.items()}
    modules_or_none = {name: _sound_module(kind, modules[name]) for name, kind in kinds.items()}
    return ModuleContext({name: module for name, module in modules_or_none.items() if module}, kinds)


def _sound_module(kind: type[Module] | None, data: Any) -> Module | None:
    """The module, even a faulty one if the faults are not in what the others ask of it."""
    if kind is None:
        return None
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        faulty = {detail["loc"][0] for detail in error.errors(include_url=False)}
        if faulty.intersection(kind.shared):
            return None
        return kind.model_construct(**{field: data[field] for field in kind.shared if field in data})


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
