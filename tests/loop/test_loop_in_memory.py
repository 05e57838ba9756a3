"""The mock in memory in real time: its simulation is that of virtual time to the bit, however late this machine wakes
up. The clock of the loop in Python follows a script; of the compiled loop no time is asserted."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from loop_rig import require_same, scene_of

import hapsim
from hapsim.device.open_connection import on_device
from hapsim.loop import clocks, portable
from hapsim.running import run
from hapsim.scene import parse_scene
from hapsim.scene.shipped import shipped_scene

PERIOD_NS = 1_000_000


class Clock:
    """Time passes only in sleeps. Each ends too late, by the next of these times."""

    def __init__(self, lateness_ns: Iterator[int]) -> None:
        self.ns, self.lateness_ns, self.sleeps = 10**12, lateness_ns, list[int]()

    def now_ns(self, _scratch: Any = None) -> int:
        return self.ns

    def sleep_until(self, deadline_ns: int, _scratch: Any) -> None:
        assert deadline_ns > self.ns
        self.sleeps.append(deadline_ns - self.ns)
        self.ns = deadline_ns + next(self.lateness_ns)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock(itertools.repeat(0))
    monkeypatch.setattr(clocks, "now_ns", made.now_ns)
    monkeypatch.setattr(clocks, "sleep_until", made.sleep_until)
    monkeypatch.setattr(portable, "time", SimpleNamespace(monotonic_ns=made.now_ns, sleep=time.sleep))
    return made


@pytest.mark.parametrize("clock_of_scene", ["device", "host", "lockstep"])
def test_whatever_this_machine_does_the_simulation_is_that_of_virtual_time(clock: Clock, clock_of_scene: str) -> None:
    """Late by less than a period, by a period, by more than the watchdog's 0.1 s and the silence's 0.25 s."""
    late = [0, PERIOD_NS - 1, 0, PERIOD_NS, 5 * PERIOD_NS, 150 * PERIOD_NS, 400 * PERIOD_NS]
    clock.lateness_ns = itertools.chain(late, itertools.repeat(0))
    scene = scene_of(damper="centred", device={"clock": clock_of_scene}, mock={"noise": 1e-6})
    trace = run(scene, duration=0.7, transport="paced", portable=True, judges_energy=True)
    report = trace.report
    assert report.ending == "done"
    assert 100 < report.ticks < 300  # a duration is one of this machine's clock
    require_same(trace, run(on_device(scene, "paced"), duration=report.ticks / scene.rate))
    assert report.deadline_misses == sum(one >= PERIOD_NS for one in late)
    assert (report.withheld_forces, report.stale_positions, report.age_samples.max) == (0, 0, 1)
    assert report.lateness_s.max == pytest.approx(0.4, rel=0.05)
    assert (report.virtual_time, report.released) == (False, True)


def test_a_tick_late_by_a_period_restarts_the_grid_and_another_keeps_it(clock: Clock) -> None:
    clock.lateness_ns = itertools.chain([300_000, 2_500_000], itertools.repeat(0))
    run(scene_of(device={"clock": "device"}), duration=0.006, transport="paced", portable=True)
    assert clock.sleeps[:4] == [PERIOD_NS, 700_000, PERIOD_NS, PERIOD_NS]


def test_the_compiled_loop_too_has_the_simulation_of_virtual_time_on_a_slow_wire() -> None:
    """The mock's UART delays forces by whole samples, as in virtual time."""
    scene = scene_of(2, rate=2000.0, device={"clock": "device", "delay": 1.5}, mock={"baud": 500_000, "noise": 1e-6})
    trace = run(scene, duration=0.05, transport="paced")
    assert (trace.report.ending, trace.report.virtual_time) == ("done", False)
    assert trace.statistics.lateness.total == trace.report.ticks > 1
    require_same(trace, run(on_device(scene, "paced"), duration=trace.report.ticks / scene.rate))


def test_what_is_felt_in_real_time_is_what_is_felt_in_virtual_time(clock: Clock) -> None:
    clock.lateness_ns = itertools.chain([0, 200_000, 3_000_000] * 12, itertools.repeat(0))
    scene = parse_scene(shipped_scene("first_touch"), "first_touch")
    here = hapsim.measure(scene, transport="paced", portable=True, duration=1.0)
    virtual = hapsim.measure(on_device(scene, "paced"), duration=1.0)
    assert (here.k, here.b) == (virtual.k, virtual.b)


def test_a_running_scene_takes_a_file_with_the_clock_and_port_that_it_was_started_without() -> None:
    scene = scene_of(device={"clock": "device"})
    softer = scene_of(stiffness=300.0, device={"clock": "device", "port": "/dev/ttyACM0"})
    with hapsim.start(scene, transport="paced") as session:
        session.adopt(softer)
        assert session.scene.links["touch0"].stiffness == 300.0  # type: ignore[attr-defined]
    assert session.trace.report.ending == "stopped"
