"""Scene -> Program: the arrays that the compiled tick works on, and nothing that the scene does not have.

Points are numbered: device points first (the exchange writes them), then grounds, then masses (which stand together,
so that they advance in one pass). What can be changed while the scene runs (stiffness, damping, rest positions) stands
together in one array, of which the modules hold their parts: `parameter_values` says what stands where.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.damper_centred import CentredLinks, centred_links
from hapsim.cordis.damper_filtered import FilteredLinks, filtered_links
from hapsim.cordis.damper_sensed import SensedLinks, sensed_links
from hapsim.cordis.device_point import DevicePoints, device_points
from hapsim.cordis.ground import Grounds
from hapsim.cordis.mass import Masses, masses
from hapsim.cordis.viscoelastic import Links, links_between
from hapsim.scene import Scene, ViscoElastic


class Program(NamedTuple):
    """A scene as the tick sees it: state of N points (m, and N for the force), and the modules that move them.

    The visco-elastic links stand by their damper. What the scene lacks is None, and the tick is compiled without it.
    """

    position: NDArray[np.float64]
    previous: NDArray[np.float64]
    force: NDArray[np.float64]
    parameters: NDArray[np.float64]
    devices: DevicePoints
    grounds: Grounds
    masses: Masses | None
    backward: Links | None
    centred: CentredLinks | None
    filtered: FilteredLinks | None
    sensed: SensedLinks | None


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
    values = parameter_values(scene)
    rest, *parts = _cut(values, scene)
    links = {
        damper: links_between([(number[one.between[0]], number[one.between[1]]) for one in of_kind], *part)
        for (damper, of_kind), part in zip(_by_damper(scene), zip(parts[::2], parts[1::2], strict=True), strict=True)
        if of_kind
    }
    first_mass = len(scene.device_points) + len(scene.grounds)
    return Program(
        position,
        previous,
        np.zeros(len(points)),
        values,
        device_points([point.channel for point in scene.device_points.values()]),
        Grounds(len(scene.device_points), rest),
        masses(first_mass, [m.mass for m in scene.masses.values()], scene.rate) if scene.masses else None,
        links.get("backward"),
        centred_links(links["centred"]) if "centred" in links else None,
        filtered_links(links["filtered"], cutoffs, scene.rate) if "filtered" in links else None,
        sensed_links(links["sensed"], scene.rate) if "sensed" in links else None,
    )


def parameter_values(scene: Scene) -> NDArray[np.float64]:
    """What can be changed while the scene runs, shape (P,): the grounds' positions in m; then for each kind of damper
    the links' K, and their B/T, in N/m."""
    values = [ground.position for ground in scene.grounds.values()]
    for _, links in _by_damper(scene):
        values += [link.stiffness for link in links]
        values += [link.damping * scene.rate for link in links]  # the guard sees what comes of an infinity
    return np.array(values, np.float64)


def _cut(values: NDArray[np.float64], scene: Scene) -> list[NDArray[np.float64]]:
    """The parts of `parameter_values`, not copied."""
    counts = [len(scene.grounds)]
    for _, links in _by_damper(scene):
        counts += [len(links), len(links)]
    return np.split(values, np.cumsum(counts)[:-1])


def _by_damper(scene: Scene) -> list[tuple[str, list[ViscoElastic]]]:
    return [(damper, _with_damper(scene, damper)) for damper in ("backward", "centred", "filtered", "sensed")]


def _with_damper(scene: Scene, damper: str) -> list[ViscoElastic]:
    return [link for link in scene.links.values() if isinstance(link, ViscoElastic) and link.damper == damper]
