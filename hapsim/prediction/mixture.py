"""The scene whose force is a weighted mean of the forces of two scenes, as while the fallback of a lease takes over.

A hand feels F = (1 - w) F_scene + w F_fallback, and the masses of both scenes feel the hand whole. The hand feels the
same force, and these masses move as before, where every stiffness, damping, force and mass of the one scene is (1 - w)
times as large, and of the other w times. So an ordinary scene has every answer about such a mean: `mixture` makes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from hapsim.prediction.linear import configuration_of, with_device
from hapsim.prediction.predict import surely_shaken_by
from hapsim.prediction.swings import Shaking
from hapsim.prediction.timing import on_wire
from hapsim.scene import Branches, Damper, DevicePoint, Ground, Scene
from hapsim.scene.choices import BY_SENSORS
from hapsim.scene.modules import Module
from hapsim.scene.quantity import expectation_of
from hapsim.scene.section import Table
from hapsim.theory import Configuration

PARTS = 8
"""Parts of a takeover; it is judged at their ends."""
_ALMOST = 1.0 - 2.0**-20  # of the weight: the scene's masses move with the hand, and hardly act on it
_SHARE = 0.9  # of the largest passive damping
_FAR = 1e3  # m, from where a damper in the plane acts along one axis
_WITH_MASS = ("kg", "N", "J")  # units in which there is a mass begin so


class Takeover(NamedTuple):
    """A growing motion while one scene takes over from another."""

    weight: float
    """The share of the new scene's force."""
    shaking: Shaking


def braked(scene: Scene) -> Scene:
    """Returns the scene in which each hand is damped, and feels nothing else: by nine tenths of what the device's own
    friction makes passive in any hand; not at all where no condition for that is derived."""
    modules: dict[str, Module] = {name: scene.modules[name] for name in _hands(scene)}
    for name, channels in _hands(scene).items():
        for axis, channel in zip("xy", channels, strict=False):
            place: Any = 0.0 if len(channels) == 1 else (_FAR, 0.0) if axis == "x" else (0.0, _FAR)
            end, damping = f"{name}_brake_{axis}", _passive_damping(configuration_of(on_wire(scene), channel))
            modules |= {
                f"{end}_end": Ground(position=place),
                end: Damper(between=(name, f"{end}_end"), damping=damping),
            }
    nothing: dict[str, Any] = {key: Table({}) for key in ("sound", "outputs")}
    return scene.model_copy(update=nothing | {"modules": Table(modules), "precision": "double"})


def _passive_damping(device: Configuration) -> float:
    """Returns a damping, N·s/m, that is passive in any hand. The friction that it needs is proportional to it."""
    try:
        return float(_SHARE * device.friction / device.needed_friction(0.0, 1.0))
    except ValueError:
        return 0.0


def mixture(scene: Scene, fallback: Scene, weight: float) -> Scene:
    """Returns the scene with the force (1 - weight) F_scene + weight F_fallback, without sound. Both are as they run,
    on the same device; 0 < weight < 1."""
    device = scene.device
    correction = device.correction if device.correction in BY_SENSORS else "none"
    hands = {channels: name for name, channels in _hands(scene).items()}
    names = {name: hands.get(channels) for name, channels in _hands(fallback).items()}
    prefix = "fallback_"
    while any(name.startswith(prefix) for name in scene.modules):
        prefix += "_"
    new = {name: names.get(name) or prefix + name for name in fallback.modules}
    modules = {name: _scaled(one, 1.0 - weight, {}) for name, one in scene.modules.items()}
    modules |= {new[name]: _scaled(one, weight, new) for name, one in fallback.modules.items() if not names.get(name)}
    mixed = scene.model_copy(update={"modules": Table(modules), "sound": Table({})})
    return with_device(mixed, correction=correction)


def shaken_while_taking_over(scene: Scene, fallback: Scene) -> Takeover | None:
    """Returns the first motion that will surely shake a hand while the force of `fallback` takes over from that of
    `scene`, or in one of them alone; None if there is none. Both are as they run, on the same device."""
    for i in range(PARTS + 1):
        weight = i / PARTS
        mixed = scene if i == 0 else mixture(scene, fallback, min(weight, _ALMOST))
        if (shaking := surely_shaken_by(mixed)) is not None:
            return Takeover(weight, shaking)
    return None


def _hands(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Returns the channels of each hand, by its name."""
    return {name: one.all_channels for name, one in scene.modules.items() if isinstance(one, DevicePoint)}


def _scaled(module: Module, share: float, names: Mapping[str, str]) -> Module:
    """Returns a module with this share of its forces and masses, and other names of the modules that it names."""
    return module.model_copy(update=dict(_changes(module, share, names)))


def _changes(module: Module, share: float, names: Mapping[str, str]) -> Iterator[tuple[str, Any]]:
    for key, field in type(module).model_fields.items():
        value, expected = getattr(module, key), expectation_of(field)
        if key == "between":
            yield key, tuple(_renamed(end, names) for end in value)
        elif key == "hand":  # of a proxy
            yield key, _renamed(value, names)
        elif expected is not None and value is not None and any(map(_has_mass, expected.units)):
            yield key, _times(value, [share if _has_mass(unit) else 1.0 for unit in expected.units])


def _renamed(end: str, names: Mapping[str, str]) -> str:
    holder, dot, place = end.partition(".")
    return names.get(holder, holder) + dot + place


def _has_mass(unit: str) -> bool:
    return unit.startswith(_WITH_MASS)


def _times(value: Any, shares: Sequence[float]) -> Any:
    """Returns a number, or the points of a curve, each coordinate times its share."""
    if isinstance(value, Branches):
        return value.model_copy(update={key: _times(getattr(value, key), shares) for key in ("press", "release")})
    if isinstance(value, tuple):
        return tuple(tuple(x * share for x, share in zip(point, shares, strict=True)) for point in value)
    return value * shares[0]
