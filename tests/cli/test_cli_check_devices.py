"""`hapsim check` and `sweep --check` of scenes with several devices."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from hapsim.prediction.predict_ports import PortsPrediction
from hapsim.scene import Scene
from tests.port_scenes import TWO

Hapsim = Callable[..., Any]
WALL = """\
  c: {type: device, of: right, channel: 1}
  g: {type: ground}
  wall: {type: viscoelastic, between: [c, g], stiffness: 2000, damping: 5}
"""


@pytest.fixture(scope="module")
def predicted() -> Callable[[Scene], PortsPrediction]:
    return cache(PortsPrediction)


@pytest.fixture(autouse=True)
def _equal_scenes_are_predicted_once(monkeypatch: pytest.MonkeyPatch, predicted: Any) -> None:
    monkeypatch.setattr("hapsim.cli.check.PortsPrediction", predicted)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "two.yaml"
    path.write_text(TWO, encoding="utf-8")
    return path


def test_the_least_and_the_most_are_printed(hapsim: Hapsim, scene: Path) -> None:
    words = hapsim("check", scene).words
    assert "stable (a and b move freely together" in words
    assert "left and right have clocks of their own" in words
    assert "over 32 phases" in words
    assert "a to b: k 2000 2177.51 2180.76 2000 N/m" in words
    assert "a to b: b 5.5 2.50485 2.50494 N·s/m" in words
    assert "they lose speed at 4.975 to 4.981 /s (desired: 5 /s)" in words
    assert "unstable at 1.721 times the stiffness of spring" in words
    assert "left and right: Guards: force 10 N" in words


def test_explain_adds_the_price_of_two_clocks(hapsim: Hapsim, scene: Path) -> None:
    words = hapsim("check", scene, "--explain").words
    assert "wraps once in 20 s if they differ by 50 ppm" in words
    assert "1.41 to 3.74 times B/T" in words
    assert "the force steps by 0.02 N at most, at 10 m/s²; counts of 10 µm add up to 0.054 N rms" in words
    assert "a of b: k 2000 2168.89 2192.63 2000 N/m" in words
    assert "passivity is unknown, because the condition is not derived for hands on several ports" in words


def test_json_has_ranges_in_place_of_numbers(hapsim: Hapsim, scene: Path) -> None:
    found = hapsim("check", scene, "--json").document
    (part,) = found["parts"]
    assert part["devices"] == ["left", "right"]
    assert part["tie"]["k"] == pytest.approx([2177.511, 2180.764], abs=5e-4)
    assert part["tie"]["b"] == pytest.approx([2.50485, 2.50494], abs=5e-6)
    assert part["tie"]["desired"]["together_per_s"] == pytest.approx(-5.0)
    assert part["k"][0][0] == pytest.approx([2168.894, 2192.635], abs=5e-4)
    assert part["phases"] == 32
    assert set(found["devices"]) == {"left", "right"}
    assert found["devices"]["right"]["delay"] == 1.0
    assert found["margins"]["spring"]["stiffness_factor"] == pytest.approx(1.7212, abs=5e-5)


def test_a_hand_that_nothing_ties_is_predicted_as_ever(hapsim: Hapsim, scene: Path) -> None:
    text = TWO.replace("right: {mass: 0.2, friction: 1}", "right: {mass: [0.2, 0.2], friction: [1, 1]}")
    scene.write_text(f"{text}{WALL}", encoding="utf-8")
    words = hapsim("check", scene).words
    assert "right: for a hand of 0.2 kg" in words
    assert "c: k 2000 2080.44 2000 N/m" in words
    assert "a to b: k 2000 2177.51 2180.76" in words
    found = hapsim("check", scene, "--json").document["parts"]
    assert [part["device_points"] for part in found] == [["c"], ["a", "b"]]
    assert found[0]["alone"]["k"] == pytest.approx(2080.439463958)


def test_one_clock_is_a_single_value(hapsim: Hapsim, scene: Path) -> None:
    scene.write_text(TWO.replace("lockstep", "host"), encoding="utf-8")
    words = hapsim("check", scene).words
    assert "left and right have the host's clock: its jitter reaches the hands" in words
    assert "a to b: k 2000 2167.89 2167.89 2000 N/m" in words


def test_an_unstable_scene_is_not_stable_at_any_phase(hapsim: Hapsim, scene: Path) -> None:
    scene.write_text(TWO.replace("2000", "3450"), encoding="utf-8")
    found = hapsim("check", scene, "--require-stable")
    assert found.status == 2
    words = " ".join(found.out.split())
    assert "at 1000 Hz: unstable" in words
    assert "It becomes stable with" in words
    assert "Warning: the scene is predicted unstable" in words


@pytest.mark.parametrize("options", [["--hand-mass", "0.1:2"], ["--at", "0.001"]])
def test_options_of_one_device_are_refused(hapsim: Hapsim, scene: Path, options: list[str]) -> None:
    errors = hapsim("check", scene, *options).sentence
    assert f"{options[0]} does not go with a scene with several devices" in errors


def test_a_device_by_its_name_is_checked_with_the_others_held(hapsim: Hapsim, scene: Path) -> None:
    words = hapsim("check", scene, "--device", "left").words
    assert "a: k 2000 2080.44 2000 N/m" in words


class TestSweep:
    def test_it_has_the_least_and_the_most(self, hapsim: Hapsim, scene: Path, tmp_path: Path) -> None:
        out = tmp_path / "sweep.nc"
        answer = hapsim("sweep", scene, "left.delay=0,1", "--check", "--json", "--out", out)
        found = answer.document["variables"]
        assert found["predicted_k_least"]["most"] == pytest.approx(2177.511, abs=5e-4)
        assert found["predicted_b_most"]["least"] == pytest.approx(2.50494, abs=5e-6)
        assert found["stable"]["least"] == 1.0

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ([], "found measured of several devices, expected predicted (--check)"),
            ([], "such as --device left: device.delay is then the name of left.delay"),
            (["--check", "lft.delay=0,1"], "found 'lft.delay', expected a parameter of"),
            (["--check", "lft.delay=0,1"], "such as spring.stiffness; did you mean 'left.delay'?"),
            (["--check", "--at", "0.001"], "found a place of several devices, expected none"),
        ],
    )
    def test_what_one_device_alone_has_is_refused(
        self, hapsim: Hapsim, scene: Path, tmp_path: Path, options: list[str], words: str
    ) -> None:
        answer = hapsim("sweep", scene, "left.delay=0,1", "--out", tmp_path / "x.nc", *options)
        assert words in " ".join(answer.sentence.split())
