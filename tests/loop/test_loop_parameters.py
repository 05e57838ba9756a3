"""Live parameters: a change is taken whole, between two samples, and led there no faster than it was said."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest
from loop_rig import assembled, scene_of
from numpy.typing import NDArray

import hapsim
from hapsim.compiling import entry
from hapsim.cordis.program import parameter_values
from hapsim.cordis.substep_loop import move_scene
from hapsim.loop.posted import Mailbox
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.changes import LiveScene
from hapsim.scene import Scene

T = 1e-3
RNG = np.random.default_rng(4)


@entry
def one_sample(loop):
    """The loop's own way from one sample to the next, without a device."""
    move_scene(loop.slot, loop.io, 1)


def forces_at(loop: LoopMemory, positions: Iterable[float]) -> NDArray[np.float64]:
    """The force on the first hand while it goes through `positions`."""
    forces = []
    for position in positions:
        loop.record.io.measured[:] = position
        one_sample(loop.record)
        forces.append(float(loop.record.io.asked[0]))
    return np.array(forces)


@pytest.mark.parametrize("damper", ["backward", "centred"])
@pytest.mark.parametrize("samples", [1, 2, 7, 100])
def test_a_change_is_there_at_the_stated_time_and_begins_and_ends_without_a_kink(samples: int, damper: str) -> None:
    loop = assembled(scene_of(stiffness=1000.0, damping=0.0, damper=damper))
    still = forces_at(loop, [0.01] * 5)
    assert still[-1] == -10.0
    loop.program.parameters.post(parameter_values(scene_of(stiffness=400.0, damping=0.0, damper=damper)), samples)
    s = np.arange(1, samples + 1) / samples
    np.testing.assert_allclose(
        forces_at(loop, [0.01] * samples), -0.01 * (1000.0 - 600.0 * (3.0 * s**2 - 2.0 * s**3)), rtol=1e-12
    )
    assert forces_at(loop, [0.01] * 3).tolist() == [-4.0] * 3


@pytest.mark.parametrize(
    ("over", "samples"), [(0.0, 1), (1e-9, 1), (0.001, 1), (0.0011, 2), (0.02, 20), (0.0205, 21), (0.021, 21)]
)
def test_seconds_that_end_within_a_sample_last_until_its_end(over: float, samples: int) -> None:
    """At 1 kHz. Fewer samples would be faster than it was said; without any the change would never come."""
    scene = scene_of(stiffness=1000.0, damping=0.0)
    loop = assembled(scene)
    forces_at(loop, [0.01])
    live = LiveScene(scene, loop)
    live.set({"touch0": {"stiffness": 300.1}}, over)
    forces = forces_at(loop, [0.01] * (samples + 3))
    there = -300.1 * 0.01  # to the last digit
    assert forces[samples - 1 :].tolist() == [there] * 4
    assert there not in forces[: samples - 1]
    steps = np.diff(forces, prepend=-10.0)
    assert np.all(steps[:samples] > 0.0)
    assert steps.max() <= (10.0 + there) * 1.5 / samples * (1.0 + 1e-12) or samples == 1
    assert live.scene.links["touch0"].stiffness == 300.1  # type: ignore[attr-defined]


def test_a_change_that_comes_during_another_goes_on_from_where_the_values_are() -> None:
    loop = assembled(scene_of(stiffness=1000.0, damping=0.0))
    forces_at(loop, [0.01])
    loop.program.parameters.post(parameter_values(scene_of(stiffness=0.0, damping=0.0)), 10)
    half_way = forces_at(loop, [0.01] * 5)[-1]
    assert half_way == pytest.approx(-5.0)
    loop.program.parameters.post(parameter_values(scene_of(stiffness=2000.0, damping=0.0)), 4)
    s = np.arange(1, 5) / 4
    expected = half_way + (-20.0 - half_way) * (3.0 * s**2 - 2.0 * s**3)
    np.testing.assert_allclose(forces_at(loop, [0.01] * 4), expected, rtol=1e-12)


def test_a_ground_that_moves_is_felt_through_its_damper_and_then_stands_still() -> None:
    scene = scene_of(stiffness=1000.0, damping=2.0)
    wall = scene.modules["wall"].model_copy(update={"position": 0.005})
    there = scene.model_copy(update={"modules": {**scene.modules, "wall": wall}})
    loop = assembled(scene)
    forces_at(loop, [0.0, 0.0])
    loop.program.parameters.post(parameter_values(there), 10)
    s = np.arange(0, 11) / 10
    rest = 0.005 * (3.0 * s**2 - 2.0 * s**3)
    np.testing.assert_allclose(
        forces_at(loop, [0.0] * 10), 1000.0 * rest[1:] + 2.0 * np.diff(rest) / T, rtol=1e-12, atol=1e-15
    )
    assert forces_at(loop, [0.0] * 3).tolist() == [5.0] * 3


def two_hands(share: float) -> Scene:
    """All parameters on one line: where one hand's spring grows the other's shrinks."""
    scene = scene_of(2, mock={"noise": 1e-3})  # so that the hands always feel something
    touch = {
        "touch0": {"stiffness": 500.0 + 1000.0 * share, "damping": 1.0 + 2.0 * share},
        "touch1": {"stiffness": 1500.0 - 1000.0 * share, "damping": 3.0 - 2.0 * share},
    }
    modules = {n: m.model_copy(update=touch.get(n, {})) for n, m in scene.modules.items()}
    return scene.model_copy(update={"modules": modules})


def share_felt(trace: hapsim.recording.trace.Trace, channel: int, least: float) -> NDArray[np.float64]:
    """The share of `two_hands` that explains each tick's force; NaN where the hand hardly feels it."""
    d = trace.position[1:, channel]
    g = np.diff(trace.position[:, channel]) / T
    sign, stiffness, damping = (1.0, 500.0, 1.0) if channel == 0 else (-1.0, 1500.0, 3.0)
    slope = sign * (1000.0 * d + 2.0 * g)
    share = (-trace.asked_force[1:, channel] - stiffness * d - damping * g) / np.where(slope == 0.0, np.nan, slope)
    return np.where(np.abs(slope) > least, share, np.nan)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("samples", [1, 20])
def test_of_many_changes_no_tick_sees_half_of_one_or_jumps_further_than_stated(samples: int) -> None:
    origin = parameter_values(two_hands(0.0))
    way = parameter_values(two_hands(1.0)) - origin
    scene = two_hands(0.0)
    with hapsim.start(scene) as session:
        mailbox = Mailbox(session._loop.record.posted, lambda: True)
        for number, share in enumerate(RNG.uniform(0.0, 1.0, 1500)):
            session._loop.program.parameters.post(origin + share * way, samples, mailbox.add)
            mailbox.send()
            mailbox.wait()
            if number % 20 == 0:
                session.wait(1e-3)  # in which the loop gets to where it was led, undisturbed by the next
        session.stop()
    trace = session.trace
    assert trace.report.parameter_changes > 1000
    first, second = share_felt(trace, 0, 0.01), share_felt(trace, 1, 0.01)
    both = np.isfinite(first) & np.isfinite(second)
    assert both.sum() > 1000
    np.testing.assert_allclose(first[both], second[both], atol=1e-9)
    jumps = np.abs(np.diff(first))
    assert np.nanmax(jumps) <= min(1.0, 1.5 / samples) + 1e-9
    assert np.nanmax(jumps) > 0.5 * min(1.0, 1.5 / samples)  # the instrument sees jumps
