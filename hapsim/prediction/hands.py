"""A scene's hands as the theory takes them: each the temporary hybrid system of a channel where its links end on
grounds, and all of them a network where they do not."""

from __future__ import annotations

import math

import numpy as np

from hapsim.prediction.linear import LinearLink, LinearScene
from hapsim.scene import Scene
from hapsim.theory import Configuration, Network
from hapsim.theory.interface import damper_named


def links_of(linear: LinearScene, name: str) -> list[LinearLink]:
    return [link for link in linear.links.values() if name in link.between]


def dampers_of(linear: LinearScene, name: str) -> dict[tuple[str, float | None], str]:
    """The kinds of damper that do something at this device point, (damper, cutoff), each with a link that has it."""
    own = {link: module for link, module in linear.links.items() if name in module.between}
    return {(module.damper, module.cutoff): link for link, module in own.items() if module.damping > 0.0}


def why_coupled(scene: Scene, linear: LinearScene, name: str) -> str:
    """Why the hand at this device point is no oscillator of its own, in words that follow its name; "" where it is."""
    links = {link: module for link, module in linear.links.items() if name in module.between}
    masses, hands = linear.masses, scene.device_points
    for link, module in links.items():
        (other,) = set(module.between) - {name}
        if other in masses:
            return f"moves a mass of the scene too ({other}, by {link})"
        if other in hands:
            return f"is tied to another hand ({other}, by {link})"
    kinds = dampers_of(linear, name)
    if len(kinds) < 2:
        return ""
    words = (
        f"{link}: {kind}" + ("" if cutoff is None else f" at {cutoff:g} Hz") for (kind, cutoff), link in kinds.items()
    )
    return f"has dampers of several kinds ({', '.join(words)})"


def configuration_of(
    scene: Scene, channel: int, damper: str = "backward", cutoff: float | None = None
) -> Configuration:
    """The temporary hybrid system of one channel, as the scene's device describes it, with such a damper."""
    device = scene.device
    return Configuration(
        mass=device.masses(scene.channels)[channel],
        rate=scene.rate,
        friction=device.frictions(scene.channels)[channel],
        delay=device.delay,
        hold=device.hold,
        sampling=device.sampling,
        stiffness=device.stiffnesses(scene.channels)[channel],
        damper=damper,
        cutoff=cutoff,
    )


def hand_of(scene: Scene, linear: LinearScene, name: str) -> tuple[Configuration, float, float]:
    """The temporary hybrid system of a hand, and K and B of all its links."""
    links = links_of(linear, name)
    damper, cutoff = next(iter(dampers_of(linear, name)), ("backward", None))
    stiffness, damping = math.fsum(link.stiffness for link in links), math.fsum(link.damping for link in links)
    return configuration_of(scene, scene.device_points[name].channel, damper, cutoff), stiffness, damping


def is_lone(scene: Scene, linear: LinearScene) -> bool:
    """Whether it is nothing but hands, each an oscillator of its own."""
    return not linear.masses and not any(why_coupled(scene, linear, name) for name in scene.device_points)


def network_of(scene: Scene, linear: LinearScene) -> tuple[Network, tuple[str, ...]]:
    """The whole scene as arrays: one point for every device point, one for every mass; the scene's own links first.

    Channels below the highest that no module holds are no part of it: what nothing touches is neither stable nor not.
    """
    channels = [point.channel for point in scene.device_points.values()]
    points = [*scene.device_points, *linear.masses]
    number = {name: i for i, name in enumerate(points)} | dict.fromkeys(linear.fixed, -1)
    links = [*linear.links.values(), *linear.inner]
    device = scene.device
    network = Network(
        rate=scene.rate,
        channel_mass=np.array(device.masses(scene.channels))[channels],
        channel_friction=np.array(device.frictions(scene.channels))[channels],
        delay=device.delay,
        hold=device.hold,
        sampling=device.sampling,
        point_mass=np.array(list(linear.masses.values())),
        ends=np.array([[number[end] for end in link.between] for link in links], int).reshape(-1, 2),
        stiffness=np.array([link.stiffness for link in links]),
        damping=np.array([link.damping for link in links]),
        channel_stiffness=np.array(device.stiffnesses(scene.channels))[channels],
        damper=tuple(damper_named(link.damper, link.cutoff, scene.rate) for link in links),
        margin_links=len(linear.links),
        scheme=scene.scheme,
        outside=tuple(link.outside for link in links),
    )
    return network, tuple(points)
