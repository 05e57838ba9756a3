"""hapsim's tick and a program for the same, taking turns: the ratio of what a sample costs, round by round."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.offline import start, ticks
from hapsim.cordis.program import compile_scene, numbers_of
from hapsim.scene import Device, DevicePoint, Ground, Mass, Scene, ViscoElastic
from hapsim.speed_accuracy.comparison import Running
from hapsim.speed_accuracy.objects import scene_of
from hapsim.speed_accuracy.strings import StringOfMasses, hand_link
from speed.peers.c_network import Network, RunningNetwork
from speed.peers.c_spring import CSpring
from speed.peers.c_stencil import CStencil
from speed.reference.build import build_c

RATE = 50_000.0  # Hz: at which every one of them is stable
PLAIN, STRONG = "cc -O3 -march=native", "cc, -DMASSES and 512-bit vectors"
CALLED = "cc -O3 -march=native, its scene behind a pointer"
SIDE = 32  # of the net

Advance = Callable[[int], None]
Forces = Callable[[NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Contest:
    """One object: hapsim's program and others for the same. `advance`: functions that simulate n samples, by name.

    `forces`: on a hand that moves as told, from rest, by who does it; none where there is no hand.
    """

    what: str
    advance: dict[str, Advance]
    forces: dict[str, Forces]


OURS = "hapsim"


def contests() -> Iterator[Contest]:
    """All of them."""
    for masses in (100, 1000):
        string = StringOfMasses.tuned(masses)
        yield _string_alone(string)
        yield _string_with_hand(string)
    yield _net()
    yield _one_spring()


def _string_alone(string: StringOfMasses) -> Contest:
    scene = _without_hand(scene_of(string, "cordis", "double", RATE))
    program, first = compile_scene(scene), numbers_of(scene)["string.0"]
    program.rows[:, first : first + string.masses] = string.plucked()
    rest, force = np.zeros((2, 1, scene.channels))
    start(program, rest[0])
    advance: dict[str, Advance] = {OURS: lambda samples: ticks(program, rest, rest, force, samples)}
    for name, plain in ((PLAIN, True), (STRONG, False)):
        run = CStencil(plain=plain).running(string, RATE)
        run.start_in(string.plucked())
        advance[name] = run.alone
    return Contest(f"string of {string.masses}", advance, {})


def _string_with_hand(string: StringOfMasses) -> Contest:
    scene = scene_of(string, "cordis", "double", RATE, *hand_link(string))
    advance: dict[str, Advance] = {OURS: Running(scene).advance}
    forces: dict[str, Forces] = {OURS: lambda motion: _forces_of(scene, motion)}
    for name, plain in ((PLAIN, True), (STRONG, False)):
        for table in (advance, forces):
            run = CStencil(hand=True, plain=plain).running(string, RATE)
            run.start_in(np.zeros(string.masses))
            run.hold(*hand_link(string))
            table[name] = run.with_hand if table is advance else run.run  # type: ignore[assignment]
    return Contest(f"string of {string.masses} with a hand", advance, forces)


def _net() -> Contest:
    """A square net of single masses, its corners held, a hand in the middle."""
    scene, network = net()
    advance: dict[str, Advance] = {OURS: Running(scene).advance}
    forces: dict[str, Forces] = {OURS: lambda motion: _forces_of(scene, motion)}
    for name, plain in ((PLAIN, True), (STRONG, False)):
        for table in (advance, forces):
            run = RunningNetwork(build_c("network.c", plain=plain).load(), network, RATE)
            table[name] = run.with_hand if table is advance else run.run  # type: ignore[assignment]
    return Contest(f"network of {network.mass.size} masses and {network.first.size} links", advance, forces)


def net(
    side: int = SIDE, mass: float = 1e-3, stiffness: float = 2000.0, damping: float = 0.01
) -> tuple[Scene, Network]:
    """The net as a scene of modules, and as numbers."""
    points = ["hand", "ground", *(f"m{i}" for i in range(side * side))]
    corners = (0, side - 1, side * (side - 1), side * side - 1)
    pairs = [("ground", f"m{i}") for i in corners]
    pairs += [(f"m{i}", f"m{i + 1}") for i in range(side * side) if (i + 1) % side]
    pairs += [(f"m{i}", f"m{i + side}") for i in range(side * (side - 1))]
    pairs.append(("hand", f"m{side * side // 2}"))
    links = {f"l{i}": ViscoElastic(between=pair, stiffness=stiffness, damping=damping) for i, pair in enumerate(pairs)}
    scene = Scene(
        version=1,
        rate=RATE,
        device=Device(clock="lockstep", mass=0.2),
        modules={"hand": DevicePoint(channel=0), "ground": Ground()}
        | {name: Mass(mass=mass) for name in points[2:]}
        | links,
    )
    number = {name: i for i, name in enumerate(points)}
    first, second = (np.array([number[pair[end]] for pair in pairs], np.uint32) for end in (0, 1))
    each = np.ones(len(pairs))
    return scene, Network(1, np.full(side * side, mass), first, second, stiffness * each, damping * each)


def _one_spring() -> Contest:
    scene = Scene(
        version=1,
        rate=RATE,
        device=Device(clock="lockstep", mass=0.2),
        modules={
            "hand": DevicePoint(channel=0),
            "wall": Ground(),
            "touch": ViscoElastic(between=("hand", "wall"), stiffness=2000.0, damping=5.0),
        },
    )
    advance: dict[str, Advance] = {OURS: Running(scene).advance}
    forces: dict[str, Forces] = {OURS: lambda motion: _forces_of(scene, motion)}
    for name, how, plain in ((PLAIN, "run", True), (STRONG, "run", False), (CALLED, "run_called", True)):
        advance[name] = CSpring(2000.0, 5.0, RATE, how, plain).advancing()
        forces[name] = CSpring(2000.0, 5.0, RATE, how, plain).run
    return Contest("one spring", advance, forces)


def _without_hand(scene: Scene) -> Scene:
    modules = {name: module for name, module in scene.modules.items() if name != "touch"}
    return Scene(version=1, rate=scene.rate, device=scene.device, modules=modules)


def _forces_of(scene: Scene, motion: NDArray[np.float64]) -> NDArray[np.float64]:
    program = compile_scene(scene)
    measured, velocity, force = np.zeros((3, motion.size, scene.channels))
    measured[:, 0] = motion
    start(program, np.zeros(scene.channels))
    ticks(program, measured, velocity, force, motion.size)
    forces: NDArray[np.float64] = force[:, 0]
    return forces
