"""A device's true rate, read from arrivals, and a slow wire: what they make of a measurement and of its prediction."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import hapsim
from hapsim.cli.measure_command import measurement_document, show_measurement
from hapsim.device.connection import Connection
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.device.mock.wire import loopback_transport
from hapsim.documents import plain
from hapsim.errors import UsageError
from hapsim.loop.ring import LATE_FORCE
from hapsim.measuring.fitted_pair import NO_SECOND_REAL_POLE
from hapsim.measuring.measure_trace import Measurement, measure_trace
from hapsim.measuring.trace_quality import median_slope, seen_rate, spikes
from hapsim.prediction import predict
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.running import session as session_module
from hapsim.scene import Scene
from tests import one_hand

FLICKED = {"initial": {"velocity": 0.1}}
SCENE = one_hand.scene_of({"touch": one_hand.touch(2000.0, 5.0)}, mock=FLICKED)


def mistaken_mock(scene: Scene, share: float) -> Any:
    """A mock that declares the scene's rate and samples at `share` of it."""
    mock = assemble_mock(scene)
    mock.converters["period"] /= share
    return mock


@pytest.fixture(scope="module")
def a_trace() -> Trace:
    return run(SCENE, duration=2.048)


def arriving(trace: Trace, arrivals_s: np.ndarray, kept: Any = slice(None)) -> Trace:
    """The trace, as if its positions had come from a device with a timer of its own, at these times."""
    rows = {"sample": trace.sample[kept], "time_ns": np.rint(1e9 * arrivals_s[kept]).astype(np.int64) + 10**12}
    return replace(trace, **rows, report=replace(trace.report, timed_by_device=True, virtual_time=False))


def late(samples: int, rng: np.random.Generator) -> np.ndarray:
    """Lateness (s) as a machine that is not real-time has it: never early, mostly small, rarely milliseconds."""
    return rng.exponential(40e-6, samples) + (rng.uniform(size=samples) < 0.01) * rng.uniform(0.0, 5e-3, samples)


@pytest.mark.parametrize(
    ("share", "slower", "most"),
    [
        *((share, 1.0, 1.0) for share in (0.5, 0.9, 0.98, 0.999, 1.0, 1.02, 1.5)),
        # Half a millisecond late on average: the earliest arrivals count, and the uncertainty is the host's clock.
        *((share, 12.0, 0.15 * share) for share in (0.5, 0.9, 1.0)),
    ],
)
def test_the_true_rate_lies_within_the_uncertainty(a_trace: Trace, share: float, slower: float, most: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(20):
        seen = seen_rate(arriving(a_trace, np.arange(2048) / (1000.0 * share) + slower * late(2048, rng)))
        assert seen is not None
        assert abs(seen.rate_hz - 1000.0 * share) < seen.uncertainty_hz < most
        assert seen.differs_from(1000.0) == (share != 1.0)


def test_of_a_short_record_on_a_slow_machine_the_rate_is_as_uncertain_as_it_looks(a_trace: Trace) -> None:
    """Arrivals that are blurred by a whole period: they, and not the host's clock, are what is uncertain."""
    rng, off = np.random.default_rng(12), []
    for share in np.repeat([0.5, 1.0, 2.0], 30):
        arrivals = (np.arange(200) + rng.uniform(size=200)) / (1000.0 * share)
        seen = seen_rate(arriving(a_trace, arrivals, slice(200)))
        assert seen is not None
        off.append(abs(seen.rate_hz / (1000.0 * share) - 1.0) / (seen.uncertainty_hz / (1000.0 * share)))
        assert 5e-4 < seen.uncertainty_hz / (1000.0 * share) < 0.02
    assert max(off) < 1.0
    assert 0.1 < np.median(off) < 0.5


def test_the_median_slope_lies_between_bounds_that_hold_the_true_one() -> None:
    rng, x = np.random.default_rng(13), np.arange(20.0)
    for _ in range(50):
        slope, low, high = median_slope(x, 3.0 * x + rng.standard_normal(20))
        assert low < slope < high
        assert low < 3.0 < high


def test_a_host_that_is_held_up_and_lost_positions_do_not_bend_it(a_trace: Trace) -> None:
    rng = np.random.default_rng(12)
    for _ in range(20):
        arrivals = np.arange(2048) / 980.0 + late(2048, rng)
        for begin in rng.uniform(0.0, 2.0, 5):  # held up for up to a tenth of a second, it finds positions waiting
            end = begin + rng.uniform(0.0, 0.1)
            arrivals = np.where((arrivals >= begin) & (arrivals < end), end, arrivals)
        kept = np.flatnonzero(rng.uniform(size=2048) > 0.3)
        seen = seen_rate(arriving(a_trace, arrivals, kept))
        assert seen is not None
        assert abs(seen.rate_hz - 980.0) < seen.uncertainty_hz < 2.0


def test_of_virtual_time_and_of_too_few_positions_there_is_none(a_trace: Trace) -> None:
    assert seen_rate(a_trace) is None
    assert seen_rate(arriving(a_trace, np.arange(2048) / 900.0, slice(0, 79))) is None


@pytest.mark.parametrize("share", [0.5, 0.9, 0.98])
@pytest.mark.parametrize("damper", [{}, {"damper": "filtered", "cutoff": 100.0}, {"damper": "sensed"}])
def test_what_was_felt_at_the_seen_rate_is_what_is_predicted_for_it(
    monkeypatch: pytest.MonkeyPatch, share: float, damper: dict[str, Any]
) -> None:
    """Two roads: the theory with another rate, and the motion of a mock whose timer is slow."""
    scene = one_hand.scene_of({"touch": one_hand.touch(2000.0, 5.0, **damper)}, mock=FLICKED)

    @contextlib.contextmanager
    def slow(scene: Scene, *_: Any, **__: Any) -> Iterator[Connection]:
        yield Connection(loopback_transport(mistaken_mock(scene, share)), "slow", close=lambda: None)

    monkeypatch.setattr(session_module, "open_connection", slow)
    measured = measure_trace(run(scene, duration=1.0), 0.2).at_rate(1000.0 * share)
    (declared,) = predict(scene).felt
    felt = declared.at_rate(1000.0 * share)
    for key in ("k", "b", "frequency_hz", "damping_ratio"):
        assert getattr(measured, key) == pytest.approx(getattr(felt, key), rel=2e-5)
    assert abs(declared.k / felt.k - 1.0) > 2e-4


def test_of_a_port_a_rate_is_seen() -> None:
    """The run is in real time; the measured rate also depends on this machine and is not asserted."""
    touch = {"touch": one_hand.touch(200.0, 2.0)}
    scene = one_hand.scene_of(touch, device={"clock": "device"}, mock=FLICKED, rate=200.0)
    with serving(mistaken_mock(scene, 0.9)) as port:
        on_port = scene.model_copy(update={"device": scene.device.model_copy(update={"port": port})})
        trace = run(on_port, duration=1.0)
    seen = seen_rate(trace)
    assert trace.report.timed_by_device
    assert (seen is not None) == (trace.sample.size >= 80)  # fewer where the machine is held up for long
    assert seen is None or seen.uncertainty_hz > 0.0


@pytest.mark.parametrize("share", [0.9, 1.0])
def test_the_document_has_both_sides_for_the_rate_that_was_seen(a_trace: Trace, share: float) -> None:
    measurement = measure_trace(arriving(a_trace, np.arange(2048) / (1000.0 * share)), 0.2)
    document = plain(measurement_document(predict(SCENE), measurement, 0))
    assert (document["rate_hz"], document["nominal_rate_hz"]) == (1000.0, 1000.0)
    assert document["rate_seen_hz"] == pytest.approx(1000.0 * share, abs=document["rate_seen_uncertainty_hz"])
    if share == 1.0:
        assert document["at_rate_seen"] is None
        document = plain(measurement_document(predict(SCENE), measure_trace(a_trace, 0.2), 0))
        assert (document["rate_seen_hz"], document["at_rate_seen"]) == (None, None)  # in virtual time
        return
    seen = document["at_rate_seen"]
    assert seen["measured"]["k"] == pytest.approx(document["measured"]["k"] * share**2, rel=1e-6)
    assert seen["measured"]["b"] == pytest.approx(document["measured"]["b"] * share, rel=1e-6)
    assert seen["measured"]["k_uncertainty"] > document["measured"]["k_uncertainty"]
    assert seen["predicted"]["damping"] == pytest.approx(document["predicted"]["damping"] / share, rel=1e-6)
    assert document["predicted"]["k"] == pytest.approx(document["measured"]["k"], rel=1e-5)


def printed(measurement: Measurement) -> str:
    console = Console(record=True, width=200)
    show_measurement(console, SCENE, predict(SCENE), measurement)
    return console.export_text()


def test_the_text_names_the_rate_that_was_seen(a_trace: Trace) -> None:
    arrived = arriving(a_trace, np.arange(2048) / 900.0)
    told = printed(measure_trace(arrived, 0.2 / 0.9**2))
    assert "The device sampled at 900.000 ± 0.090 Hz" in told
    assert "it declares 1000 Hz" in told
    assert "What the hand feels at 900.000 Hz (or this machine held the device up)" in told
    assert "much further apart" not in told
    told = printed(measure_trace(arrived, 0.4))
    assert "Measured and predicted are much further apart" in told


def test_k_and_b_as_predicted_show_that_the_machine_was_held_up_and_not_the_timer(a_trace: Trace) -> None:
    told = printed(measure_trace(arriving(a_trace, np.arange(2048) / 900.0), 0.2))
    assert "The positions arrived at 900 Hz. This machine held them up" in told
    assert "What the hand feels at 900" not in told


@pytest.mark.parametrize(
    ("reason", "told"),
    [
        (NO_SECOND_REAL_POLE, "the hand creeps back without swinging, in a way that no single spring and damper does"),
        ("fewer than two poles are clear of its noise", "fewer than two poles are clear of its noise"),
    ],
)
def test_why_there_is_no_spring_and_damper_is_reported_plainly(a_trace: Trace, reason: str, told: str) -> None:
    measurement = replace(measure_trace(a_trace, 0.2), dominant=False, reason=reason)
    text = printed(measurement)
    assert f"The motion is not that of a spring and damper: {told}." in text


def test_a_hand_whose_forces_are_late_now_and_then_is_not_reported_as_unmoved(a_trace: Trace) -> None:
    late = np.where(np.arange(2048) % 2, LATE_FORCE, 0).astype(np.uint8)
    with pytest.raises(UsageError, match="of 2048 samples 1024 had their force too late") as caught:
        measure_trace(replace(a_trace, flags=late), 0.2)
    assert "the hand moved by 0.00" in str(caught.value)
    assert "too little motion" not in str(caught.value)
    with pytest.raises(UsageError, match="too little motion"):
        measure_trace(replace(a_trace, position_counts=0 * a_trace.position_counts), 0.2)


RATE, CLOSE = 500.0, 4.0  # Hz; of the uncertainties that the identification states


def scene_over(baud: int, turnaround: float, **device: Any) -> Scene:
    """A hand on a spring; 23 bytes an exchange, in virtual time."""
    mock = FLICKED | {"baud": baud, "turnaround": turnaround}
    return one_hand.scene_of({"touch": one_hand.touch(300.0, 8.0)}, device=device, mock=mock, rate=RATE)


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
    predicted, declared = predict(scene), predict(scene_over(100_000_000, 0.0, **kind))
    assert predicted.wire_time.delay_samples == samples
    measured = hapsim.measure(scene)
    assert measured.k == pytest.approx(predicted.k, abs=CLOSE * measured.k_uncertainty)
    assert measured.b == pytest.approx(predicted.b, abs=CLOSE * measured.b_uncertainty)
    if samples > 1:  # and the two delays are far apart
        assert abs(predicted.k - declared.k) > 1e4 * measured.k_uncertainty


def test_over_a_slow_wire_every_deadline_is_missed_and_a_run_is_the_same_each_time() -> None:
    runs = [run(scene_over(115200, 0.0022), duration=0.4) for _ in range(2)]
    assert [trace.report.deadline_misses for trace in runs] == [199, 199]
    assert (runs[0].position_counts == runs[1].position_counts).all()


def test_positions_that_lie_alone_are_counted_and_a_mass_makes_none(a_trace: Trace) -> None:
    """A mass that rings, one that is pushed in single samples, noise, and one that leaps to another place have none."""
    assert not [*spikes([a_trace], 0)]
    rng = np.random.default_rng(5)
    noise = rng.normal(0.0, 1e5, a_trace.position_counts.shape)
    noisy = replace(a_trace, position_counts=a_trace.position_counts + noise.astype(np.int64))
    assert not [*spikes([noisy], 0)]
    leap = a_trace.position_counts + (np.arange(2048) > 1000)[:, None] * 1_000_000
    assert not [*spikes([replace(a_trace, position_counts=leap)], 0)]
    counts = a_trace.position_counts.copy()
    counts[150::300] += 1_000_000
    spoilt = replace(a_trace, position_counts=counts)
    height = f"{1e6 * a_trace.position_scale[0]:.2g} m"
    told = printed(replace(measure_trace(a_trace, 0.2), trace=spoilt))
    assert f"The position has spikes: 7 samples lay alone, at most {height} off" in told
