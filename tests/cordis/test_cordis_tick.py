"""The compiled tick, against the recurrence written out in NumPy with matrices."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, positions_of
from hapsim.scene import Scene, parse_scene

sys.path.insert(0, str(Path(__file__).parent))
from written import written_out

SAMPLES = 1500


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    """A few hands (on any channels), grounds and masses, and links between any of them."""
    channels = draw(st.lists(st.integers(0, 5), min_size=1, max_size=3, unique=True))
    modules: dict[str, Any] = {f"h{c}": {"type": "device", "channel": c} for c in channels}
    for i in range(draw(st.integers(0, 2))):
        modules[f"g{i}"] = {"type": "ground", "position": draw(st.floats(-0.1, 0.1))}
    for i in range(draw(st.integers(0, 4))):
        modules[f"m{i}"] = {
            "type": "mass",
            "mass": draw(st.floats(0.05, 1.0)),
            "position": draw(st.floats(-0.1, 0.1)),
            "velocity": draw(st.floats(-0.5, 0.5)),
        }
    names = draw(st.permutations(list(modules)))
    modules = {name: modules[name] for name in names}
    if len(names) > 1:
        pairs = st.lists(st.sampled_from(names), min_size=2, max_size=2, unique=True)
        pairs = pairs.filter(lambda pair: not pair[0][0] == pair[1][0] == "g")  # two grounds: the scene refuses it
        for i, pair in enumerate(draw(st.lists(pairs, max_size=8))):
            modules[f"l{i}"] = {
                "type": "viscoelastic",
                "between": list(pair),
                "stiffness": draw(st.floats(0, 3000)),
                "damping": draw(st.floats(0, 5)),
            }
    document = {"version": 1, "rate": 1000, "device": {"mass": 0.2}, "modules": modules}
    return parse_scene(yaml.safe_dump(document, sort_keys=False))


def by_matrices(scene: Scene, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the channels and positions of the masses, sample by sample: F = -K x - Z (x - x_before)."""
    written = written_out(scene)
    hands, masses = written.places(list(scene.device_points)), written.places(list(scene.masses))
    channels = [hand.channel for hand in scene.device_points.values()]
    x = written.rest.copy()
    x[hands] = measured[0, channels]
    before = x.copy()
    before[masses] -= [mass.velocity / scene.rate for mass in scene.masses.values()]
    forces, positions = np.zeros_like(measured), np.zeros((len(measured), len(masses)))
    for n in range(len(measured)):
        x[hands] = measured[n, channels]
        following, force = written.follow(x, before)
        before, x = x, following
        positions[n], forces[n, channels] = x[masses], force[hands]
    return forces, positions


def by_the_tick(scene: Scene, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    program = compile_scene(scene)
    start(program, measured[0])
    first = len(scene.device_points) + len(scene.grounds)
    forces, positions = np.zeros_like(measured), np.zeros((len(measured), len(scene.masses)))
    for n in range(len(measured)):
        tick(program, measured[n], np.zeros(measured.shape[1]), forces[n])
        positions[n] = positions_of(program)[0][first : first + len(scene.masses)]
    return forces, positions


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scene=scenes(), seed=st.integers(0, 2**32 - 1))
def test_the_tick_is_the_recurrence_of_the_paper(scene: Scene, seed: int) -> None:
    steps = np.random.default_rng(seed).normal(0.0, 1e-4, (SAMPLES, scene.channels))
    measured = 0.05 * np.sin(np.cumsum(steps, axis=0))
    forces, positions = by_the_tick(scene, measured)
    expected_forces, expected_positions = by_matrices(scene, measured)
    # Rounding is measured against what a force is made of: stiffness times position.
    position_size = max(1.0, float(np.max(np.abs(expected_positions), initial=0.0)))
    stiffness = sum(link.stiffness + link.damping * scene.rate for link in scene.links.values())
    assert np.max(np.abs(positions - expected_positions), initial=0.0) <= 1e-12 * position_size * SAMPLES**0.5
    assert np.max(np.abs(forces - expected_forces)) <= 1e-12 * max(1.0, stiffness * position_size)


def test_a_channel_without_a_hand_gets_no_force() -> None:
    scene = parse_scene(
        "{version: 1, rate: 1000, device: {mass: 1}, modules: {hand: {type: device, channel: 2}, "
        "wall: {type: ground}, touch: {type: viscoelastic, between: [wall, hand], stiffness: 100}}}"
    )
    forces, _ = by_the_tick(scene, np.full((10, 3), 0.01))
    np.testing.assert_allclose(forces, np.tile([0.0, 0.0, -1.0], (10, 1)), rtol=1e-15)


def test_the_first_tick_feels_no_jump() -> None:
    """The hand is somewhere when the run begins: at rest there, not arrived from the origin within one sample."""
    scene = parse_scene(
        "{version: 1, rate: 1000, device: {mass: 1}, modules: {hand: {type: device, channel: 0}, "
        "wall: {type: ground}, touch: {type: viscoelastic, between: [hand, wall], stiffness: 0, damping: 5}}}"
    )
    forces, _ = by_the_tick(scene, np.array([[0.01], [0.011]]))
    np.testing.assert_allclose(forces[:, 0], [0.0, -5.0], rtol=1e-12, atol=1e-12)
