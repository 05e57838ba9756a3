"""`hapsim measure` of a hand in the plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Hapsim = Callable[..., Any]
RING = """version: 1
rate: 1000
space: 2
device: {mass: 0.2, friction: 1.0, clock: lockstep}
mock: {quantum: 1.0e-11}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground, position: [-20 mm, 0]}
  ring: {type: shape, between: [hand, post], form: {disc: 20 mm}, side: inside, stiffness: 2000, damping: 5}
"""


@pytest.fixture
def ring(tmp_path: Path) -> Path:
    path = tmp_path / "ring.yaml"
    path.write_text(RING)
    return path


def test_both_directions_are_compared_with_the_prediction(hapsim: Hapsim, ring: Path) -> None:
    answer = hapsim("measure", ring, "--at", "1mm,0", "--duration", "4")
    assert answer.status == 0
    assert "What hand feels at 1, 0 mm, along the two principal directions, on the built-in mock" in answer.out
    rows = [line.split("│")[1:-1] for line in answer.out.splitlines() if line.count("│") == 6]
    assert [row[0].split()[0] for row in rows] == ["direction", "k", "b"] * 2
    predicted, measured = ([float(row[i]) for row in rows] for i in (1, 2))
    assert predicted == pytest.approx([0.0, 2080.43946, 3.0207740, 90.0, 95.1850986, 0.85669425], rel=1e-6)
    assert measured == pytest.approx(predicted, rel=2e-5, abs=1e-3)
    assert "hapsim run" in answer.out


def test_the_document_has_matrices_and_directions(hapsim: Hapsim, ring: Path, tmp_path: Path) -> None:
    record = tmp_path / "ring.trace"
    document = hapsim("measure", ring, "--at", "0.001,0", "--duration", "4", "--json", "--record", record).document
    assert document["at_m"] == [0.001, 0.0]
    for side in ("predicted", "measured"):
        found = document[side]
        assert found["k"][0][0] == pytest.approx(2080.439463958, rel=1e-4)
        assert found["b"][1][1] == pytest.approx(0.856694249, rel=1e-3)
        stiff, soft = found["principal"]
        assert (stiff["k"], soft["k"]) == pytest.approx((found["k"][0][0], found["k"][1][1]), rel=1e-6)
        assert math.sin(math.radians(stiff["angle_deg"])) == pytest.approx(0.0, abs=1e-4)
    assert [path.name for path in sorted(tmp_path.glob("ring.*.trace"))] == ["ring.0.trace", "ring.1.trace"]
    for option in ("--at=0.001,0", "--impedance"):  # before anything is armed
        again = hapsim("measure", ring, option, "--record", record)
        assert (again.status, f"{tmp_path / 'ring.0.trace'}: the file exists; --overwrite" in again.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["--at", "0.001"], "--at: found 0.001, expected X,Y in a scene with space: 2"),
        (["--channel", "7"], "channel 7: the scene has nothing there; its device points are on: 0, 1"),
        (["--at", "-0.03,0"], "at: -30,0 mm, no link touches the hand, so there is no spring to measure"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(hapsim: Hapsim, ring: Path, words: list[str], found: str) -> None:
    refusal = hapsim("measure", ring, *words).refusal
    assert found in " ".join(refusal.split())


def test_a_hand_that_slides_off_is_reported(hapsim: Hapsim, ring: Path) -> None:
    ring.write_text(RING.replace("side: inside, ", "").replace("[-20 mm", "[20 mm"))
    refusal = hapsim("measure", ring, "--at", "0.001,0").refusal
    assert "the hand slides off along 90°: its distance grows e-fold in 49.4" in refusal


def test_a_place_is_that_of_the_measured_hand(hapsim: Hapsim, ring: Path) -> None:
    """The first of two hands is free, the second is in the ring."""
    ring.write_text(RING.replace("  hand:", "  free: {type: device, channels: [2, 3]}\n  hand:"))
    document = hapsim("measure", ring, "--at", "1mm,0", "--channel", "0", "--json").document
    for side in ("predicted", "measured"):
        assert document[side]["k"][0][0] == pytest.approx(2080.439463958, rel=1e-4)
