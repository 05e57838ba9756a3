"""The states of the inputs that a scene's gates need (`when`), and the scene in each of them."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any

from hapsim.number_format import listed

from .mock import Mock
from .modules.links import Link
from .modules.point_modules import DevicePoint, Ground
from .scene import Scene
from .section import Table

MOST_COMBINED = 4
"""Inputs of which every combination is judged; of more, all, none, and each one alone on or off."""


def used_inputs(scene: Scene) -> tuple[str, ...]:
    """Returns the inputs that `when` names, in the scene's order."""
    named = {scene.device.when, *(link.when for link in scene.gated.values())}
    return tuple(name for name in scene.inputs if name in named)


def off_words(names: Sequence[str]) -> str:
    """Returns "touch is off" for these inputs; "" for none."""
    return f"{listed(names)} {'are' if names[1:] else 'is'} off" if names else ""


def input_states(scene: Scene) -> list[frozenset[str]]:
    """Returns the inputs that are on, in every state in which the scene is judged beside that of all."""
    used = used_inputs(scene)
    counts = range(len(used)) if len(used) <= MOST_COMBINED else (len(used) - 1, 1, 0)
    return [frozenset(on) for count in reversed(counts) for on in combinations(used, count)]


def with_inputs(scene: Scene, on: frozenset[str]) -> Scene:
    """Returns the scene without gates in which only the inputs `on` are on, as `Scene.with_inputs` does."""
    modules, device = dict(scene.modules), scene.device
    for name, link in scene.gated.items():
        modules[name] = link.model_copy(update={"when": None})
        if link.when not in on:
            del modules[name]
    if device.when is not None and device.when not in on:
        modules = dict(_without_motor(modules, scene.space))
    parts: dict[str, Any] = {"modules": Table(modules), "device": device.model_copy(update={"when": None})}
    return scene.model_copy(update=parts)


def _without_motor(modules: Mapping[str, Any], space: int) -> Iterator[tuple[str, Any]]:
    """Yields the modules where no hand feels a force: the links of a hand end on a ground, from which they are driven
    as from the hand, and those that then join no masses are left out."""
    held = Ground(position=0.0).model_copy(update={} if space == 1 else {"position": (0.0,) * space})
    still = {name for name, one in modules.items() if isinstance(one, Ground | DevicePoint)}
    for name, one in modules.items():
        if isinstance(one, DevicePoint):
            yield name, one
            yield f"{name}-held", held
        elif not isinstance(one, Link):
            yield name, one
        elif not still.issuperset(one.between):
            ends = tuple(f"{end}-held" if isinstance(modules.get(end), DevicePoint) else end for end in one.between)
            yield name, one.model_copy(update={"between": ends})


def with_mock_inputs_on(scene: Scene) -> Scene:
    """Returns the scene with every input that a gate needs on from the start, on the mock; except those whose changes
    the scene names."""
    if not (used := used_inputs(scene)):
        return scene
    mock = scene.mock or Mock()
    inputs = Table(dict.fromkeys(used, (0.0,)) | dict(mock.inputs))
    return scene.model_copy(update={"mock": mock.model_copy(update={"inputs": inputs})})
