"""Scenes that differ from a running one: with other values, and what of a difference a running scene can take."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from hapsim.cordis.program import fixed_modules, places_of_values
from hapsim.cordis.schemes import without_matrices
from hapsim.errors import UsageError
from hapsim.running.live_parameters import MOCK_HAND, LivePart, modules_of, parts_of
from hapsim.scene import Hand, Mock, Scene
from hapsim.scene.cross_checks import lists_of_another_length
from hapsim.scene.issue import did_you_mean, one_of
from hapsim.scene.modules import ModuleContext
from hapsim.scene.modules.point_modules import DevicePoint, Ground
from hapsim.scene.section import Section, Table
from hapsim.scene.sound_channels import PickUp, sound_issues
from hapsim.units import Units

Changes = Mapping[str, Mapping[str, float | str | Sequence[Sequence[float]]]]
"""New values by module and field: a number, a word, or the points of a table."""

_EXAMPLE = '{"touch": {"stiffness": 500.0}}'
_MAY_DIFFER = (("mock", "initial"), ("mock", "hand"))


def first_fixed_difference(now: Scene, wanted: Scene) -> str:
    """Returns the first key that differs and cannot change while a scene runs; "" if none does."""
    for key in ("rate", "substeps", "inputs", "outputs"):
        if getattr(now, key) != getattr(wanted, key):
            return key
    for part in ("device", "mock"):
        before, after = getattr(now, part), getattr(wanted, part)
        if type(before) is not type(after) and _without_hand(before) != _without_hand(after):
            return part
        for key in type(before).model_fields if before is not None and after is not None else ():
            if (part, key) not in _MAY_DIFFER and not is_equal(getattr(before, key), getattr(after, key)):
                return f"{part}.{key}"
    if list(now.sound) != list(wanted.sound):
        return "sound: the names and order of its pick-ups"
    for name, before in now.sound.items():
        if before.highpass != wanted.sound[name].highpass:
            return f"sound.{name}.highpass"
    return ""


def _without_hand(mock: Mock | None) -> Mock:
    return (mock or Mock()).model_copy(update={"hand": Hand()})


def is_equal(before: Any, after: Any) -> bool:
    """Returns whether two values of a device agree on their common channels. A list has a value per channel; one value
    stands for all channels."""
    if isinstance(before, Section) and type(before) is type(after):
        return all(is_equal(getattr(before, key), getattr(after, key)) for key in type(before).model_fields)
    if not isinstance(before, tuple | list) and not isinstance(after, tuple | list):
        return bool(before == after)
    values = (one if isinstance(one, tuple | list) else itertools.repeat(one) for one in (before, after))
    return all(one == other for one, other in zip(*values, strict=False))


def differs_in_live_parameters_alone(now: Scene, wanted: Scene) -> bool:
    """Returns whether two scenes differ only in live parameters."""
    if first_fixed_difference(now, wanted) or (now.precision, now.scheme) != (wanted.precision, wanted.scheme):
        return False
    fixed = fixed_modules(now)

    def only_live_differ(name: str, before: LivePart, after: LivePart) -> bool:
        live = set() if name in fixed else {*before.live}
        return type(before) is type(after) and before.model_dump(exclude=live) == after.model_dump(exclude=live)

    before, after = parts_of(now), parts_of(wanted)
    if list(before) != list(after) or places_of_values(now) != places_of_values(wanted):
        return False
    return all(only_live_differ(name, one, after[name]) for name, one in before.items())


def require_restartable(scene: Scene, names: Sequence[str]) -> None:
    """Raises UsageError unless each name is that of a module whose state a trial can set back."""
    others = [name for name, one in scene.modules.items() if not isinstance(one, Ground | DevicePoint)]
    for name in names:
        if name not in others:
            expected = f"expected one of {', '.join(others)}{did_you_mean(str(name), others)}"
            raise UsageError(f"restart: found '{name}', {expected}")


def needs_crossfade(scene: Scene, changes: Any) -> bool:
    """Returns whether a `set` changes a value that may need another program, such as a table."""
    sound = isinstance(changes, Mapping) and all(isinstance(values, Mapping) for values in changes.values())
    parts = parts_of(scene)
    return sound and any(
        key in parts[name].crossfaded for name, values in changes.items() if name in parts for key in values
    )


def changed(scene: Scene, changes: Changes) -> Scene:
    """Returns the scene with some values changed. Raises UsageError for values that a scene file could not have."""
    parts = parts_of(scene)
    if not isinstance(changes, Mapping) or not all(isinstance(values, Mapping) for values in changes.values()):
        raise UsageError(f"found {changes!r}, expected the names of modules, each with what changes: {_EXAMPLE}")
    fixed = fixed_modules(scene)
    for name, values in changes.items():
        if name not in parts:
            raise UsageError(
                f"found '{name}', expected the name of a module or a pick-up{did_you_mean(str(name), parts)}"
            )
        if name in fixed and parts[name].live:
            raise UsageError(
                f"{name}: cannot change while the scene runs: scheme: {scene.scheme} compiles it into a matrix. "
                f"It can under scheme: {one_of(without_matrices())}"
            )
        parts[name] = _part_with(name, parts[name], values, scene.units_at(name))
    hand = parts.pop(MOCK_HAND, Hand())
    modules = modules_of(scene, parts)
    pick_ups = {name: one for name, one in parts.items() if isinstance(one, PickUp)}
    around = ModuleContext.of(modules)
    issues = (issue for name in changes if name in modules for issue in modules[name].issues(name, around))
    for issue in itertools.chain(issues, sound_issues(pick_ups, around, scene.scheme)):
        raise UsageError(f"{'.'.join(map(str, issue.path[1:]))}: {scene.units.filled(issue.sentence)}")
    for issue in lists_of_another_length({("mock", "hand"): dict(hand)}, scene.channels):
        raise UsageError(f"{'.'.join(map(str, issue.path))}: {issue.sentence}")
    is_changed = changes.keys() - {*scene.sound, MOCK_HAND}
    made: dict[str, Any] = {"modules": Table(modules)} if is_changed else {}
    if changes.keys() & scene.sound.keys():
        made["sound"] = Table(pick_ups)
    if MOCK_HAND in changes:
        made["mock"] = (scene.mock or Mock()).model_copy(update={"hand": hand})
    return scene.model_copy(update=made)


def _part_with(name: str, module: LivePart, values: Mapping[str, Any], units: Units) -> LivePart:
    changeable = (*module.live, *module.crossfaded)
    for key in values:
        if key not in changeable:
            live = f"{' and '.join(changeable)} can" if changeable else "nothing can"
            raise UsageError(f"{name}: found '{key}', but of a {module.type} {live} change while the scene runs")
    try:
        made = type(module).model_validate(module.model_dump() | dict(values))
        if isinstance(made, Ground) and isinstance(made.position, tuple):  # a ground here is one coordinate
            raise UsageError(f"{name}.position: found {values['position']!r}, expected a number ({units.si.name('m')})")
        return made
    except ValidationError as error:
        fault = error.errors()[0]
        (field, *steps), found, context = fault["loc"], fault["input"], fault.get("ctx", {})
        for step in (more := context.get("at", ())):
            found = found[step]
        index = "".join(f"[{step}]" for step in (*steps, *more) if isinstance(step, int))
        expected = fault["msg"].replace("Input should be", "expected")  # one of several words
        if "of_motion" in context:
            expected = f"expected {units.si.filled(context['of_motion'])}"
        raise UsageError(f"{name}.{field}{index}: found {found!r}, {expected}") from None
