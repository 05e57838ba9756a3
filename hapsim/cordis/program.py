"""Scene -> Program: the arrays that the compiled tick works on, and nothing that the scene does not have.

Points are numbered: device points first (the exchange writes them), then grounds, then masses (which stand together,
so that they advance in one pass).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.device_point import DevicePoints, device_points
from hapsim.cordis.mass import Masses, masses
from hapsim.cordis.viscoelastic import ViscoElasticLinks, viscoelastic_links
from hapsim.scene import Scene, ViscoElastic


class Program(NamedTuple):
    """A scene as the tick sees it: state of N points (m, and N for the force), and the modules that move them."""

    position: NDArray[np.float64]
    previous: NDArray[np.float64]
    force: NDArray[np.float64]
    devices: DevicePoints
    masses: Masses
    links: ViscoElasticLinks


def compile_scene(scene: Scene) -> Program:
    """The program of `scene`, at its initial state."""
    points = [*scene.device_points, *scene.grounds, *scene.masses]
    number = {name: i for i, name in enumerate(points)}
    position = np.zeros(len(points))
    previous = np.zeros(len(points))
    for name, ground in scene.grounds.items():
        position[number[name]] = previous[number[name]] = ground.position
    for name, mass in scene.masses.items():
        position[number[name]] = mass.position
        previous[number[name]] = mass.position - mass.velocity / scene.rate
    links = [link for link in scene.links.values() if isinstance(link, ViscoElastic)]
    return Program(
        position,
        previous,
        np.zeros(len(points)),
        device_points([point.channel for point in scene.device_points.values()]),
        masses(len(scene.device_points) + len(scene.grounds), [m.mass for m in scene.masses.values()], scene.rate),
        viscoelastic_links(
            [(number[link.between[0]], number[link.between[1]]) for link in links],
            [link.stiffness for link in links],
            [link.damping for link in links],
            scene.rate,
        ),
    )
