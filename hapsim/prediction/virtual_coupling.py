"""Virtual couplings of a scene: between each hand and what it feels, so that the hand is stable whatever that is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hapsim.errors import SceneError, UsageError
from hapsim.holds import HOLDS
from hapsim.prediction.linear import configuration_of
from hapsim.prediction.part import HAND_STIFFNESS
from hapsim.prediction.predict import predict
from hapsim.scene import Scene
from hapsim.scene.issue import one_of
from hapsim.scene.load import scene_from_document
from hapsim.theory import Network
from hapsim.theory.coupling import Coupling, needed_friction, stiffest_coupling, stiffest_for
from hapsim.theory.hand.configuration import Configuration
from hapsim.theory.network.felt import drift_damping, felt_mass

_PROXY_SHARE = 0.1  # of the hand's mass
_MASSES = 9  # of a span: between its ends a device's own spring may ask for more than at both


@dataclass(frozen=True)
class FeltCoupling:
    """A coupling, the friction that it needs for any hand and any passive scene, and what the hand feels: k and b while
    the proxy stands still (NaN for a `reason`); of a free proxy b, and a mass to a hand of `HAND_STIFFNESS`."""

    DOCUMENT = "*coupling needed_friction k b reason free_b free_mass"

    coupling: Coupling
    needed_friction: float
    k: float
    b: float
    reason: str
    free_b: float
    free_mass: float


@dataclass(frozen=True)
class HandCouplings:
    """The couplings of one hand."""

    DOCUMENT = (
        "name channel friction any_hand this_hand present proxy_mass is_passive_behind needed_friction misfit "
        "assumptions"
    )

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
    present: FeltCoupling | None
    """Coupling of its proxy in the scene; None if it has none."""
    proxy_mass: float
    """Mass of the proxy, kg."""
    is_passive_behind: bool
    """True if nothing but the coupling ends at the hand, and behind the proxy are only links to grounds that never fall
    with distance: then the friction that the coupling needs is enough."""
    needed_friction: float
    """Friction, N·s/m, that makes the scene, with the first coupling and a proxy if it has none, stable in any hand;
    infinite if none does, NaN if it is not derived."""
    misfit: str
    """Reason why not every link of the hand can end on a proxy; "" if each can."""
    assumptions: tuple[str, ...]
    """Simplifications of the scene for its needed friction."""


def virtual_couplings(scene: Scene, proxy_mass: float | None = None) -> list[HandCouplings]:
    """Returns the couplings of each hand. `proxy_mass`: kg [default: a tenth of the hand's]. Raises UsageError where no
    coupling is known: without a hand, for a hold by impulses, or without friction."""
    if not scene.device_points:
        raise UsageError("modules: found no device point, expected a hand to couple")
    scene.require_impedance("virtual couplings are derived for a device that renders forces")
    scene.require_line("virtual couplings are derived for that")
    for name, link in scene.scaled_links.items():
        raise UsageError(f"{name}.{link.scale}: found a {link.scale}, expected none: no proxy can stand at such a link")
    return [_couplings_of(scene, name, point.channel, proxy_mass) for name, point in scene.device_points.items()]


def _couplings_of(scene: Scene, name: str, channel: int, proxy_mass: float | None) -> HandCouplings:
    least, most = scene.device.mass_spans(scene.channels)[channel]
    masses = np.geomspace(least, most, _MASSES if least < most else 1).tolist()
    hands = [replace(configuration_of(scene, channel), mass=mass) for mass in masses]
    hand = hands[0]
    _require_derived(scene, hand, name)
    any_hand = stiffest_coupling(hand)
    this_hand = stiffest_for(hands)
    mass = _PROXY_SHARE * least if proxy_mass is None else proxy_mass
    proxy, own = next(
        ((proxy, one) for proxy, one in scene.proxies.items() if one.hand == name), (f"{name}_proxy", None)
    )
    mass, present = (mass, None) if own is None else (own.mass, Coupling(own.stiffness, own.damping))
    needed, is_passive, misfit = math.nan, False, ""
    assumptions: tuple[str, ...] = ()
    try:
        coupled = scene if own is not None else coupled_scene(scene, name, any_hand, mass)
        is_passive = _is_passive_behind(coupled, name, proxy)
        prediction = predict(coupled, with_margins=False)
        assumptions, part = prediction.assumptions, prediction.part_on(channel)
        needed = math.nan if part is None else float(part.any_hand.needed[part.names.index(name)])
    except SceneError as error:
        misfit = str(error)
    is_rotary = scene.device.motions(scene.channels)[channel] == "rotary"
    first, second, third = (one and _felt(hand, one, mass, is_rotary) for one in (any_hand, this_hand, present))
    assert first is not None
    outcome = first, second, third, mass, is_passive, needed, misfit, assumptions
    return HandCouplings(name, channel, hand.friction, (least, most), *outcome)


def _is_passive_behind(scene: Scene, name: str, proxy: str) -> bool:
    fixed = {*scene.grounds, proxy}
    others = (link for own, link in scene.links.items() if own != proxy and {name, proxy} & {*link.between})
    return all({*link.between} <= fixed and link.law().sector[0] >= 0.0 for link in others)


def _require_derived(scene: Scene, hand: Configuration, name: str) -> None:
    """Raises UsageError if the condition for a coupling is not derived for this hand."""
    held = one_of(name for name, hold in HOLDS.items() if not hold.has_impulses)
    drive = scene.device.drives(scene.channels)[scene.device_points[name].channel]
    for key, found, is_right, expected in (
        ("device.hold", hand.hold, not HOLDS[hand.hold].has_impulses, held),
        ("device.sampling", hand.sampling, hand.sampling == "ideal", "ideal"),
        ("device.transmission", "one", not drive.is_elastic, "none"),
        ("device.motor_lag", "one", drive.lag == 0.0, "none"),
        ("device.law", scene.device.law, scene.device.law == "host", "host"),
        ("substeps", str(scene.substeps), scene.substeps == 1, "1"),
        ("scheme", scene.scheme, scene.scheme == "cordis", "cordis"),
        ("device.correction", scene.device.correction, scene.device.correction == "none", "none"),
    ):
        if not is_right:
            why = "what makes a coupling stable is derived for no other"
            raise UsageError(f"{name}: {key}: found {found}, expected {expected}: {why}")
    if not hand.friction > 0.0:
        raise UsageError(
            f"{name}: device.friction: found 0, expected more: without friction no coupling is stable in any hand"
        )


def coupled_scene(scene: Scene, name: str, coupling: Coupling, proxy_mass: float) -> Scene:
    """Returns the scene with a proxy of `proxy_mass` kg, which this coupling joins to the device point `name`, whose
    links end at it. Raises SceneError if one of them cannot."""
    data = scene.document
    modules, proxy = data["modules"], f"{name}_proxy"
    if proxy in modules:
        raise UsageError(f"modules: found {proxy}, which is the name of the proxy here; expected another name")
    for module in modules.values():
        if "between" in module:
            module["between"] = [proxy if end == name else end for end in module["between"]]
    modules[proxy] = {"type": "proxy", "mass": proxy_mass, "hand": name, **coupling._asdict()}
    return scene_from_document(data, scene)


def _felt(hand: Configuration, coupling: Coupling, proxy_mass: float, is_rotary: bool) -> FeltCoupling:
    K, B = map(np.array, coupling)
    k, b = hand.equivalent(K, B)
    device = ([hand.mass], [hand.friction], hand.delay, hand.hold, hand.sampling)
    free = Network(hand.rate, *device, [proxy_mass], [[0, 1]], [K], [B], implicit=[True])  # type: ignore[arg-type]
    needed = needed_friction(coupling, hand)
    mass = math.nan if is_rotary else felt_mass(free, HAND_STIFFNESS)[0]
    reason = str(hand.why_no_equivalent(K, B))
    return FeltCoupling(coupling, needed, float(k), float(b), reason, float(drift_damping(free)[0]), mass)
