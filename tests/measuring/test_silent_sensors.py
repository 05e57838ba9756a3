"""A sensor that is dead but answers: what pushes a device names it, and moves the handle no farther than it may."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from identification import Device

import hapsim
from hapsim.bringup.faults import Injector, parse_script
from hapsim.bringup.faults.in_memory import in_memory
from hapsim.errors import UsageError
from hapsim.measuring.measure import measure
from hapsim.measuring.measure_impedance import measure_impedance
from hapsim.running import run
from tests import one_hand

Run = Callable[..., hapsim.Trace]
WORDS = r"^the position has not changed by one count for \S+ s while force acts \(\S+ N at most\): sensor or cable\?"


def frozen(traces: list[hapsim.Trace]) -> Run:
    """Runs whose positions stand still from the first one on."""

    def run_frozen(scene: hapsim.Scene, **options: Any) -> hapsim.Trace:
        injector = Injector(parse_script("version: 1\nfaults: [{kind: freeze}]"))
        traces.append(run(scene, between=in_memory(injector, scene.period), **options))
        return traces[-1]

    return run_frozen


def farthest(traces: list[hapsim.Trace], mass: float) -> float:
    """Returns the largest displacement of a free mass by these forces, run after run, m."""
    force = np.concatenate([trace.force[:, 0] for trace in traces])
    speed = np.cumsum(force) / (mass * traces[0].rate)
    return float(np.abs(np.cumsum(speed) / traces[0].rate).max())


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("mass", "force", "travel"), [(2.0, 1.0, 2e-4), (0.05, 10.0, 0.005)])
def test_identify_moves_the_handle_within_its_travel(mass: float, force: float, travel: float) -> None:
    traces: list[hapsim.Trace] = []
    scene = Device(1000.0, mass, 1.0, 0.0, 1.0, 0.0).scene()
    with pytest.raises(UsageError, match=WORDS):
        hapsim.identify_device(scene, force=force, travel=travel, run=frozen(traces))
    assert 0.0 < farthest(traces, mass) < travel


@pytest.mark.parametrize("way", ["measure", pytest.param("impedance", marks=pytest.mark.thorough)])
def test_measure_names_the_sensor_and_does_not_push_harder(way: str) -> None:
    traces: list[hapsim.Trace] = []
    scene = one_hand.scene_of({"touch": one_hand.touch(500.0, 2.0)})
    measures = {"measure": measure, "impedance": measure_impedance}
    with pytest.raises(UsageError, match=WORDS):
        measures[way](scene, run=frozen(traces))
    assert len(traces) == 1
