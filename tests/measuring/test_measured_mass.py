"""The mass behind k and b: its uncertainty, a wrong value, and a device without a constant mass."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from records import held_by_a_hand
from rich.console import Console

import hapsim as python_api
from hapsim.cli.measure_command import measurement_document, show_measurement
from hapsim.documents import plain
from hapsim.measuring.diagnosis import diagnose
from hapsim.measuring.measure_trace import measure_trace
from hapsim.prediction import predict, with_mass
from hapsim.scene import Scene, parse_scene

SCENE = """
version: 1
rate: 1000
device: {{clock: lockstep, mass: {mass}, friction: 1.0, delay: {delay}, correction: {correction}}}
mock: {{mass: {true}, initial: {{velocity: 0.1}}, noise: {noise}, quantum: {quantum}, seed: {seed}}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {K}, damping: {B}}}
"""
AS_DECLARED = {"mass": 0.2, "true": 0.2, "delay": 1, "correction": "none", "noise": 0, "quantum": 1e-9, "seed": 0}


def text_of(**changed: object) -> str:
    return SCENE.format(**AS_DECLARED | {"K": 2000, "B": 5} | changed)


def scene_of(**changed: object) -> Scene:
    return parse_scene(text_of(**changed))


@pytest.fixture
def measured(hapsim: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    """Measures a scene by the command line."""

    def measure(*words: str, late: float | None = None, **changed: object) -> Any:
        path = tmp_path / "scene.yaml"
        text = text_of(**changed) if late is None else text_of(**changed).replace("mock: {", f"mock: {{delay: {late}, ")
        path.write_text(text, encoding="utf-8")
        return hapsim("measure", path, *words)

    return measure


@pytest.mark.parametrize(("true", "factor", "k", "b"), [(0.3, "1.5", 2052.764, 3.01447), (0.1, "0.5", 2169.086, 3.035)])
def test_another_mass_than_the_declared_one_is_named_with_what_the_hand_then_feels(
    measured: Callable[..., Any], true: float, factor: str, k: float, b: float
) -> None:
    told = " ".join(measured(true=true).out.split())
    assert f"The mass is probably {factor} times the declared one, {true:g} kg: with it the prediction has" in told
    assert f"k = {k:.2f} N/m, b = {b:g} N·s/m." in told
    assert "│ mass kg │ │ 0.2 │ declared │ │" in told
    assert "not as the scene declares it" not in told
    found = measured("--json", true=true).document["measured"]
    assert found["probable_mass_kg"] == pytest.approx(true, abs=5.0 * found["probable_mass_uncertainty_kg"])
    assert found["probable_mass_uncertainty_kg"] < 1e-6
    assert found["k"] * true / 0.2 == pytest.approx(k, abs=6e-4)  # it is still that of the declared mass
    assert (found["mass"], found["mass_kg"], found["mass_uncertainty_kg"]) == (0.2, 0.2, None)


@pytest.mark.parametrize("correction", ["poles", "predictor"])
def test_a_correction_does_not_hide_the_mass(correction: str) -> None:
    scene = scene_of(true=0.26, correction=correction, noise=3e-7)
    measurement = python_api.measure(scene)
    found = diagnose(predict(scene, with_margins=False), measurement).probable_mass
    assert found is not None
    assert found.mass == pytest.approx(0.26, abs=4.0 * found.uncertainty)
    assert found.factor == pytest.approx(found.mass / 0.2)
    assert 1e-6 < found.uncertainty < 0.002


def test_a_longer_delay_than_the_declared_one_is_named_and_a_negative_b_is_an_unstable_loop(
    measured: Callable[..., Any],
) -> None:
    told = " ".join(measured(late=3.0).out.split())
    assert "The delay is probably 3 samples: with it the prediction has the k and b that were measured" in told
    assert "b is negative: the swing grows by itself, and the loop on this device is unstable." in told
    # Less damping than predicted, by no more than a declared friction could be too large, has other causes.
    declared = scene_of(true=0.2)
    looser = declared.model_copy(update={"mock": declared.mock.model_copy(update={"friction": 0.1})})
    found = diagnose(predict(declared, with_margins=False), python_api.measure(looser))
    assert (found.probable_delay, found.is_another_device) == (None, True)


def test_a_device_as_declared_is_not_given_another_mass_and_a_damper_is_no_mass() -> None:
    rng = np.random.default_rng(2026)
    for seed in range(4):
        scene = scene_of(
            K=10.0 ** rng.uniform(2.5, 4.0),
            B=10.0 ** rng.uniform(0.3, 1.0),
            correction=str(rng.choice(["none", "poles", "predictor"])),
            noise=rng.choice([0.0, 1e-6]),
            quantum=10.0 ** rng.uniform(-9.0, -5.5),
            seed=seed,
        )
        prediction = predict(scene, with_margins=False)
        measurement = python_api.measure(scene)
        found = diagnose(prediction, measurement)
        assert (found.probable_mass, found.gives, found.is_another_device) == (None, False, False)
        # Of another friction the declared mass is not to blame.
        rubbed = scene.model_copy(update={"mock": scene.mock.model_copy(update={"friction": 1.6})})
        rubbed_found = diagnose(prediction, python_api.measure(rubbed))
        assert (rubbed_found.probable_mass, rubbed_found.is_another_device) == (None, True)


def test_the_uncertainty_of_the_mass_is_one_of_k_and_b_but_of_no_frequency(measured: Callable[..., Any]) -> None:
    declared = measured("--json").document["measured"]
    known = measured("--json", mass="{value: 0.2, uncertainty: 0.001}").document["measured"]
    assert known["mass_uncertainty_kg"] == 0.001
    for key in ("k", "b"):
        assert known[key] == declared[key]
        assert known[f"{key}_uncertainty"] == pytest.approx(0.005 * known[key], rel=1e-6)
        assert declared[f"{key}_uncertainty"] < 1e-6 * known[key]
    for key in ("frequency_uncertainty_hz", "damping_ratio_uncertainty"):
        assert known[key] == declared[key] > 0.0
    # f grows with the root of k, and the damping ratio with b over that root.
    of_k, of_b = (declared[f"{key}_uncertainty"] / declared[key] for key in ("k", "b"))
    assert declared["frequency_uncertainty_hz"] == pytest.approx(0.5 * of_k * declared["frequency_hz"])
    expected = np.hypot(of_b, 0.5 * of_k) * declared["damping_ratio"]
    assert declared["damping_ratio_uncertainty"] == pytest.approx(expected)
    assert "│ mass kg │ │ 0.2000 │ 0.001 │ │" in " ".join(measured(mass="{value: 0.2, uncertainty: 0.001}").out.split())
    # 15 % off is nothing that an uncertainty of 10 % does not cover.
    assert measured("--json", true=0.23).document["measured"]["probable_mass_kg"] is not None
    vague = measured("--json", true=0.23, mass="{value: 0.2, uncertainty: 0.02}").document["measured"]
    assert vague["probable_mass_kg"] is None


def test_an_estimated_mass_is_stated_with_its_uncertainty() -> None:
    """The mass is between two of the table, and so are the loop's numbers: they are not those for this mass."""
    scene = scene_of(mass="{from: 0.1, to: 0.4}", true=0.1475, correction="adaptive", K=5000, B=40)
    measurement = python_api.measure(scene)
    report = measurement.trace.report
    assert (measurement.mass,) == report.estimated_mass_kg
    assert (measurement.mass_uncertainty,) == report.estimated_mass_uncertainty_kg
    felt = with_mass(predict(scene), 0, measurement.mass).felt[0]
    assert measurement.k == pytest.approx(felt.k, abs=measurement.k_uncertainty, rel=0.0)
    assert measurement.b == pytest.approx(felt.b, abs=measurement.b_uncertainty, rel=0.0)


def test_the_stated_uncertainties_of_frequency_and_damping_ratio_hold() -> None:
    off = []
    for seed in range(8):
        scene = scene_of(noise=1e-6, seed=seed)
        felt, found = predict(scene, with_margins=False).felt[0], python_api.measure(scene)
        off.append(
            (
                (found.frequency_hz - felt.frequency_hz) / found.frequency_uncertainty_hz,
                (found.damping_ratio - felt.damping_ratio) / found.damping_ratio_uncertainty,
            )
        )
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all((spread > 0.4) & (spread < 1.6)), spread


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_a_hand_that_gives_is_named_as_a_second_mode(noise: float) -> None:
    scene = scene_of()
    measurement = measure_trace(held_by_a_hand(0.3, 3000.0, 10.0, noise), 0.2)
    assert measurement.k == pytest.approx(634.915, abs=max(0.002, 4.0 * measurement.k_uncertainty))
    assert measurement.second_mode is not None
    assert 0.05 < measurement.second_mode.share < 0.1
    assert python_api.diagnose(predict(scene), measurement).gives
    document = plain(measurement_document(predict(scene), measurement, 0)["measured"])
    assert (document["dominant"], document["second_mode"]["predicted"], document["probable_mass_kg"]) == (
        False,
        False,
        None,
    )
    out = Console(width=80, legacy_windows=False)
    with out.capture() as capture:
        show_measurement(out, scene, predict(scene), measurement)
    lines = capture.get().splitlines()
    assert max(map(len, lines)) <= 80
    told = " ".join(" ".join(lines).split())
    assert "Something swings along at 28." in told
    assert "Hz, damping ratio 0.2" in told
    assert "with 7.05 % of the motion's energy" in told or noise
    assert "probably" not in told


def test_a_second_mode_that_the_scene_has_is_none_of_the_hand_s(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    """A mass of the scene, which the hand moves by a link."""
    text = text_of(K=800, B=0.5).replace("between: [hand, wall]", "between: [hand, ball]") + (
        "  ball:  {type: mass, mass: 0.5}\n"
        "  rest:  {type: viscoelastic, between: [ball, wall], stiffness: 2000, damping: 0.5}\n"
    )
    (tmp_path / "ball.yaml").write_text(text, encoding="utf-8")
    found = hapsim("measure", tmp_path / "ball.yaml", "--json").document["measured"]
    assert found["second_mode"]["predicted"] is True
    assert found["second_mode"]["frequency_hz"] == pytest.approx(7.4, abs=0.05)
    assert found["dominant"] is True
    assert found["probable_mass_kg"] is None


def test_a_record_with_late_forces_shows_nothing_of_the_mass() -> None:
    scene = scene_of(true=0.3)
    prediction, measurement = predict(scene), python_api.measure(scene)
    assert diagnose(prediction, measurement).probable_mass is not None
    trace = measurement.trace
    late = replace(trace, report=replace(trace.report, deadline_misses=trace.report.ticks // 20))
    assert diagnose(prediction, replace(measurement, trace=late)).probable_mass is None


@pytest.mark.parametrize("friction", [1.0, 0.999])
@pytest.mark.parametrize("limits", [{"soft_start": 0.05, "slew_limit": 2000.0}, {"force_limit": 1.5}])
def test_a_force_that_is_limited_or_a_friction_a_little_off_does_not_hide_the_mass(
    limits: dict[str, float], friction: float
) -> None:
    scene = scene_of(true=0.3)
    device = scene.device.model_copy(update=limits)
    scene = scene.model_copy(update={"device": device, "mock": scene.mock.model_copy(update={"friction": friction})})
    measurement = python_api.measure(scene)
    report = measurement.trace.report
    assert report.slewed_ticks + report.limited_ticks > 0.01 * report.ticks
    found = diagnose(predict(scene, with_margins=False), measurement).probable_mass
    assert found is not None
    assert found.mass == pytest.approx(0.3, rel=1e-3)
