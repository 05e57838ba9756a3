"""Links that are straight between knots: what they do while their numbers move, and one of a type that hapsim does not
ship, which is a class and nothing else."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest
from pydantic import Field

from firmware_protocol.compiled import new_record
from hapsim.cordis.offline import start, tick, update_parameters
from hapsim.cordis.program import Program, compile_scene, parameter_values, positions_of
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
from hapsim.laws import Law
from hapsim.scene import Scene
from hapsim.scene.modules import Link
from hapsim.scene.quantity import quantity
from hapsim.scene.section import Table

sys.path.insert(0, str(Path(__file__).parent))
from tests.link_formulas import tension_of

RATE, RAMP = 1000.0, 50


def scene_of(link: Any) -> Scene:
    """A hand on this link: a document, or a module of a type that no document can have."""
    spring = {"type": "spring", "between": ("hand", "wall"), "stiffness": 1.0}
    own = isinstance(link, Link)
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "it": spring if own else link}
    device = {"mass": 0.2, "friction": 1.0}
    scene = Scene.model_validate({"version": 1, "rate": RATE, "device": device, "modules": modules})
    return scene.model_copy(update={"modules": Table(dict(scene.modules) | {"it": link})}) if own else scene


def changed_while_it_moves(before: Any, after: Any, d: np.ndarray, at: int) -> np.ndarray:
    """The tension at every sample; from sample `at` on the link becomes another over RAMP samples."""
    program, force = compile_scene(scene_of(before)), np.zeros((len(d), 1))
    start(program, d[:1])
    for n in range(len(d)):
        if n == at:
            program.parameters.post(parameter_values(scene_of(after)), RAMP)
        update_parameters(program)
        tick(program, d[n : n + 1], np.zeros(1), force[n])
    return -force[:, 0]


Values = dict[str, float]

LINKS: dict[str, tuple[dict[str, Any], Values, Values]] = {
    "buffer": (
        {"type": "buffer"},
        {"stiffness": 900.0, "damping": 0.4, "distance": 0.004},
        {"stiffness": 200.0, "damping": 0.9, "distance": -0.003},
    ),
    "snap": (
        {"type": "detent", "shape": "snap"},
        {"pitch": 0.011, "depth": 0.7, "damping": 0.1, "sharpness": 3.0},
        {"pitch": 0.007, "depth": 0.2, "damping": 0.3, "sharpness": 3.0},
    ),
    "notch": (
        {"type": "detent", "shape": "notch"},
        {"pitch": 0.011, "depth": 0.7, "damping": 0.1, "sharpness": 1.0},
        {"pitch": 0.019, "depth": 0.9, "damping": 0.0, "sharpness": 1.0},
    ),
    "click": (
        {"type": "click"},
        {"travel": 0.011, "peak": 0.7, "drop": 0.3, "bottom": 900.0, "damping": 0.1},
        {"travel": 0.016, "peak": 0.5, "drop": 1.1, "bottom": 3000.0, "damping": 0.2},
    ),
}
"""Links by name: constant values, values before, values after."""


def link_with(name: str, values: Values) -> dict[str, Any]:
    return {**LINKS[name][0], "between": ("hand", "wall"), **values}


def hand(seed: int, samples: int = 400) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 0.02 * np.sin(np.cumsum(rng.normal(0.05, 0.2, samples)))


@pytest.mark.parametrize("name", LINKS)
def test_while_it_ramps_a_link_is_the_one_with_the_parameters_between(name: str) -> None:
    _, before, after = LINKS[name]
    d, at = hand(3), 150
    found = changed_while_it_moves(link_with(name, before), link_with(name, after), d, at)
    s = np.clip((np.arange(len(d)) - at + 1) / RAMP, 0.0, 1.0)
    shares = s * s * (3.0 - 2.0 * s)
    between = [{key: before[key] + share * (after[key] - before[key]) for key in before} for share in shares]
    link = scene_of(link_with(name, before)).links["it"]
    expected = [
        tension_of(link.model_copy(update=values), RATE)(*now)
        for values, *now in zip(between, d, np.diff(d, prepend=d[0]), strict=True)
    ]
    assert np.abs(found - expected).max() <= 1e-13 * np.abs(expected).max()
    assert np.count_nonzero(expected[at : at + RAMP]) > RAMP / 4


@pytest.mark.parametrize("shape", ["snap", "notch"])
def test_while_its_sharpness_ramps_a_detent_is_a_detent(shape: str) -> None:
    """The knots of a detent move in straight lines during a ramp, so it keeps its depth and its rest positions."""
    values = LINKS[shape][1] | {"damping": 0.0}
    before, after = (link_with(shape, values | {"sharpness": sharpness}) for sharpness in (1.0, 4.0))
    pitch, depth = values["pitch"], values["depth"]
    for share in (0.0, 0.3, 1.0):
        here, there = (parameter_values(scene_of(link)) for link in (before, after))
        program, force = compile_scene(scene_of(before)), np.zeros(1)
        program.parameters.post(here + share * (there - here), 1)
        d = np.linspace(-2.0 * pitch, 2.0 * pitch, 1601)
        tension = np.zeros_like(d)
        for n, x in enumerate(d):
            start(program, np.array([x]))
            update_parameters(program)
            tick(program, np.array([x]), np.zeros(1), force)
            tension[n] = -force[0]
        assert np.abs(tension).max() == pytest.approx(depth, rel=0.05)
        assert np.abs(tension).max() <= depth * (1.0 + 1e-12)
        np.testing.assert_allclose(tension[::400], 0.0, atol=1e-13)
        np.testing.assert_allclose(tension, -tension[::-1], atol=1e-12)
        np.testing.assert_allclose(tension[400:], tension[:-400], atol=1e-11)


def test_a_curve_of_many_points_is_found_in_and_beyond_it() -> None:
    rng = np.random.default_rng(5)
    for points in (2, 3, 8, 9, 10, 333):
        at = np.sort(rng.uniform(-0.02, 0.02, points))
        curve = np.column_stack([at, rng.normal(size=points)])
        d = rng.permutation(np.concatenate([at, rng.uniform(-0.03, 0.03, 200)]))
        link = {"type": "nonlinear", "between": ("hand", "wall"), "force_over_distance": curve.tolist()}
        found = changed_while_it_moves(link, link, d, 0)
        np.testing.assert_allclose(found, np.interp(d, *curve.T), rtol=0.0, atol=1e-12)


class Stops(Link):
    """A spring with play on both sides, of a type that hapsim does not ship."""

    has_table: ClassVar[bool] = True
    live: ClassVar[tuple[str, ...]] = ("stiffness", "play")

    type: Literal["stops"] = Field(default="stops", description="Stops")
    stiffness: Annotated[float, quantity("Stiffness", "N/m", least=0)]
    play: Annotated[float, quantity("Half of it", "m", least=0)]

    def law(self) -> Law:
        knots, states = ((-self.play, 0.0), (self.play, 0.0)), ("left", "free", "right")
        return Law(knots, (0.0,) * 3, states, below=self.stiffness, beyond=self.stiffness, taken_at=1.0)


def stops(stiffness: float, play: float) -> Stops:
    return Stops(between=("hand", "wall"), stiffness=stiffness, play=play)


def energy(program: Program) -> float:
    addresses = [np.uint64(row.ctypes.data) for row in positions_of(program)]
    return float(evaluate(np.uint64(program.record.parameters.stored), *addresses, np.uint64(0)))


@pytest.mark.parametrize(("d", "most", "joules"), [(0.003, 9.0, 0.0), (0.006, 9.0, 8e-4), (-0.104, 10.0, 0.875)])
def test_what_it_stores_is_read_from_its_knots_and_from_no_more_than_the_limit_of_force(
    d: float, most: float, joules: float
) -> None:
    scene = scene_of(stops(400.0, 0.004))
    program, record = compile_scene(scene), new_record(TANK)
    program.stored = StoredEnergy(program, scene, Tank(record, capacity_j=1.0, refill_j=0.0), most)
    start(program, np.array([d]))
    assert energy(program) == pytest.approx(joules, rel=1e-12, abs=1e-15)


def test_two_tables_of_one_link_have_places_of_their_own() -> None:
    """Else energy and ramps of one would read the other's knots."""
    curve = ((-1.0, -1.0), (1.0, 1.0))
    link = {
        "type": "nonlinear",
        "between": ("hand", "wall"),
        "force_over_distance": curve,
        "force_over_velocity": curve,
    }
    program = compile_scene(scene_of(link))
    assert len(program.places) == program.parameters.values.size
