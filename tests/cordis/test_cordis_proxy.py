"""A proxy in the kernel, beside its equation with the tensions of `link_formulas.py`, solved by bisection."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, take_over, tick, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values, positions_of
from hapsim.cordis.succession import take_over_from
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from link_formulas import tension_of

Floats = np.ndarray[Any, Any]
RATE = 1000.0
CUP: dict[str, Any] = {"type": "proxy", "mass": 0.02, "hand": "hand", "stiffness": 769.8, "damping": 0.28}
LINKS: dict[str, dict[str, Any]] = {
    "spring": {"stiffness": 900.0},
    "damper": {"damping": 3.0},
    "viscoelastic": {"stiffness": 900.0, "damping": 2.0},
    "buffer": {"stiffness": 5000.0, "damping": 8.0, "distance": 0.001},
    "nonlinear": {"force_over_distance": [[-0.01, -9.0], [-0.003, -1.0], [0.002, 0.0], [0.006, 6.0], [0.009, 2.0]]},
    "snap": {"type": "detent", "pitch": 0.004, "depth": 1.5, "damping": 0.4, "shape": "snap", "sharpness": 3.0},
    "notch": {"type": "detent", "pitch": 0.006, "depth": 1.5, "damping": 0.4, "shape": "notch"},
    "click": {"travel": 0.008, "peak": 1.5, "drop": 0.8, "bottom": 5000.0, "damping": 2.0},
}


def scene_of(modules: dict[str, dict[str, Any]], **more: Any) -> Scene:
    always = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground", "position": 0.001}}
    document = {"version": 1, "rate": RATE, "device": {"mass": 0.2}, "modules": always | modules}
    return Scene.model_validate(document | more)


def link(name: str, between: tuple[str, str], **more: Any) -> dict[str, Any]:
    return {"type": name, "between": between} | LINKS[name] | more


def swing(samples: int, width: float = 0.02) -> Floats:
    """Positions of a hand that swings, faster and slower, m."""
    n = np.arange(samples)
    return np.asarray(width * np.sin(0.03 * n + 2.0 * np.sin(0.01 * n)) + 0.3 * width * np.sin(0.3 * n))


def played(program: Program, hand: Floats, begins: bool = True) -> tuple[Floats, dict[str, Floats]]:
    """Forces on the hand, N, and the positions of the scene's points, m."""
    if begins:
        start(program, hand[:1])
    force, points = np.zeros((hand.size, 1)), np.zeros((hand.size, len(program.numbers)))
    for n, at in enumerate(hand):
        update_parameters(program)
        tick(program, np.array([at]), np.zeros(1), force[n])
        points[n] = positions_of(program)[1][list(program.numbers.values())]
    return force[:, 0], dict(zip(program.numbers, points.T, strict=True))


class WorkedOut:
    """A proxy, whose links end on grounds, hands and explicit masses."""

    def __init__(self, scene: Scene, hand: float) -> None:
        self.scene, self.cup = scene, scene.proxies["cup"]
        self.tensions = {name: tension_of(one, RATE) for name, one in scene.links_at_proxies.items()}
        begins = {name: point.start() for name, point in scene.material_points.items()}
        fixed = {name: ground.position for name, ground in scene.grounds.items()} | {"hand": hand}
        self.here = fixed | {name: position for name, (position, _) in begins.items()}
        self.last = fixed | {name: position - velocity / RATE for name, (position, velocity) in begins.items()}
        self.older = self.last["cup"] - begins["cup"][1] / RATE

    def pull(self, name: str, x: float) -> float:
        """Tension of a link with the proxy at x."""
        first, second = self.scene.links[name].between
        now = self.here | {"cup": x}
        d = now[first] - now[second]
        return float(self.tensions[name](d, d - (self.last[first] - self.last[second])))

    def coupling(self, x: float) -> float:
        d = self.here["hand"] - x
        return self.cup.stiffness * d + self.cup.damping * RATE * (d - (self.last["hand"] - self.last["cup"]))

    def on(self, point: str, pulls: dict[str, float]) -> float:
        """Force on a point."""
        ends = {name: self.scene.links[name].between for name in pulls}
        return sum(pull * (ends[name].index(point) * 2 - 1) for name, pull in pulls.items() if point in ends[name])

    def excess(self, x: float) -> float:
        inertia = self.cup.mass * RATE**2 * (x - 2.0 * self.last["cup"] + self.older)
        return inertia - self.coupling(x) - self.on("cup", {name: self.pull(name, x) for name in self.tensions})

    def tick(self, hand: float) -> tuple[float, float]:
        """Returns the force on the hand and the proxy's position."""
        self.here["hand"] = hand
        low, high = -0.1, 0.1
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (low, middle) if self.excess(middle) > 0.0 else (middle, high)
        share = self.excess(low) / (self.excess(low) - self.excess(high))
        pulls = {name: (1.0 - share) * self.pull(name, low) + share * self.pull(name, high) for name in self.tensions}
        force, following = self.on("hand", pulls) - self.coupling(low), {}
        for name, one in self.scene.masses.items():
            step = self.here[name] - self.last[name] + self.on(name, pulls) / (one.mass * RATE**2)
            following[name] = self.here[name] + step
        self.older, self.here["cup"] = self.last["cup"], low
        self.last = dict(self.here)
        self.here |= following
        return force, low


def compare(scene: Scene, hand: Floats, within: float) -> tuple[Floats, dict[str, Floats]]:
    force, points = played(compile_scene(scene), hand)
    written = WorkedOut(scene, hand[0])
    expected_force, expected = np.array([written.tick(at) for at in hand]).T
    np.testing.assert_allclose(points["cup"], expected, rtol=0, atol=within * np.abs(hand).max())
    np.testing.assert_allclose(force, expected_force, rtol=0, atol=within * np.abs(force).max())
    return force, points


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize("precision", ["double", "single"])
@pytest.mark.parametrize("between", [("cup", "wall"), ("wall", "cup"), ("ball", "cup"), ("hand", "cup")])
@pytest.mark.parametrize("name", LINKS)
def test_every_kind_of_link_at_a_proxy(name: str, between: tuple[str, str], precision: str) -> None:
    modules = {"cup": CUP | {"position": 0.002, "velocity": 0.1}, "link": link(name, between)}
    if "ball" in between:
        modules["ball"] = {"type": "mass", "mass": 0.05, "position": 0.004, "velocity": -0.05}
    # In single precision a mass that a curve holds at a corner leaves the double one soon.
    samples, within = (150, 1e-9) if precision == "double" else (100, 3e-3)
    force, _ = compare(scene_of(modules, precision=precision), swing(samples), within)
    assert np.abs(force).max() > 1.0


@pytest.mark.thorough
def test_many_links_at_two_proxies_of_two_hands() -> None:
    """Each proxy is solved by itself: as if the other were not there."""
    links = {name: link(name, ("cup", "wall")) for name in ("viscoelastic", "buffer", "nonlinear", "click")}
    one = scene_of({"cup": CUP, **links})
    other = {"thumb": {"type": "device", "channel": 1}, "cup2": CUP | {"hand": "thumb", "mass": 0.05}}
    other["stop"] = link("buffer", ("cup2", "wall"))
    both = compile_scene(scene_of({**other, "cup": CUP, **links}))
    hand = swing(500)
    force, _ = compare(one, hand, 1e-9)
    start(both, np.array([hand[0], 0.0]))
    two = np.zeros((hand.size, 2))
    for n, at in enumerate(hand):
        tick(both, np.array([at, -at]), np.zeros(2), two[n])
    np.testing.assert_allclose(two[:, 0], force, rtol=0, atol=1e-12 * np.abs(force).max())
    assert np.abs(two[:, 1]).max() > 1.0


def test_where_a_damper_begins_a_proxy_may_rest_on_the_edge() -> None:
    """The damper would push it out of the contact, and the coupling pulls it in: it stops at the edge itself. The mass
    on the other side feels a force between."""
    stop = link("buffer", ("cup", "ball"), damping=200.0, stiffness=1.0)
    modules = {"cup": CUP | {"mass": 1e-5}, "ball": {"type": "mass", "mass": 0.05, "position": 0.001}, "stop": stop}
    _, points = compare(scene_of(modules), np.linspace(0.01, -0.01, 400), 1e-9)
    stays = np.flatnonzero(np.abs(points["cup"] - points["ball"] - 0.001) < 1e-15)
    assert stays.size >= 1
    assert points["ball"][-1] < 0.0


def test_a_pick_up_of_its_force_reads_mass_times_acceleration() -> None:
    modules = {"cup": CUP, "link": link("viscoelastic", ("cup", "wall"))}
    program, hand = compile_scene(scene_of(modules, sound={"ear": {"from": "cup", "of": "force"}})), swing(100)
    start(program, hand[:1])
    read, force, cup = [], np.zeros(1), [0.0, 0.0]
    for at in hand:
        tick(program, np.array([at]), np.zeros(1), force)
        read.append(program.pick_up_values[0])
        cup.append(positions_of(program)[1][program.numbers["cup"]])
    expected = CUP["mass"] * RATE**2 * np.diff(cup, 2)
    np.testing.assert_allclose(read, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_no_energy_comes_from_a_proxy() -> None:
    """A hand gets back at most what it gave, however it moves: contacts, springs and the coupling store and lose."""
    links = {name: link(name, ("cup", "wall")) for name in ("viscoelastic", "buffer")}
    program = compile_scene(scene_of({"cup": CUP, **links}))
    hand = np.cumsum(np.random.default_rng(3).normal(0.0, 1e-3, 5000))
    force, _ = played(program, hand)
    given = -np.cumsum(force[1:] * np.diff(hand))
    assert given.min() > -1e-12
    assert given[-1] > 1.0


@pytest.mark.parametrize(
    "changed",
    [
        {"cup": {"stiffness": 300.0, "damping": 1.0}},
        {"link": {"stiffness": 300.0, "damping": 0.5}},
        {"stop": {"distance": 0.004, "stiffness": 900.0}},
        {"wall": {"position": 0.003}},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_live_values_at_a_proxy_change_its_force(changed: dict[str, dict[str, Any]]) -> None:
    modules = {"cup": CUP, "wall": {"type": "ground"}, "link": link("viscoelastic", ("cup", "wall"))}
    modules |= {"stop": link("buffer", ("cup", "wall")), "curve": link("nonlinear", ("cup", "wall"))}
    before, after = scene_of(modules), scene_of({name: one | changed.get(name, {}) for name, one in modules.items()})
    program, rest = compile_scene(before), np.zeros(3000)
    rest += 0.008
    played(program, rest)
    program.parameters.post(parameter_values(after), 100)
    force, points = played(program, rest, begins=False)
    expected, places = played(compile_scene(after), rest)
    assert force[-1] == pytest.approx(expected[-1], rel=1e-9)
    assert points["cup"][-1] == pytest.approx(places["cup"][-1], rel=1e-9)
    assert abs(force[-1] - force[0]) > 0.1


def test_a_proxy_goes_on_when_another_program_takes_over() -> None:
    modules = {"cup": CUP, "link": link("viscoelastic", ("cup", "wall")), "stop": link("buffer", ("cup", "wall"))}
    before, after = scene_of(modules), scene_of(modules | {"idle": {"type": "mass", "mass": 1.0}})
    hand = swing(300)
    force, _ = played(compile_scene(before), hand)
    older, program = compile_scene(before), compile_scene(after)
    played(older, hand[:137])
    take_over_from(older, before, program, after)
    take_over(older, program, hand[136:137])
    found, _ = played(program, hand[137:], begins=False)
    np.testing.assert_allclose(found[1:], force[138:], rtol=1e-12)
