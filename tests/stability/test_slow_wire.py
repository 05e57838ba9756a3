"""A wire that makes every force late: one verdict everywhere, for the delay that it gives, and no hand swung by it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hapsim as public
from hapsim.errors import GuardError, UsageError
from hapsim.live.messages import Predict
from hapsim.live.predicted import predicted
from hapsim.prediction import predict, surely_shaken_by, warnings_about
from hapsim.prediction.timing import least_late_samples, on_wire, samples_on_wire, wire_of
from hapsim.running import run
from hapsim.scene import Scene, parse_scene
from hapsim.sweeping.quantities import Task
from tests.one_hand import document_of, touch

Hapsim = Callable[..., Any]

# A byte of the 23 takes 10 bits.
WIRES = [
    (rate, baud, turnaround)
    for rate in (500.0, 1000.0, 2000.0)
    for baud in (250_000, 1_000_000, 2_000_000)
    for turnaround in (0.0, 0.0009, 0.002, 0.003, 0.006, 0.009)
]


def text(rate: float = 1000.0, mock: Any = None, **device: Any) -> dict[str, Any]:
    """A hand that is stable by itself, up to a delay of some four samples."""
    stiffness = 0.01 * 0.2 * rate**2
    modules = {"touch": touch(stiffness, 0.4 * (stiffness * 0.2) ** 0.5)}
    mock = {"initial": {"velocity": 0.1}, **(mock or {})}
    return document_of(modules, device={"friction": 0.3, **device}, mock=mock, rate=rate)


def scene_of(*given: Any, **device: Any) -> Scene:
    return parse_scene(json.dumps(text(*given, **device)))


def samples_of(rate: float, baud: int, turnaround: float) -> int:
    """Returns the number of samples until the force for a position acts, plus one."""
    return 1 + int((turnaround + 230.0 / baud) * rate + 1e-9)


@pytest.mark.thorough(keep=7)
@pytest.mark.parametrize(("rate", "baud", "turnaround"), WIRES)
def test_every_verdict_is_that_of_a_device_with_the_delay_of_the_wire(
    rate: float, baud: int, turnaround: float
) -> None:
    samples = samples_of(rate, baud, turnaround)
    slow, same = scene_of(rate, {"baud": baud, "turnaround": turnaround}), scene_of(rate, delay=float(samples))
    found, wanted = predict(slow), predict(same)
    assert (samples_on_wire(slow), on_wire(slow).device.delay) == (samples, samples)
    assert (found.stable, found.k, found.b, found.spectral_radius, found.margins) == (
        wanted.stable,
        wanted.k,
        wanted.b,
        wanted.spectral_radius,
        wanted.margins,
    )
    assert surely_shaken_by(slow) == surely_shaken_by(same)
    asked = Predict(type="predict", plane=True)
    assert [predicted(slow, {}, asked)[key] for key in ("stable", "plane")] == [
        predicted(same, {}, asked)[key] for key in ("stable", "plane")
    ]
    document = text(rate, {"baud": baud, "turnaround": turnaround})
    swept = Task(document, ("predicted",)).at(slow)[0]
    assert (swept["stable"], swept["predicted_k"]) == (float(wanted.stable), pytest.approx(wanted.k, nan_ok=True))
    if wanted.stable:
        assert run(slow, duration=1.0, unstable=False, judges_energy=True).report.limited_ticks == 0
    else:
        with pytest.raises(UsageError, match=rf"not armed: .*1 sample declared, {samples} on this wire"):
            run(slow, duration=1.0, unstable=False)
        with pytest.raises(GuardError) as caught:
            run(slow, duration=30.0, unstable=True, judges_energy=True)
        assert caught.value.trace is not None
        assert caught.value.trace.report.duration_s < 10.0


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("wire", "told"),
    [
        ({"turnaround": 0.016}, "no baud rate shortens the turnaround, such as an FTDI's latency timer"),
        ({"baud": 150_000, "turnaround": 0.0}, "use a higher baud rate or a lower rate"),
    ],
)
def test_the_command_line_has_one_verdict_and_names_what_costs_the_time(
    hapsim: Hapsim, tmp_path: Path, wire: dict[str, Any], told: str
) -> None:
    path = tmp_path / "slow.yaml"
    document = text(1000.0, wire)
    document["modules"]["touch"]["damping"] = 1.0
    path.write_text(json.dumps(document), encoding="utf-8")
    samples = samples_on_wire(public.load_scene(path))
    answer = hapsim("check", path)
    assert ": unstable (spectral radius" in " ".join(answer.out.split())
    assert ": stable" not in answer.out
    assert f"delay {samples} samples ({samples} ms, 1 declared)" in " ".join(answer.out.split())
    checked = hapsim("check", path, "--json").document
    assert (checked["stable"], checked["wire_time"]["stable"]) == (False, False)
    assert checked["predicted"]["k"] == checked["wire_time"]["predicted"]["k"]
    for command in (("run",), ("measure",), ("measure", "--impedance")):
        refused = hapsim(*command, path)
        assert refused.status == 2
        assert f"1 sample declared, {samples} on this wire" in refused.sentence
        assert told in refused.sentence
    swept = hapsim("sweep", path, "touch.damping=1,2", "--check", "--out", tmp_path / "swept.nc", "--json")
    assert swept.status == 0


@pytest.mark.parametrize("correction", ["none", "poles", "predictor"])
@pytest.mark.parametrize("turnaround", [0.0015, 0.0025, 0.0045])
def test_what_is_measured_on_a_slow_wire_is_what_is_predicted_for_it(correction: str, turnaround: float) -> None:
    scene = scene_of(500.0, {"turnaround": turnaround, "baud": 2_000_000}, correction=correction)
    found, prediction = public.measure(scene), predict(scene)
    assert found.k == pytest.approx(prediction.k, abs=4.0 * found.k_uncertainty)
    assert found.b == pytest.approx(prediction.b, abs=4.0 * found.b_uncertainty)


def test_which_ports_are_paced_by_their_baud_rate() -> None:
    for port, kind in (
        ("/dev/ttyUSB7", "port"),
        ("/dev/ttyS9", "port"),
        ("/dev/ttyACM7", "unknown"),
        ("/dev/pts/999", "unknown"),
        ("COM3", "unknown"),
    ):
        scene = scene_of(1000.0, port=port, clock="device", baud=200_000)
        assert wire_of(scene) == kind
        assert samples_on_wire(scene) == (2 if kind == "port" else 1)
        sentences = " ".join(warnings_about(scene, predict(scene)))
        assert ("2 on this wire" in sentences) == (kind == "port")
        assert ("A USB device without a UART is not affected" in sentences) == (kind == "unknown")


def test_frames_that_queue_up_are_judged_at_the_oldest_force_that_acts() -> None:
    scene = scene_of(1000.0, port="/dev/ttyUSB7", clock="device", baud=9600)
    assert samples_on_wire(scene) == 21
    assert surely_shaken_by(scene) is not None


# A wire of which nothing is known before the device runs.


def jittery(share: float, damping: float, seed: int = 0, **options: Any) -> Any:
    """Runs a scene of which this share of the forces is late. With a damping of 3 N·s/m it is unstable at a delay of
    two samples; with 20 it is not."""
    document = text(1000.0, {"misses": share, "seed": seed, "initial": {"velocity": 0.01}})
    document["modules"]["touch"] |= {"stiffness": 2000.0, "damping": damping}
    return run(parse_scene(json.dumps(document)), duration=0.5, **options)


@pytest.mark.parametrize("seed", range(3))
def test_where_most_of_the_first_forces_are_late_an_unstable_scene_is_released(seed: int) -> None:
    with pytest.raises(
        GuardError, match=r"of the first \d+ forces were late: .* a wire that takes 2 samples"
    ) as caught:
        jittery(0.9, 3.0, seed, unstable=False)
    assert caught.value.exit_status == 4
    assert caught.value.trace is not None
    report = caught.value.trace.report
    assert (report.ending, report.released) == ("forces late", True)
    assert report.ticks <= 64


@pytest.mark.parametrize(
    ("share", "damping", "unstable"), [(0.9, 20.0, False), (0.2, 3.0, False), (0.9, 3.0, None), (0.9, 3.0, True)]
)
def test_no_other_is(share: float, damping: float, unstable: bool | None) -> None:
    assert jittery(share, damping, unstable=unstable).report.ending == "done"


def test_a_question_and_its_answer_show_how_late_the_late_ones_are() -> None:
    scene = scene_of(1000.0, clock="device")
    for seconds, samples in ((0.0, 2), (0.0019, 2), (0.0031, 3), (0.0161, 16), (5.0, 21)):
        assert least_late_samples(scene, seconds) == samples
    assert least_late_samples(scene_of(1000.0), 0.0161) == 2  # in virtual time it says nothing


@pytest.mark.thorough(keep=6)
@pytest.mark.parametrize("rate", [500.0, 1000.0])
@pytest.mark.parametrize("force_limit", [1.0, 10.0])
@pytest.mark.parametrize("turnaround", [0.002, 0.004, 0.009, 0.016])
def test_a_loop_that_swings_at_the_limit_with_late_forces_is_ended_whatever_is_known(
    monkeypatch: pytest.MonkeyPatch, rate: float, force_limit: float, turnaround: float
) -> None:
    document = text(rate, {"turnaround": turnaround, "baud": 2_000_000}, force_limit=force_limit)
    document["modules"]["touch"]["damping"] *= 0.3
    scene = parse_scene(json.dumps(document))
    assert surely_shaken_by(scene) is not None
    monkeypatch.setattr("hapsim.prediction.timing.samples_on_wire", lambda _: 1)
    with pytest.raises(GuardError, match=r"the force shook at its limit|had given the hand"):
        run(scene, duration=30.0, judges_energy=True)
