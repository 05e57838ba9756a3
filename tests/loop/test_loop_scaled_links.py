"""The energy guard before links with a gain: it counts what an unequal share gives and takes, and no more."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from loop_rig import POSITION_SCALE, alike, frame, scripted

from hapsim import measure_hands
from hapsim.errors import GuardError, UsageError
from hapsim.loop.guards import energy_guard
from hapsim.prediction import predict
from hapsim.prediction.virtual_coupling import virtual_couplings
from hapsim.running import run, start
from hapsim.scene import Scene

SAMPLES, TURNS, WAY = 1000, 10, 0.01
TWO_CHANNELS: Any = alike(2, force_limit=50.0)


def tied(gain: float, stiffness: float = 1000.0, **device: Any) -> Scene:
    values = {"mass": 0.2, "friction": 5.0, "clock": "lockstep", "force_limit": 50.0, **device}
    hands = {name: {"type": "device", "channel": i} for i, name in enumerate("ab")}
    tie = {
        "type": "viscoelastic",
        "between": ["a", "b"],
        "stiffness": stiffness,
        "damping": 2.0,
        "gain": {"force": gain},
    }
    mock = {"initial": {"velocity": [0.1, 0.0]}}
    document = {"version": 1, "rate": 1000, "device": values, "mock": mock, "modules": hands | {"tie": tie}}
    return Scene.model_validate(document)


def turning(way: float) -> list[bytes]:
    """Both hands in circles, the second a quarter turn ahead (`way` 1) or behind (-1): a turn at a gain g gives the
    hands (g - 1) K A² pi times that."""
    phase = 2.0 * math.pi * TURNS / SAMPLES * np.arange(SAMPLES)
    both = WAY * np.column_stack([1.0 - np.cos(phase), way * np.sin(phase)])
    return [frame(n, *row) for n, row in enumerate(np.rint(both / POSITION_SCALE).astype(int).tolist())]


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("gain", [0.2, 3.0])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_hands_that_a_gain_gives_energy_run_on_and_without_its_weight_are_stopped(
    monkeypatch: pytest.MonkeyPatch, gain: float, way: float
) -> None:
    scene = tied(gain, energy_limit=0.2)
    given = -way * (gain - 1.0) * 1000.0 * WAY**2 * math.pi * TURNS
    with scripted(turning(way), scene, **TWO_CHANNELS) as (on_port, _), start(on_port, duration=1.0) as session:
        session.wait()
        energy = session._loop.record.energy_guard
        assert energy.weight[:2].tolist() == [max(1.0, gain), max(1.0, 1.0 / gain)]
        assert energy.given[energy_guard.SCENE] <= 0.0
    monkeypatch.setattr(energy_guard, "energy_weights", lambda _: {})
    with scripted(turning(way), scene, **TWO_CHANNELS) as (on_port, _):
        if given < 0.0:
            run(on_port, duration=1.0)
        else:
            with pytest.raises(GuardError, match="the scene had given the hand"):
                run(on_port, duration=1.0)


def test_a_link_with_a_gain_that_is_too_stiff_is_stopped() -> None:
    scene = tied(0.2, 400_000.0, energy_limit=0.05, friction=1.0)
    assert not predict(scene).stable
    with pytest.raises(GuardError):
        run(scene, duration=2.0, unstable=True, judges_energy=True)


def test_two_hands_on_a_link_with_a_gain_are_measured_as_predicted() -> None:
    scene = tied(0.2)
    found, predicted = measure_hands(scene, channels=[0, 1], duration=1.0), predict(scene).parts[0].felt
    np.testing.assert_allclose(found.k, predicted.k, rtol=1e-4)
    np.testing.assert_allclose(found.b, predicted.b, rtol=1e-3)
    assert found.k[1, 0] == pytest.approx(0.2 * found.k[0, 1], rel=1e-4)


def test_what_cannot_have_a_scale_refuses_it() -> None:
    with pytest.raises(UsageError, match=r"tie\.gain: found a gain, expected none: no proxy can stand at such a link"):
        virtual_couplings(tied(0.2))
    both = tied(0.2).document
    both["device"]["motion"], both["modules"]["tie"]["ratio"] = ["linear", "rotary"], 0.03
    with pytest.raises(UsageError, match="found linear and rotary hands, expected hands of one motion"):
        measure_hands(Scene.model_validate(both), channels=[0, 1])
