"""`hapsim measure --impedance`: its tables, its document, its files, and its sentences."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Hapsim = Callable[..., Any]
CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture
def first_touch(tmp_path: Path) -> Path:
    """File of first_touch, in virtual time."""
    text = (CONFIGS / "first_touch.yaml").read_text().replace("clock: device", "clock: lockstep")
    path = tmp_path / "first_touch.yaml"
    path.write_text(text)
    return path


def test_the_document_has_predicted_and_measured_and_the_files_have_the_same_numbers(
    hapsim: Hapsim, first_touch: Path
) -> None:
    files = {"--picture": "z.png", "--data": "z.csv", "--record": "z.npz"}
    words = [word for option, name in files.items() for word in (option, first_touch.with_name(name))]
    answer = hapsim("measure", first_touch, "--impedance", "--z-width", "--json", *words)
    assert answer.status == 0
    found = answer.document["impedance"]
    assert found["device_points"] == ["hand"]
    assert found["off_by_uncertainties"].keys() == {"device", "rendered", "closed_loop"}
    assert max(found["off_by_uncertainties"].values()) <= 1.0
    assert found["cautions"] == []
    assert found["periods"][0] >= 4
    width = answer.document["z_width"]["hand"]
    assert width["passive"]["stiffness"] == pytest.approx(828.427, rel=1e-5)
    predicted, measured = width["passive"]["predicted"], width["passive"]["measured"]
    assert measured["mean_db"] == pytest.approx(predicted["mean_db"], abs=measured["mean_uncertainty_db"])
    assert measured["mean_uncertainty_db"] < 0.1
    assert width["stable"]["measured"] is None
    with first_touch.with_name("z.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["frequency_Hz"]) for row in rows] == found["frequency_hz"]
    for n, row in enumerate(rows):
        for kind in ("device", "rendered", "closed_loop"):
            measured = found["measured"][kind]
            value = [float(row[f"{kind}_measured_{part}_Ns_per_m"]) for part in ("re", "im")]
            assert value == measured["value"][n][0][0]
            assert float(row[f"{kind}_uncertainty_Ns_per_m"]) == measured["uncertainty"][n][0][0]
    assert first_touch.with_name("z.png").stat().st_size > 10_000
    assert first_touch.with_name("z.npz").exists()


def test_people_read_tables_and_whether_both_agree(hapsim: Hapsim, tmp_path: Path) -> None:
    picture = tmp_path / "matrix.svg"
    answer = hapsim("measure", CONFIGS / "two_hands.yaml", "--impedance", "--picture", picture)
    assert answer.status == 0
    for words in (
        "Rendered impedance at left, channel 0, N·s/m",
        "Closed loop's impedance at right, channel 1, N·s/m",
        "The rendered impedance: prediction and measurement agree within the uncertainty at all",
        "Channel 1 was excited with up to 2.2 N",
        "Z-width: from the device alone to its stiffest wall, mean dB",
    ):
        assert words in answer.out
    assert picture.read_text().count('id="axes_') == 4
    one = hapsim("measure", CONFIGS / "two_hands.yaml", "--impedance", "--channel", "1", "--duration", "3")
    assert "at right" in one.out
    assert "at left" not in one.out


def test_it_names_what_is_not_linear(hapsim: Hapsim, tmp_path: Path) -> None:
    text = (CONFIGS / "wall.yaml").read_text().replace("clock: device", "clock: lockstep")
    (tmp_path / "wall.yaml").write_text(text)
    answer = hapsim("measure", tmp_path / "wall.yaml", "--impedance")
    assert answer.status == 0
    assert "measured is the impedance about the motion to which it was excited" in answer.out
    assert "prediction and measurement do not agree: at" in answer.out  # the hand is beside the wall, not in it


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--push", "-1"], "push: found -1, expected a finite number of newton above 0"),
        (["--impedance", "--push", "0"], "push: found 0, expected a finite number of newton above 0"),
        (["--impedance", "--travel", "-1"], "travel: found -1, expected a finite number of metres above 0"),
        (["--impedance", "--duration", "1"], "duration: found 1 s, expected at least 3 s"),
        (["--impedance", "--channel", "3"], "--channel 3: the scene has nothing there; its device points are on: 0"),
        (["--impedance", "--picture", "z.txt"], "found the ending '.txt', expected .svg, .png, .pdf"),
    ],
)
def test_wrong_options_get_a_sentence(hapsim: Hapsim, first_touch: Path, words: list[str], sentence: str) -> None:
    assert sentence in hapsim("measure", first_touch, *words).refusal
