"""The loop in plain Python: the same forces as the compiled one, and the same ways out."""

from __future__ import annotations

import numpy as np
import pytest
from loop_rig import scene_of

import hapsim
from hapsim.running import Excitation, run


@pytest.mark.parametrize("channels", [1, 4])
def test_the_portable_loop_sends_the_forces_of_the_compiled_one(channels: int) -> None:
    push = Excitation(channel=0, force=1.0, ticks=3, every=40, start=10, first=True)
    scene = scene_of(channels, damper="centred", mock={"noise": 1e-6})
    compiled = run(scene, duration=0.3, transport="terminal", excitation=push)
    portable = run(scene, duration=0.3, transport="terminal", excitation=push, portable=True)
    for name in ("sample", "flags", "position_counts", "force_counts", "asked_force"):
        np.testing.assert_array_equal(getattr(portable, name), getattr(compiled, name))
    assert portable.report.ending == "done"
    assert portable.report.crc_errors == 0
    assert portable.statistics.age == compiled.statistics.age


@pytest.mark.parametrize("clock", ["device", "host"])
def test_the_portable_loop_runs_in_real_time_by_either_clock(clock: str) -> None:
    """At a rate at which neither the device's watchdog nor the loop's patience ends within a second: a busy machine."""
    trace = run(scene_of(rate=10.0, device={"clock": clock}), duration=0.3, portable=True)
    report = trace.report
    assert report.ending == "done"
    assert report.ticks + report.lost_frames >= 3 or report.duration_s > 0.3  # what ends a run, and nothing else
    assert trace.statistics.lateness.total > 0
    assert trace.statistics.exchange.total > 0


def test_its_parameters_are_live_too() -> None:
    with hapsim.start(scene_of(mock={"noise": 1e-4}), transport="terminal", portable=True) as session:
        session.set({"touch0": {"stiffness": 100.0, "damping": 0.0}}, over=0.005)
        taken = session._loop.program.record.parameters
        while not session.wait(0.01):
            if int(taken.sets) == 1 and int(taken.left) == 0:
                session.stop()
    trace = session.trace
    np.testing.assert_allclose(trace.asked_force[-1], -100.0 * trace.position[-1], rtol=1e-9)


def test_in_memory_it_sends_the_forces_of_the_compiled_one_too() -> None:
    compiled, portable = (run(scene_of(mock={"noise": 1e-6}), duration=0.1, portable=one) for one in (False, True))
    np.testing.assert_array_equal(portable.force_counts, compiled.force_counts)
    assert portable.report.virtual_time
