"""A device that samples at another rate than it declares: what the hand then feels, and the guard that ends it.

The loop makes a damper's force with the rate that was declared, B/T; at half the rate the positions are twice as far
apart, and the damping is 2 B. Every delay lasts twice as long. Both are the theory with the true rate and 2 B.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import address_of
from hapsim.device.connection import Connection
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.wire import loopback_transport
from hapsim.errors import GuardError
from hapsim.loop.endings import RECEIVED
from hapsim.loop.guards import in_words
from hapsim.loop.guards.rate import MOST_OFF, WATCH, WINDOW_NS, WINDOW_SAMPLES, WINDOWS, judge_rate
from hapsim.loop.hooks import TICK, call_hook
from hapsim.measuring.measure_trace import measure_trace
from hapsim.running import run
from hapsim.running import session as session_module
from hapsim.running.outcome import failure_of, report_of
from hapsim.scene import Scene
from hapsim.theory import Configuration
from tests.loop.loop_rig import arrive, assembled, frame

sys.path.insert(0, str(Path(__file__).parent))
from hands import RATE, hand_scene, spring

MASS, FRICTION = 0.2, 1.0


def mistaken_mock(scene: Scene, ratio: float) -> Any:
    """A mock that declares the scene's rate and samples at `ratio` times that."""
    mock = assemble_mock(scene)
    mock.converters["period"] /= ratio
    return mock


def scene_of(K: float, B: float, **device: Any) -> Scene:
    return hand_scene(
        {"touch": spring(K, B)},
        device={"mass": MASS, "friction": FRICTION, "delay": 1.0, "force_limit": 100.0, **device},
        mock={"initial": {"velocity": 0.1}},
    )


@pytest.fixture
def at_half_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs in virtual time meet a mock that samples at half the rate."""

    @contextlib.contextmanager
    def half(scene: Scene, *_: Any, **__: Any) -> Iterator[Connection]:
        yield Connection(loopback_transport(mistaken_mock(scene, 0.5)), "half", close=lambda: None)

    monkeypatch.setattr(session_module, "open_connection", half)


@pytest.mark.usefixtures("at_half_the_rate")
@pytest.mark.parametrize(("K", "B"), [(500.0, 2.0), (2000.0, 5.0), (3000.0, 8.0)])
def test_what_is_felt_is_the_theory_with_the_true_rate_and_twice_the_damping(K: float, B: float, figures: Any) -> None:
    trace = run(scene_of(K, B), duration=0.4)
    assert trace.report.rate_hz == trace.report.nominal_rate_hz  # virtual time cannot know
    found = measure_trace(trace, MASS)
    true = Configuration(mass=MASS, rate=0.5 * RATE, friction=FRICTION, delay=1.0)
    # What is identified counts in declared periods: a frequency twice too high, k four times and b twice.
    k, b = true.equivalent(K, 2.0 * B)
    assert found.k == pytest.approx(4.0 * k, rel=1e-5)
    assert found.b == pytest.approx(2.0 * b, rel=1e-5)
    believed, _ = Configuration(mass=MASS, rate=RATE, friction=FRICTION, delay=1.0).equivalent(K, B)
    assert abs(k / believed - 1.0) > 0.03
    figures.note(f"at half the rate, K = {K:g}, B = {B:g}: k = {found.k / 4.0:.0f}, b = {found.b / 2.0:.2f}")


@pytest.mark.usefixtures("at_half_the_rate")
def test_the_limit_of_stiffness_is_that_of_the_true_rate(figures: Any) -> None:
    B = 5.0
    believed = Configuration(mass=MASS, rate=RATE, friction=FRICTION, delay=1.0)
    _, limit = Configuration(mass=MASS, rate=0.5 * RATE, friction=FRICTION, delay=1.0).stable_stiffness(2.0 * B)
    assert believed.is_stable(1.1 * limit, B)
    ends = []
    for K in (0.999 * limit, 1.001 * limit):
        position = run(scene_of(float(K), B, force_limit=1000.0), duration=6.0).position[:, 0]
        ends.append(np.log(np.std(position[-2000:]) / np.std(position[:2000])))
    assert ends[0] < 0.0 < ends[1]
    figures.note(
        f"at half the rate, B = {B:g}: unstable from {limit:.0f} N/m on, believed {believed.stable_stiffness(B)[1]:.0f}"
    )


@entry
def first_off(function, watch, tick, arrivals_ns):
    """The guard as the loop has it: at which position it says that the rate is off; -1 if it never does."""
    for sample in range(arrivals_ns.size):
        tick.sample, tick.now_ns = sample, np.int64(arrivals_ns[sample]) + 1
        if call_hook(function, (watch, tick.address)) != 0:
            return sample
    return -1


def watched(arrivals_ns: np.ndarray, period_ns: int) -> int | None:
    """At which position the guard says that the rate is off; None if it never does."""
    watch, tick = new_record(WATCH), new_record(TICK)
    watch.period_ns, tick.address = period_ns, address_of(tick)
    judge = np.uint64(judge_rate.address()), np.uint64(address_of(watch))
    sample = int(first_off(*judge, tick, arrivals_ns))
    return None if sample < 0 else sample


@pytest.mark.parametrize("rate", [50.0, 1000.0, 20_000.0])
@pytest.mark.parametrize("ratio", [0.5, 0.9 / MOST_OFF, 1.1 * MOST_OFF, 2.0])
def test_a_rate_that_stays_off_is_reported_after_some_windows(rate: float, ratio: float) -> None:
    period = round(1e9 / rate)
    window = max(WINDOW_SAMPLES, -(-WINDOW_NS // period))
    arrivals = np.arange(10 * window) * (period / ratio)
    assert watched(arrivals, period) == WINDOWS * window


@pytest.mark.parametrize("rate", [50.0, 1000.0, 20_000.0])
def test_a_host_that_is_held_up_is_no_device_at_another_rate(rate: float) -> None:
    """Held up for up to half a second again and again, it finds positions waiting and takes them all at once."""
    period = round(1e9 / rate)
    rng = np.random.default_rng(3)
    due = np.arange(round(60.0 * rate)) * float(period)
    for longest_s, steady in ((0.02, 1.0), (0.1, 0.9), (0.5, 1.1)):
        arrivals = due / steady
        for begin in rng.uniform(0.0, 60e9, 60):
            end = begin + rng.uniform(0.0, longest_s * 1e9)
            arrivals = np.where((arrivals >= begin) & (arrivals < end), end, arrivals)
        assert watched(arrivals, period) is None


def test_what_has_no_timer_is_not_judged() -> None:
    assert watched(np.arange(10_000) * 1e9, 1_000_000) == WINDOWS * 250
    assert not run(scene_of(500.0, 2.0), duration=0.1).report.timed_by_device


@pytest.mark.parametrize("ratio", [0.5, 2.0])
def test_a_device_at_another_rate_is_stopped_with_a_sentence_that_names_the_rate(ratio: float) -> None:
    scene = scene_of(500.0, 2.0, clock="device")
    loop = assembled(scene, is_port=True)
    codes = [RECEIVED]
    while codes[-1] == RECEIVED and len(codes) < 5000:
        codes.append(arrive(loop, frame(len(codes), 0), 10**9 + round(len(codes) * 1e6 / ratio)))
        loop.state.unanswered = 0  # the force has left
    assert len(codes) == WINDOWS * 250 + 2
    report, _ = report_of(scene, loop, in_words(codes[-1]))
    failure = failure_of("port", scene, loop, SimpleNamespace(report=report), codes[-1])  # type: ignore[arg-type]
    assert (type(failure), report.ending) == (GuardError, "wrong rate")
    assert f"the device samples at {1000.0 * ratio:g} Hz, where it declares 1000 Hz" in str(failure)
    assert not loop.record.io.force_counts.any()
