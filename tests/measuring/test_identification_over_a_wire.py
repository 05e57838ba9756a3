"""What a slow wire makes the hand feel: predicted from bytes and baud, measured on a mock whose UART takes its time."""

from __future__ import annotations

from typing import Any

import pytest

import hapsim
from hapsim.prediction import predict, predict_on_wire
from hapsim.running import run
from hapsim.scene import Scene, parse_scene

RATE, CLOSE = 500.0, 4.0  # Hz; of the uncertainties that the identification states


def scene_over(baud: int, turnaround: float, hold: str = "zoh", sampling: str = "ideal", delay: float = 1.0) -> Scene:
    """A hand on a spring; 23 bytes an exchange, in virtual time."""
    return parse_scene(
        f"""
version: 1
rate: {RATE}
device: {{clock: lockstep, mass: 0.2, friction: 1.0, delay: {delay}, hold: {hold}, sampling: {sampling}}}
mock: {{initial: {{velocity: 0.1}}, baud: {baud}, turnaround: {turnaround}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: 300, damping: 8}}
"""
    )


@pytest.mark.parametrize(
    ("baud", "turnaround", "samples"),
    [
        (115200, 0.0, 1),  # 1.997 ms of 2 ms
        (115200, 4e-6, 2),  # 2.0005 ms
        (2_000_000, 0.0021, 2),
        (115200, 0.0022, 3),
        (115000, 0.0, 2),  # 23 bytes take as long as a sample: a force that comes with the tick is late
    ],
)
@pytest.mark.parametrize("kind", [{}, {"hold": "impulse", "sampling": "average", "delay": 0.37}])
def test_the_hand_feels_what_is_predicted_for_the_delay_that_the_wire_costs(
    baud: int, turnaround: float, samples: int, kind: dict[str, Any]
) -> None:
    scene = scene_over(baud, turnaround, **kind)
    declared = predict(scene)
    assert declared.wire_time.delay_samples == samples
    predicted = predict_on_wire(scene) or declared
    measured = hapsim.measure(scene)
    assert measured.k == pytest.approx(predicted.k, abs=CLOSE * measured.k_uncertainty)
    assert measured.b == pytest.approx(predicted.b, abs=CLOSE * measured.b_uncertainty)
    if samples > 1:  # and the two delays are far apart
        assert abs(predicted.k - declared.k) > 1e4 * measured.k_uncertainty


def test_over_a_slow_wire_every_deadline_is_missed_and_a_run_is_the_same_each_time() -> None:
    runs = [run(scene_over(115200, 0.0022), duration=0.4) for _ in range(2)]
    assert [trace.report.deadline_misses for trace in runs] == [199, 199]
    assert (runs[0].position_counts == runs[1].position_counts).all()
