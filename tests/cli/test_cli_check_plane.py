"""`hapsim check` of a scene in the plane, and commands that take no such scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

Hapsim = Callable[..., Any]
Written = Callable[..., Path]

DISC = {"type": "shape", "between": ["hand", "post"], "form": {"disc": 0.02}, "stiffness": 2000.0, "damping": 5.0}


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """Writes a scene with a hand that starts pressed 1 mm onto a disc. `disc`: its keys."""

    def write(x: float = 0.011, **disc: Any) -> Path:
        document = {
            "version": 1,
            "rate": 1000,
            "space": 2,
            "device": {"mass": 0.2, "friction": 1.0, "clock": "lockstep", "force_limit": 10},
            "mock": {"initial": {"position": [x, 0.0]}},
            "modules": {
                "hand": {"type": "device", "channels": [0, 1]},
                "post": {"type": "ground", "position": [0.03, 0.0]},
                "disc": DISC | disc,
            },
        }
        path = tmp_path / "plane.yaml"
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return path

    return write


def words(told: str) -> str:
    return " ".join(told.split())


def test_a_hand_that_slides_off_is_shown_along_both_directions(hapsim: Hapsim, written: Written) -> None:
    told = hapsim("check", written()).words
    assert "at 1000 Hz: slides: hand slides off along 90°: grows e-fold in 49.42 ms (spectral radius 1.0204" in told
    assert "hand at 11, 0 mm: disc is touched" in told
    assert "hand at 0°: k 2000 2080.44 2000 N/m hand at 0°: b 6 3.02077 N·s/m" in told
    assert "hand at 90°: k -105.263 -105.328 -105.263 N/m hand at 90°: b 1 1.15864 N·s/m" in told
    assert "unstable at 1.947 times the stiffness of disc, what slides being held" in told


def test_explained_it_has_margins_and_any_hands(explained: Callable[[Path], Any], written: Written) -> None:
    told = explained(written()).words
    assert "not passive at any friction: at rest, the scene pushes the hand away" in told
    assert "│ disc │ 1.947 │ 32.74 │" in told


def test_a_document_has_matrices_and_principal_directions(hapsim: Hapsim, written: Written) -> None:
    found = hapsim("check", written(), "--json").document
    (one,), here = found["parts"], found["here"]
    assert one["device_points"] == ["hand.x", "hand.y"]
    assert [row[i] for i, row in enumerate(one["k"])] == pytest.approx([2080.439463958, -105.328041658], abs=2e-9)
    stiffest, other = one["hands"]
    assert (stiffest["angle_deg"], stiffest["k"]) == pytest.approx((0.0, 2080.439463958), abs=2e-9)
    assert (other["angle_deg"], other["b"]) == pytest.approx((90.0, 1.158643213), abs=2e-9)
    assert (found["verdict"], found["stable"], here["places_m"]["hand"]) == ("slides", False, [0.011, 0.0])
    assert here["links"]["disc"]["state"] == "touched"
    assert here["slides"][0]["e_fold_s"] == pytest.approx(0.0494215, rel=1e-5)


def test_at_a_place_of_its_own(hapsim: Hapsim, written: Written) -> None:
    """In the units of the option; the next command has the same place."""
    told = hapsim("check", written(), "--at", "5mm,0.003").words
    assert "at 1000 Hz: stable" in told
    assert "hand at 5, 3 mm: no contact is touched" in told
    assert "Stable at 3 unlike places where its links touch; others are not judged (--at, --along)" in told
    assert told.endswith("plane.yaml")
    assert hapsim("check", written(friction_coefficient=0.3), "--at", "11mm,0").words.endswith("plane.yaml --at=11mm,0")


def test_a_place_behind_a_wall_is_not_recommended_to_measure(hapsim: Hapsim) -> None:
    told = hapsim("check", "configs/maze.yaml", "--at=-2mm,0").out
    assert told.splitlines()[-1].startswith("Next: hapsim run ")
    assert "wall1 is in the way" in hapsim("measure", "configs/maze.yaml", "--at=-2mm,0").sentence


UNDAMPED = """
version: 1
rate: 1000
space: 2
device: {clock: lockstep, mass: 0.2, friction: 1.0}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground, position: [0.03, 0]}
  ball: {type: mass, mass: 0.05, position: [0.02, 0.04]}
  box: {type: shape, between: [hand, post], form: {box: [0.02, 0.02]}, stiffness: 1500, damping: 4}
  rope: {type: spring, between: [ball, post], length: 0.05, stiffness: 500}
  hb: {type: spring, between: [hand, ball], length: 0.02, stiffness: 100}
"""


def test_each_growing_motion_is_listed_once_with_the_links_that_do_not_damp_it(
    hapsim: Hapsim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hapsim.prediction.verdict_words.ways_to_stability", lambda _: "")  # which takes seconds
    path = tmp_path / "undamped.yaml"
    path.write_text(UNDAMPED)
    lines = hapsim("check", path).words
    told = "Nothing damps ball: rope and hb have no damping"
    assert told in lines
    assert lines.count("Unstable while hand is at 0, 0 mm: the motion of ball") == 1
    path.write_text(
        UNDAMPED.replace(
            "spring, between: [hand, ball], length: 0.02,", "viscoelastic, between: [hand, ball], damping: 0.5,"
        )
    )
    assert told not in hapsim("check", path).words


def test_a_wall_that_is_too_stiff_is_reported_before_it_is_touched(hapsim: Hapsim, written: Written) -> None:
    path = written(0.0, stiffness=8000.0)
    told = hapsim("check", path).words
    assert "unstable (spectral radius 1.0156" in told
    assert "Unstable while disc is touched with hand at 49.32, 4.762 mm: the motion of hand grows e-fold in" in told
    assert ("no link makes it unstable here" in told, "assumptions" in told) == (True, False)
    assert "oscillates with up to the force limit of 10 N" in told
    refused = hapsim("run", path, "--duration", "0.1")
    assert (refused.status, "grows by 1.6 % per sample while disc is touched" in refused.err) == (2, True)


def test_along_a_line_it_lists_what_the_hand_touches(hapsim: Hapsim, written: Written) -> None:
    path = written()
    rows = [words(row) for row in hapsim("check", path, "--along", "0,0:60mm,10mm").out.splitlines()[2:5]]
    assert rows == [
        "0, 0 10.07, 1.678 none 0 0° 0 stable",
        "10.07, 1.678 48.31, 8.051 disc 2080 99.46° -6345 slides",
        "48.31, 8.051 60, 10 none 0 0° 0 stable",
    ]
    found = hapsim("check", path, "--along", "0,0:60mm,10mm", "--json").document["stretches"]
    assert [one["verdict"] for one in found] == ["stable", "slides", "stable"]
    assert found[1]["links"] == {"disc": "touched"}
    assert found[1]["principal"][0]["k"] == pytest.approx(2080.439463958, abs=2e-9)


def test_the_middle_of_a_wall_is_printed_as_zero(hapsim: Hapsim, written: Written) -> None:
    """Halving finds the place where the sides change to some 1e-15 m."""
    path = written(0.0, form={"box": [0.04, 0.004]})
    told = hapsim("check", path, "--along", "30mm,10mm:30mm,-5mm").out
    assert [words(row).partition(" post")[0].partition(" disc")[0] for row in told.splitlines()[3:5]] == [
        "30, 2 30, 0",
        "30, 0 30, -2",
    ]


def test_it_fits_eighty_columns(hapsim: Hapsim, written: Written, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written()
    monkeypatch.setenv("COLUMNS", "80")
    for more in ((), ("--along", "0,0:60mm,10mm")):
        lines = hapsim("check", path, *more).out.splitlines()
        assert max(len(line) for line in lines if str(path) not in line) <= 80


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("check", "--at", "0.03"), "--at: found 0.03, expected X,Y in a scene with space: 2"),
        (("check", "--at", "0.03,left"), "--at: found '0.03,left', expected X,Y, such as 0.01,0 or 10mm,0"),
        (("check", "--at", "0.01,0.02,0.03"), "--at: found '0.01,0.02,0.03', expected X,Y"),
        (("check", "--along", "0,0"), "--along: found '0,0', expected X,Y:X,Y, such as 0,0:0.01,0 or 0,0:10mm,0"),
        (("couple",), "found space: 2, expected a scene with one coordinate: virtual couplings are"),
        (("chart", "plane"), "found space: 2, expected a scene with one coordinate"),
        (("chart", "felt"), "found space: 2, expected a scene with one coordinate"),
    ],
)
def test_what_does_not_fit_is_refused_in_words(hapsim: Hapsim, written: Written, command: Any, words: str) -> None:
    name, *more = command
    answer = hapsim(name, *more, written())
    assert (answer.status, words in " ".join(answer.err.split())) == (2, True), answer.err
