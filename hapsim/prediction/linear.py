"""Linear form of a scene: masses, springs and dampers; one oscillator for each single hand, or a network."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.laws import Linear, line
from hapsim.scene import Scene
from hapsim.scene.admittance import AssumedHand
from hapsim.scene.choices import BY_SENSORS
from hapsim.scene.drive import Drive
from hapsim.theory import Configuration, Network, NotWorkedOutError
from hapsim.theory.follower import Follower
from hapsim.theory.interface import Ahead, BoardLaw, damper_named, hold_lag
from hapsim.theory.plant import Drive as DriveModel
from hapsim.theory.schemes import SCHEMES, LinkNature


class LinearLink(NamedTuple):
    """Spring and damper between two points, named as in the scene."""

    between: tuple[str, str]
    stiffness: float
    damping: float
    damper: str = "backward"
    cutoff: float | None = None
    outside: bool = False
    """True if the scene's scheme holds its force from the sample over the sample period, whatever it joins."""
    second: tuple[float, float] = (1.0, 1.0)
    """Weights of its second end in its stretch, and in its pull on it."""


def spread(link: Any, share: float) -> Any:
    """Returns a link, or what stands for one, with its K times this share if its force falls with distance: its fall
    spread over a longer way."""
    return link._replace(stiffness=link.stiffness * share) if link.stiffness < 0.0 else link


class LinearScene(NamedTuple):
    """Scene in linear form."""

    masses: dict[str, float]
    """Points that the scene moves, with their masses in kg."""
    fixed: frozenset[str]
    """Points that do not move."""
    links: dict[str, LinearLink]
    """Links of the scene, by name."""
    inner: list[LinearLink]
    """Elements of its structures, and the springs that hold its material points."""
    implicit: frozenset[str]
    """Points of `masses` with an implicit step."""
    assumptions: list[str]
    """Sentences on the linear forms of links that are not linear."""


_FASTEST = {"linear": 1.0, "rotary": 30.0}
STAYS = "."  # a fixed place inside a structure; no module has this name


def with_device(scene: Scene, **changed: Any) -> Scene:
    """Returns the scene with some keys of its device replaced; they are not validated."""
    return scene.model_copy(update={"device": scene.device.model_copy(update=changed)})


def _is_outside(linear: Linear, scheme: str) -> bool:
    """Returns whether the scheme holds this force from the sample, whatever the link joins."""
    model = SCHEMES[scheme]
    nature = LinkNature(linear.in_a_matrix, linear.memoryless, at_channel=False)
    return model is not None and not model.inside(nature)


def linear_scene(scene: Scene, taken: Mapping[str, Linear] | None = None) -> LinearScene:
    """Returns the linear form of `scene`; `taken`: links with a known spring and damper at their place."""
    masses: dict[str, float] = {}
    links: dict[str, LinearLink] = {}
    assumptions = []
    for name, link in scene.links.items():
        law = link.law()
        linear = (taken or {}).get(name) or law.linear()
        outside = _is_outside(linear, scene.scheme)
        own = linear.stiffness, linear.damping, law.damper, law.cutoff, outside
        links[name] = LinearLink(link.between, *own, link.second_scale)
        if linear.assumption:
            assumptions.append(f"{name} {scene.units_at(name).filled(linear.assumption)}")
    inner: list[LinearLink] = []
    for name, point in scene.material_points.items():
        masses[name] = point.mass
        held = point.held_by()
        pulls = [] if held is None else [line(held.stiffness, held.damping, in_a_matrix=True).linear()]
        pulls += [point.law().linear()] if point.pulls_itself else []
        for own in pulls:
            outside = _is_outside(own, scene.scheme)
            inner.append(LinearLink((name, STAYS), own.stiffness, own.damping, outside=outside))
            if own.assumption:
                assumptions.append(f"{name} {scene.units_at(name).filled(own.assumption)}")
    for name, structure in scene.structures.items():
        places = [f"{name}.{place}" for place in structure.point_names()]
        elements = structure.elements()
        masses |= dict(zip(places, elements.masses, strict=True))
        named = [*places, STAYS]  # -1 is the last
        inner += [LinearLink((named[a], named[b]), k, z) for a, b, k, z in elements.links]
    return LinearScene(masses, frozenset([*scene.grounds, STAYS]), links, inner, frozenset(scene.proxies), assumptions)


def links_of(linear: LinearScene, name: str) -> dict[str, LinearLink]:
    """Links of the scene that end at this device point, by name."""
    return {link: module for link, module in linear.links.items() if name in module.between}


def dampers_of(linear: LinearScene, name: str) -> dict[tuple[str, float | None], str]:
    """Kinds of damper that act at this device point, (damper, cutoff), each with a link that has it."""
    links = links_of(linear, name)
    return {(module.damper, module.cutoff): link for link, module in links.items() if module.damping > 0.0}


def fastest_motion(scene: Scene) -> float:
    """Largest lasting speed of a hand, m/s or rad/s."""
    return _FASTEST["rotary" if "rotary" in scene.device.motions(scene.channels) else "linear"]


def needs_network(scene: Scene, name: str) -> bool:
    """Returns whether the regions of a hand's travel do not describe it completely: dampers of several kinds act at it
    somewhere, or a damper depends on the speed."""
    laws = [link.law() for link in scene.links.values() if name in link.between]
    kinds = {(law.damper, law.cutoff) for law in laws if any(law.dampings)}
    return len(kinds) > 1 or any(law.dampings_at(fastest_motion(scene)) for law in laws)


def coupling_reason(scene: Scene, linear: LinearScene, name: str) -> str:
    """Reason why the hand at this device point is no oscillator of its own, to follow its name; "" if it is one."""
    if scene.device.is_admittance:
        return joined_reason(scene, linear, name) or "is a simulated mass"
    drive = scene.device.drives(scene.channels)[scene.device_points[name].channel]
    parts = ["a transmission"] * drive.is_elastic + ["a motor lag"] * (drive.lag > 0.0)
    return joined_reason(scene, linear, name) or (f"has {' and '.join(parts)}" if parts else "")


def joined_reason(scene: Scene, linear: LinearScene, name: str) -> str:
    """The same, of a hand that may have a transmission or a lagging motor, or be a simulated mass."""
    for link, module in links_of(linear, name).items():
        (other,) = set(module.between) - {name}
        if other in linear.masses:
            return f"also moves a mass of the scene ({other}, by {link})"
        if other in scene.device_points:
            return f"is joined to another hand ({other}, by {link})"
    kinds = dampers_of(linear, name)
    other_than_backward = [f"{link}: {kind}" for (kind, _), link in kinds.items() if kind != "backward"]
    if other_than_backward and mean_lag(scene):
        return (
            f"receives the mean force of its substeps and has a damper that is not backward ({other_than_backward[0]})"
        )
    if len(kinds) < 2:
        return ""
    words = (
        f"{link}: {kind}" + ("" if cutoff is None else f" at {cutoff:g} Hz") for (kind, cutoff), link in kinds.items()
    )
    return f"has dampers of several kinds ({', '.join(words)})"


def configuration_of(
    scene: Scene, channel: int, damper: str = "backward", cutoff: float | None = None
) -> Configuration:
    """Temporary hybrid system of one channel, as the scene's device describes it, with such a damper."""
    device, board = scene.device, scene.device.board(scene.rate)
    by_host = Configuration(
        mass=device.masses(scene.channels)[channel],
        rate=scene.rate,
        friction=device.frictions(scene.channels)[channel],
        delay=device.delay,
        hold=device.hold,
        sampling=device.sampling,
        stiffness=device.stiffnesses(scene.channels)[channel],
        damper=damper,
        cutoff=cutoff,
        spring_lag=mean_lag(scene) if damper == "backward" else 0.0,
        ahead=ahead_of(scene, [channel]),
        drive=_drive_model(device.drives(scene.channels)[channel]),
    )
    return by_host if board is None else by_board(by_host, BoardLaw(*board))


def by_board(device: Configuration, board: BoardLaw) -> Configuration:
    """Returns the loop of a device with the law on its board: links to grounds are all there, whatever the delay of
    their line."""
    steps, delay, window = board
    at_once = {"hold": "zoh", "sampling": "ideal", "damper": "backward", "cutoff": None}
    own = {"rate": steps * device.rate, "delay": delay, "window": window, "steps": steps}
    return replace(device, **at_once, **own)  # type: ignore[arg-type]


def network_of_hand(hand: Configuration, stiffness: float, damping: float) -> Network:
    """Returns a hand on a spring, N/m, and a damper, N·s/m."""
    own: dict[str, Any] = {
        "channel_friction": [hand.friction],
        "channel_stiffness": [hand.stiffness],
        "ahead": hand.ahead,
        "drives": [hand.drive] if hand.drive.inner else [],
    }
    link = {"point_mass": [], "ends": [[0, -1]], "stiffness": [stiffness], "damping": [damping]}
    link["damper"] = [hand.normalised_loop.damper]
    return Network(hand.rate, [hand.mass], delay=hand.delay, hold=hand.hold, sampling=hand.sampling, **own, **link)  # type: ignore[arg-type]


def ahead_of(scene: Scene, channels: Sequence[int]) -> Ahead | None:
    """Returns how links see these channels ahead of their readings; None without a correction by sensors."""
    device = scene.device
    if device.correction not in BY_SENSORS:
        return None
    masses = device.masses(scene.channels)
    corrected_for = tuple(masses[channel] for channel in channels if device.acceleration_age)
    return Ahead(device.delay, device.acceleration_age, corrected_for)


def mean_lag(scene: Scene) -> float:
    """Lag of the mean of the substeps' forces behind the last one, for an even motion, sample periods."""
    return 0.5 - 0.5 / scene.substeps if scene.device.decimation == "mean" else 0.0


def other_hands(scene: Scene) -> dict[str, AssumedHand]:
    """Returns the hands that a device in admittance assumes beside that of `network_of`: the others at the ends of its
    spans, by words that follow "while"."""
    hands, units = scene.device.assumed_hands(scene.channels), scene.units
    found: dict[str, AssumedHand] = {}
    for i, j in ((1, 1), (0, 0), (0, 1)):
        k, b = tuple(one.stiffness[i] for one in hands), tuple(one.damping[j] for one in hands)
        of_k = ", ".join(dict.fromkeys(units.number(one, "N/m", "g") for one in k))
        of_b = ", ".join(dict.fromkeys(units.number(one, "N·s/m", "g") for one in b))
        words = f"the hand has {units(of_k, 'N/m')} and {units(of_b, 'N·s/m')}"
        taken = tuple(one.stiffness[1] for one in hands), tuple(one.damping[0] for one in hands)
        if (k, b) != taken:
            found[words] = AssumedHand(stiffness=k, damping=b, mass=tuple(one.mass for one in hands))
    return found


def hand_of(scene: Scene, linear: LinearScene, name: str) -> tuple[Configuration, float, float]:
    """Temporary hybrid system of a hand, and K and B of all its links."""
    links = links_of(linear, name).values()
    damper, cutoff = next(iter(dampers_of(linear, name)), ("backward", None))
    stiffness, damping = math.fsum(link.stiffness for link in links), math.fsum(link.damping for link in links)
    return configuration_of(scene, scene.device_points[name].channel, damper, cutoff), stiffness, damping


def stand_in_for(network: Network, reason: NotWorkedOutError) -> tuple[Network, str]:
    """Returns a network that stands in for one whose poles cannot be computed, and a sentence about it."""
    if network.substeps == 1:
        sentence = (
            "the masses are assumed to move by CORDIS's scheme; their stability and frequencies under "
            f"{network.scheme} are not worked out: {reason}"
        )
        return replace(network, scheme="cordis"), sentence
    if network.followers:
        raise UsageError(f"device.mode: found admittance in a scene that is not predicted: {reason}")
    steps, lag = network.substeps, hold_lag(network.hold)
    delay = steps * (network.delay + lag) - lag + (0.5 * (steps - 1) if network.decimation == "mean" else 0.0)
    fast = replace(network, rate=steps * network.rate, delay=delay, scheme="cordis", substeps=1)
    sentence = (
        "the device is assumed to sample with every substep, with the same delay, and the masses to move by CORDIS's "
        f"scheme; the effect of the device's own rate on the hand and on stability is not worked out: {reason}"
    )
    return fast, sentence


def _drive_model(drive: Drive) -> DriveModel:
    sides = drive.sensor == "handle", drive.friction_at == "handle"
    return DriveModel(drive.stiffness, drive.damping, drive.motor_mass, *sides, drive.lag)


def network_of(scene: Scene, linear: LinearScene) -> tuple[Network, tuple[str, ...]]:
    """Returns the whole scene as arrays, and the names of its points: the device points, then the masses. The scene's
    own links come first. Channels without a module have no point."""
    channels = [point.channel for point in scene.device_points.values()]
    points = [*scene.device_points, *linear.masses]
    number = {name: i for i, name in enumerate(points)} | dict.fromkeys(linear.fixed, -1)
    links = [*linear.links.values(), *linear.inner]
    device, drives, board = scene.device, scene.device.drives(scene.channels), scene.device.board(scene.rate)
    masses = np.array(device.mass_matrix(scene.channels) or device.masses(scene.channels))
    # Without masses the last of the steps equals a single step: it has both positions, and no other state.
    substeps = scene.substeps if linear.masses or device.decimation == "mean" else 1
    network = Network(
        rate=scene.rate,
        channel_mass=masses[np.ix_(channels, channels)] if masses.ndim > 1 else masses[channels],
        channel_friction=np.array(device.frictions(scene.channels))[channels],
        delay=device.delay,
        hold=device.hold,
        sampling=device.sampling,
        point_mass=np.array(list(linear.masses.values())),
        implicit=np.array([name in linear.implicit for name in linear.masses], bool),
        ends=np.array([[number[end] for end in link.between] for link in links], int).reshape(-1, 2),
        stiffness=np.array([link.stiffness for link in links]),
        damping=np.array([link.damping for link in links]),
        channel_stiffness=np.array(device.stiffnesses(scene.channels))[channels],
        damper=tuple(damper_named(link.damper, link.cutoff, scene.rate * substeps) for link in links),
        margin_links=len(linear.links),
        scheme=scene.scheme,
        outside=tuple(link.outside for link in links),
        second=np.array([link.second for link in links]) if scene.scaled_links else None,
        substeps=substeps,
        decimation=device.decimation,
        ahead=ahead_of(scene, channels),
        board=None if board is None else BoardLaw(*board),
        drives=[] if all(one.is_rigid for one in drives) else [_drive_model(drives[channel]) for channel in channels],
    )
    return (_in_admittance(network, scene, channels) if device.is_admittance else network), tuple(points)


def _in_admittance(network: Network, scene: Scene, channels: Sequence[int]) -> Network:
    """Returns the network in admittance, in the stiffest of the assumed hands with the least damping."""
    every = [*zip(scene.device.assumed_hands(scene.channels), scene.device.servos(scene.channels), strict=True)]
    hands, servos = zip(*(every[channel] for channel in channels), strict=True)
    k, b = (np.array(one) for one in zip(*((hand.stiffness[1], hand.damping[0]) for hand in hands), strict=True))
    of_servo = ((2.0 * math.pi * one.bandwidth, one.damping) if one else () for one in servos)
    followers = [Follower(hand.damping[0], hand.mass, *own) for hand, own in zip(hands, of_servo, strict=True)]
    return replace(
        network, channel_stiffness=k, channel_friction=network.channel_friction + b, followers=tuple(followers)
    )
