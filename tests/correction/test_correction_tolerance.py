"""Tolerance of a correction to errors in the device's parameters: independently computed figures and their meaning."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hapsim import predict
from hapsim.prediction import Prediction
from hapsim.scene import parse_scene
from tests.one_hand import document_of, touch


def text_of(stiffness: float, damping: float, correction: str, **device: Any) -> str:
    device = {"correction": correction} | device
    return json.dumps(document_of({"touch": touch(stiffness, damping)}, device=device))


def predicted(*args: Any, **device: Any) -> Prediction:
    return predict(parse_scene(text_of(*args, **device), "scene"), with_margins=False)


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("stiffness", "damping", "correction", "least", "most"),
    [
        (2000.0, 5.0, "predictor", 0.6572, 2.2089),
        (2000.0, 5.0, "poles", 0.6092, 3.7916),
        (5000.0, 10.0, "predictor", 0.8505, 1.2252),
        (5000.0, 10.0, "poles", 0.7799, 1.4709),
        (10_000.0, 20.0, "predictor", 0.9265, 1.0923),
        (10_000.0, 20.0, "poles", 0.8898, 1.1616),
        (20_000.0, 40.0, "predictor", 0.9667, 1.0397),
    ],
)
def test_the_mass_for_five_percent(
    stiffness: float, damping: float, correction: str, least: float, most: float
) -> None:
    one, _ = predicted(stiffness, damping, correction).parts[0].tolerances()
    assert one.share == 0.05
    assert (one.mass[0] / 0.2, one.mass[1] / 0.2) == pytest.approx((least, most), abs=6e-5)


@pytest.mark.parametrize("correction", ["poles", "predictor"])
@pytest.mark.parametrize("what", ["mass", "friction", "delay"])
def test_at_its_ends_k_or_b_is_off_by_the_share(correction: str, what: str) -> None:
    prediction = predicted(5000.0, 10.0, correction)
    for one in prediction.parts[0].tolerances():
        for end, is_least in zip(getattr(one, what), (True, False), strict=True):
            felt = prediction.felt[0]
            there = replace(felt, configuration=replace(felt.configuration, **{what: end}))
            off = max(abs(there.k / 5000.0 - 1.0), abs(there.b / 11.0 - 1.0))
            is_at_nothing = is_least and what != "mass" and end == 0.0
            assert off == pytest.approx(one.share, rel=1e-5) or is_at_nothing


def test_none_where_nothing_is_corrected_or_what_is_desired_is_not_reached() -> None:
    assert predicted(2000.0, 5.0, "none").parts[0].tolerances() == ()
    beyond = predicted(200_000.0, 5.0, "poles")
    assert not beyond.desired[0].reached
    assert beyond.parts[0].tolerances() == ()


def test_check_prints_the_tolerance(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    file = tmp_path / "scene.yaml"
    file.write_text(text_of(2000.0, 5.0, "poles"), encoding="utf-8")
    spans = "where its mass is 0.1219 to 0.7583 kg, its friction 0.7204 to 1.279 N·s/m"
    assert f"hand feels what is desired within 5 % {spans}" in " ".join(hapsim("check", str(file)).out.split())
    assert "within 10 % where its mass is" in " ".join(hapsim("check", str(file), "--explain").out.split())


def test_of_a_predictor_check_states_what_poles_would_forgive(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text_of(5000.0, 10.0, "predictor"))
    told = " ".join(hapsim("check", path, "--explain").out.split())
    assert "within 5 % where its mass is 0.1701 to 0.245 kg" in told
    assert "With correction: poles hand would feel it within 5 % for 0.156 to 0.2941 kg" in told
