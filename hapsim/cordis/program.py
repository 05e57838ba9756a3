"""Scene -> Program: the arrays that the compiled tick works on, and nothing that the scene does not have.

Points are numbered: device points first (the exchange writes them), then grounds, then masses (which stand together,
so that they advance in one pass).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.damper_centred import CentredLinks, centred_links
from hapsim.cordis.damper_filtered import FilteredLinks, filtered_links
from hapsim.cordis.damper_sensed import SensedLinks, sensed_links
from hapsim.cordis.device_point import DevicePoints, device_points
from hapsim.cordis.mass import Masses, masses
from hapsim.cordis.viscoelastic import Links, links_between
from hapsim.scene import Scene, ViscoElastic


class Program(NamedTuple):
    """A scene as the tick sees it: state of N points (m, and N for the force), and the modules that move them.

    The visco-elastic links stand by their damper.
    """

    position: NDArray[np.float64]
    previous: NDArray[np.float64]
    force: NDArray[np.float64]
    devices: DevicePoints
    masses: Masses
    backward: Links
    centred: CentredLinks
    filtered: FilteredLinks
    sensed: SensedLinks


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
    cutoffs = [link.cutoff for link in _with_damper(scene, "filtered") if link.cutoff is not None]
    return Program(
        position,
        previous,
        np.zeros(len(points)),
        device_points([point.channel for point in scene.device_points.values()]),
        masses(len(scene.device_points) + len(scene.grounds), [m.mass for m in scene.masses.values()], scene.rate),
        _links(scene, number, "backward"),
        centred_links(_links(scene, number, "centred")),
        filtered_links(_links(scene, number, "filtered"), cutoffs, scene.rate),
        sensed_links(_links(scene, number, "sensed"), scene.rate),
    )


def _with_damper(scene: Scene, damper: str) -> list[ViscoElastic]:
    return [link for link in scene.links.values() if isinstance(link, ViscoElastic) and link.damper == damper]


def _links(scene: Scene, number: dict[str, int], damper: str) -> Links:
    links = _with_damper(scene, damper)
    return links_between(
        [(number[link.between[0]], number[link.between[1]]) for link in links],
        [link.stiffness for link in links],
        [link.damping for link in links],
        scene.rate,
    )
