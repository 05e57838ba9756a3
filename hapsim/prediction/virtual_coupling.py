"""Virtual couplings of a scene: between each hand and what it feels, so that the hand is stable whatever that is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hapsim.errors import UsageError
from hapsim.prediction.linear import configuration_of
from hapsim.prediction.predict import predict
from hapsim.scene import Scene
from hapsim.scene.load import scene_from_document
from hapsim.theory.coupling import Coupling, stiffest_coupling, stiffest_for
from hapsim.theory.hand.configuration import Configuration

_PROXY_SHARE = 0.1  # of the hand's mass


@dataclass(frozen=True)
class FeltCoupling:
    """A coupling, and what the hand feels of it while the proxy stands still."""

    coupling: Coupling
    k: float
    b: float


@dataclass(frozen=True)
class HandCouplings:
    """The couplings of one hand."""

    name: str
    channel: int
    friction: float
    """Friction of the device, N·s/m."""
    masses: tuple[float, float]
    """Least and greatest mass of hand and handle, kg."""
    any_hand: FeltCoupling
    """For every passive hand."""
    this_hand: FeltCoupling | None
    """For a hand of these masses alone; None if none is found."""
    proxy_mass: float
    """Mass of the proxy, kg, a mass of the scene."""
    needed_friction: float
    """Friction, N·s/m, that makes the scene with the first coupling and this proxy stable in any hand; infinite if none
    does, NaN if it is not derived."""


def virtual_couplings(scene: Scene, proxy_mass: float | None = None) -> list[HandCouplings]:
    """Returns the couplings of each hand. `proxy_mass`: kg [default: a tenth of the hand's]. Raises UsageError where no
    coupling is known: without a hand, for a fractional delay, another hold than zero-order, or without friction."""
    if not scene.device_points:
        raise UsageError("modules: found no device point, expected a hand to couple")
    return [_couplings_of(scene, name, point.channel, proxy_mass) for name, point in scene.device_points.items()]


def _couplings_of(scene: Scene, name: str, channel: int, proxy_mass: float | None) -> HandCouplings:
    least, most = scene.device.mass_spans(scene.channels)[channel]
    hands = [replace(configuration_of(scene, channel), mass=mass) for mass in dict.fromkeys((least, most))]
    hand = hands[0]
    _require_derived(scene, hand, name)
    any_hand = stiffest_coupling(hand.friction, hand.period, int(hand.delay))
    this_hand = stiffest_for(hands)
    mass = _PROXY_SHARE * least if proxy_mass is None else proxy_mass
    lightest = 0.25 * (any_hand.stiffness * hand.period + 2.0 * any_hand.damping) * hand.period
    if not mass > lightest:
        units = scene.units_of(channel)
        raise UsageError(
            f"--proxy-mass: found {units(mass, 'kg')}, expected more than {units(lightest, 'kg')}: a lighter mass on "
            "this coupling is unstable by itself"
        )
    of_scene = predict(coupled_scene(scene, name, any_hand, mass), with_margins=False)
    needed = next((one.needed[one.names.index(name)] for one in of_scene.any_hands if name in one.names), math.nan)
    felt = [None if one is None else _felt(hand, one) for one in (any_hand, this_hand)]
    assert felt[0] is not None
    return HandCouplings(name, channel, hand.friction, (least, most), felt[0], felt[1], mass, float(needed))


def _require_derived(scene: Scene, hand: Configuration, name: str) -> None:
    """Raises UsageError if the condition for a coupling is not derived for this hand."""
    for key, found, is_right, expected in (
        ("device.delay", f"{hand.delay:g}", hand.delay == int(hand.delay), "a whole number of samples"),
        ("device.hold", hand.hold, hand.hold == "zoh", "zoh"),
        ("device.sampling", hand.sampling, hand.sampling == "ideal", "ideal"),
        ("substeps", str(scene.substeps), scene.substeps == 1, "1"),
    ):
        if not is_right:
            why = "what makes a coupling stable is derived for no other"
            raise UsageError(f"{name}: {key}: found {found}, expected {expected}: {why}")
    if not hand.friction > 0.0:
        raise UsageError(
            f"{name}: device.friction: found 0, expected more: without it no coupling is stable in any hand"
        )


def coupled_scene(scene: Scene, name: str, coupling: Coupling, proxy_mass: float) -> Scene:
    """Returns the scene with a proxy, a mass of `proxy_mass` kg: links of the device point `name` end at it, and the
    coupling joins both."""
    data = scene.model_dump(mode="json", exclude_none=True)
    modules, proxy, link = data["modules"], f"{name}_proxy", f"{name}_coupling"
    if known := modules.keys() & {proxy, link}:
        raise UsageError(f"modules: found {min(known)}, so {name} is coupled already; take its coupling out first")
    for module in modules.values():
        if "between" in module:
            module["between"] = [proxy if end == name else end for end in module["between"]]
    modules[proxy] = {"type": "mass", "mass": proxy_mass}
    ends = {"between": [name, proxy], "stiffness": coupling.stiffness, "damping": coupling.damping}
    modules[link] = {"type": "viscoelastic", **ends}
    return scene_from_document(data, scene)


def _felt(hand: Configuration, coupling: Coupling) -> FeltCoupling:
    k, b = hand.equivalent(np.array(coupling.stiffness), np.array(coupling.damping))
    return FeltCoupling(coupling, float(k), float(b))
