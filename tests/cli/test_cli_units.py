"""Text and data of every command for a scene whose file has units: text in these units, data in SI units."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Hapsim = Callable[..., Any]

SCENE = """\
version: 1
rate: 1000
device: {clock: lockstep, mass: 200 g, friction: 1000 mN·s/m, travel: [-10 cm, 10 cm],
         force_limit: 8000 mN, energy_limit: 500 mJ}
mock: {initial: {position: 0 cm}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  TOUCH
"""
TOUCHES = {
    "spring": "touch: {type: viscoelastic, between: [hand, wall], stiffness: 20 N/cm, damping: 5000 mN·s/m}",
    "contact": "touch: {type: buffer, between: [hand, wall], stiffness: 20 N/cm, damping: 5000 mN·s/m}",
}
#: By the unit of the file: the SI unit that stands in its place without it, and how many of the former are one.
UNITS = {"g": ("kg", 1e3), "mN·s/m": ("N·s/m", 1e3), "mN": ("N", 1e3), "N/cm": ("N/m", 0.01), "mJ": ("J", 1e3)}
SI, LENGTHS = [si for si, _ in UNITS.values()], ["m", "mm"]
NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"


@pytest.fixture(params=TOUCHES)
def scenes(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    """A scene with units, and the same without."""
    text = SCENE.replace("TOUCH", TOUCHES[request.param])
    factors = {name: factor for name, (_, factor) in UNITS.items()} | {"cm": 100.0}

    def bare(found: re.Match[str]) -> str:
        return repr(float(found[1]) / factors[found[2]])

    for name, each in (("units", text), ("si", re.sub(rf"({NUMBER}) ([^\s,}}\]]+)", bare, text))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "scene.yaml").write_text(each, encoding="utf-8")
    return tmp_path / "units" / "scene.yaml", tmp_path / "si" / "scene.yaml"


def quantities(text: str, units: list[str]) -> dict[str, list[float]]:
    """Numbers by unit: those before it, and those in a table's row or column of this unit."""
    found: dict[str, list[float]] = {unit: [] for unit in units}
    columns: list[str] = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in re.split("[│┃]", line)]
        if "┃" in line:
            columns = [cell.rpartition("  ")[2] for cell in cells]
        row = cells[1].rpartition("  ")[2] if len(cells) > 2 else ""
        for cell, column in zip(cells, columns, strict=False):
            for unit in {row, column} & {*units} if "%" not in cell else ():
                found[unit] += [float(one) for one in re.findall(rf"(?<![\w.]){NUMBER}", cell)]
        for number, unit in re.findall(rf"({NUMBER}) ?([^\s\d;:,.()]+)", line):
            if unit in units:
                found[unit].append(float(number))
    return found


def held_regions(text: str) -> list[list[float]]:
    """K, B, felt k and felt b of each row of a table by regions in which a spring holds the hand."""
    lines = text.partition("By region")[2].partition("With `law: board`")[0].splitlines()
    rows = [re.findall(rf"(?<= ){NUMBER}(?= )", line) for line in lines if line.startswith(" ") and " stable" in line]
    return [[float(one) for one in row[-4:]] for row in rows if len(row) >= 4]


ON_BOTH = ["check", "check --explain", "measure --at=-1mm", "run --duration 0.2", "chart plane", "chart force"]
ON_ONE = [
    ("check --hand-mass 0:0.5 --hand-stiffness 0:500", "contact"), ("measure --at=-0.001 --explain", "contact"),
    ("measure --impedance --duration 3", "spring"), ("identify --duration 0.4", "spring"),
    ("chart transparency", "spring"), ("chart table1", "spring"),
]  # fmt: skip


@pytest.mark.thorough(keep=4)
@pytest.mark.usefixtures("coarse_planes")
@pytest.mark.parametrize(
    ("command", "scenes"),
    [*((command, touch) for command in ON_BOTH for touch in TOUCHES), *ON_ONE],
    indirect=["scenes"],
)
def test_text_is_in_the_units_of_the_file(command: str, scenes: tuple[Path, Path], hapsim: Hapsim) -> None:
    draws = command.startswith("chart")
    each = [
        hapsim(
            *command.split(),
            scene,
            *(["--picture", scene.with_suffix(".svg"), "--data", scene.with_suffix(".csv")] if draws else []),
        )
        for scene in scenes
    ]
    assert [one.status for one in each] == [0, 0], each[0].err
    there, here = (one.out for one in each)
    of_si, of_file = quantities(here, [*SI, *LENGTHS]), quantities(there, [*UNITS, "cm"])
    for unit, (si, factor) in UNITS.items():
        assert of_file[unit] == pytest.approx([factor * one for one in of_si[si]], rel=0.1), unit
    rows, rows_of_si = held_regions(there), held_regions(here)
    assert rows or command != "chart force"
    assert rows == [pytest.approx([0.01 * K, 1e3 * B, 0.01 * k, 1e3 * b], rel=1e-3) for K, B, k, b in rows_of_si]
    assert len(of_file["cm"]) == len(of_si["m"]) + len(of_si["mm"])
    least = {"chart transparency": 0, "run --duration 0.2": 0, "chart plane": 1, "chart force": 0}.get(command, 5)
    assert sum(map(len, of_file.values())) >= least
    assert not any(quantities(there, [*SI, *LENGTHS]).values())
    if draws:
        assert scenes[0].with_suffix(".csv").read_text() == scenes[1].with_suffix(".csv").read_text()


@pytest.mark.thorough(keep=1)
@pytest.mark.usefixtures("coarse_planes")
def test_a_correction_and_the_end_of_an_axis_are_in_the_units_of_the_file(
    scenes: tuple[Path, Path], hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("_explanation", "board_sentences"):  # all of which the test above sees
        monkeypatch.setattr(f"hapsim.cli.check.{name}", lambda *_: ())
    for scene in scenes:
        text = scene.read_text("utf-8").replace("lockstep,", "lockstep, correction: poles,")
        scene.with_name("corrected.yaml").write_text(text, "utf-8")
    there, here = (hapsim("check", scene.with_name("corrected.yaml"), "--explain").out for scene in scenes)
    assert ("feels what is desired within" in there) == ("buffer" not in scenes[0].read_text("utf-8"))
    of_file, of_si = quantities(there, [*UNITS]), quantities(here, SI)
    for unit, (si, factor) in UNITS.items():
        assert of_file[unit] == pytest.approx([factor * one for one in of_si[si]], rel=0.1), unit
    files = [scene.with_suffix(".csv") for scene in scenes]
    for scene, file, end in zip(scenes, files, (30, 3000), strict=True):
        words = ("--to-stiffness", end, "--picture", scene.with_suffix(".svg"), "--data", file)
        assert hapsim("chart", "plane", scene, "--simulated-stiffness", 2000, *words).status == 0
    assert files[0].read_text() == files[1].read_text()
