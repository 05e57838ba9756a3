"""Curves in files: columns, units and separators as people write them, and what is wrong with them by row."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hapsim.errors import SceneError, UsageError
from hapsim.scene import Scene, load_scene, parse_scene
from hapsim.scene.curve_file import read_curve, read_table
from hapsim.scene.rewrite import device_rewritten

MM, N = (0.0, 0.6, 1.2, 1.6), (0.0, 0.45, 0.575, -0.375)
POINTS = tuple(zip((0.0, 6e-4, 1.2e-3, 1.6e-3), N, strict=True))
SCENE = """\
version: 1
rate: 1000
device: {{mass: 0.2, friction: 1.0{more}}}
modules:
  hand: {{type: device, channel: 0}}
  base: {{type: ground}}
  key: {{type: nonlinear, between: [hand, base], force_over_distance: {value}}}
"""


def rows(separator: str = ",", point: str = ".", head: str = "mm,N") -> str:
    """The points in the manner of a file."""
    lines = [head.replace(",", separator)]
    lines += [separator.join(str(one).replace(".", point) for one in pair) for pair in zip(MM, N, strict=True)]
    return "\n".join(lines) + "\n"


@pytest.fixture
def scene_with(tmp_path: Path) -> Callable[..., Scene]:
    """Writes a curve and a scene beside it, and loads that."""

    def load(curve: str | bytes, value: str = "curve.csv", more: str = "") -> Scene:
        (tmp_path / "curve.csv").write_bytes(curve if isinstance(curve, bytes) else curve.encode())
        (tmp_path / "scene.yaml").write_text(SCENE.format(value=value, more=more), encoding="utf-8")
        return load_scene(tmp_path / "scene.yaml")

    return load


def curve_in(scene: Scene) -> object:
    return scene.modules["key"].force_over_distance


@pytest.mark.parametrize(
    "text",
    [
        rows(),
        rows(";", ","),
        rows("\t", ","),
        rows("\t"),
        rows().replace("\n", "\r\n\r\n"),
        rows(head="Distance (mm),Force [N]"),
        rows(head="travel / mm,force in N"),
        rows(head="travel_mm,force_N"),
        "Made by a rig\nspeed,0.5\n" + rows(),
        "".join(f'"{x}","{f}"\n'.replace(".", ",") for x, f in (("mm", "N"), *zip(MM, N, strict=True))),
        "No.,Force,Unit,Travel,Unit,\n" + "".join(f"{i},{f},N,{x},mm,\n" for i, (x, f) in enumerate(zip(MM, N))),  # noqa: B905
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_curve_is_read_however_it_is_written(scene_with: Callable[..., Scene], text: str, encoding: str) -> None:
    assert curve_in(scene_with(text.encode(encoding))) == POINTS


def test_numbers_are_in_si_units_to_the_last_bit(scene_with: Callable[..., Scene]) -> None:
    numbers = [f"{0.1 * i:.1f}" for i in range(400)]
    found = curve_in(scene_with("mm,gf\n" + "".join(f"{one},{one}\n" for one in numbers)))
    written = "[" + ", ".join(f"[{one} mm, {one} gf]" for one in numbers) + "]"
    assert found == curve_in(parse_scene(SCENE.format(value=written, more="")))


@pytest.mark.parametrize("angle", ["deg", "°", "rad"])
def test_a_rotary_curve_answers_in_its_units(scene_with: Callable[..., Scene], angle: str) -> None:
    scene = scene_with(rows(";", head=f"{angle};mN·m"), more=", motion: rotary")
    per = 1.0 if angle == "rad" else np.pi / 180.0
    np.testing.assert_allclose(curve_in(scene), [(x * per, 1e-3 * force) for x, force in zip(MM, N, strict=True)])
    assert scene.units(0.002, "N") == "2 mN·m"
    assert scene.units(per, "m") in ("1°", "1 rad")


def test_the_scene_knows_its_files_and_its_record_has_the_points(
    scene_with: Callable[..., Scene], tmp_path: Path
) -> None:
    scene = scene_with(rows(), "sub/../curve.csv") if (tmp_path / "sub").mkdir() is None else None
    assert scene is not None
    assert scene.files == (f"{tmp_path}/sub/../curve.csv",)
    again = parse_scene(json.dumps(scene.document))
    assert (curve_in(again), again.files) == (POINTS, ())


def test_a_shared_curve_stands_in_each_link(scene_with: Callable[..., Scene]) -> None:
    scene = scene_with(
        rows(), "&c curve.csv}\n  other: {type: nonlinear, between: [hand, base], force_over_distance: *c"
    )
    assert curve_in(scene) == scene.modules["other"].force_over_distance == POINTS
    assert len(scene.files) == 1


def test_identify_writes_into_a_scene_with_a_curve(scene_with: Callable[..., Scene]) -> None:
    path = scene_with(rows()).path
    assert path is not None
    assert "mass: 0.25" in device_rewritten(Path(path).read_text("utf-8"), {"mass": "0.25"}, 0, path)


HEAD = "expected a head with the units of distances and forces"
NUMBERS = "expected a number in N"
CURVE = "hapsim curve {file} -o NEW.csv"


@pytest.mark.parametrize(
    ("text", "row", "sentence"),
    [
        ("", 1, f"found nothing, {HEAD}"),
        ("0,0\n1,2\n", 1, f"found '0,0', {HEAD}"),
        ("mm,g\n0,0\n", 1, "Is g meant to be gf?"),
        ("mm,N\n0,0\n1,much\n", 3, f"found 'much', {NUMBERS}"),
        ("mm,N\n0,0\n1\n", 3, f"found nothing in column 2, {NUMBERS}"),
        ("mm,N\n0,0\n1,nan\n", 3, f"found 'nan', {NUMBERS}"),
        ("mm,N\n0,0\n1,1e300\n", 3, "expected at most 1e+12 in size"),
        ("mm,N\n", 1, "found no numbers, expected two distances or more"),
        ("mm,N\n0,0\n", 2, "found one distance, expected two distances or more"),
        ("mm,N\n0,5,1,5\n1,0,2,0\n", 2, "is the comma a decimal one? Then separate columns by semicolons"),
        ("mm,N\n0,0\n1,1\n1,2\n", 4, "found 1 mm after 1 mm, expected ascending distances"),
        ("mm,N\n0,0\n1,1\n0.5,2\n", 4, "found 0.5 mm after 1 mm, expected ascending distances"),
        ("mm,N,N\n0,0,0\n1,1,0.5\n2,1,1.5\n", 4, "expected as much or more, or the link would give energy"),
        (
            "mm,N,N,N\n0,0,0,0\n",
            1,
            "columns mm, N, N, N, expected one of distances, and one of forces or two",
        ),
        ("mm,N·m\n0,0\n", 1, "all of a line, or of turns"),
        ("mm,N,mm,N\n0,0,0,0\n1,1,1,1\n", 1, "found two columns of distances, expected one"),
        (
            "deg,mN·m\n0,0\n1,1\n",
            1,
            "found deg and mN·m, expected a length (m), such as 0.05 m or 50 mm, and a force",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_reported_by_row(
    scene_with: Callable[..., Scene], tmp_path: Path, text: str, row: int, sentence: str
) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with(text)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"{tmp_path}/scene.yaml:7:70: force_over_distance: {tmp_path}/curve.csv:{row}: ")
    assert sentence in line


def test_a_recording_is_no_curve_and_the_way_is_reported(scene_with: Callable[..., Scene], tmp_path: Path) -> None:
    most = "mm,N\n" + "".join(f"{i},1\n" for i in range(1000))
    assert len(curve_in(scene_with(most))) == 1000  # type: ignore[arg-type]
    way = CURVE.format(file=tmp_path / "curve.csv")
    with pytest.raises(SceneError, match=f"found 1001 rows, expected a curve of at most 1000; `{way}` makes one"):
        scene_with(most + "1000,1\n")


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ("none.csv", "none.csv: no such file, expected a curve in CSV"),
        ("curve.cvs", "no such file, expected a curve in CSV; did you mean 'curve.csv'?"),
        (".", "found a directory, expected a file with a curve in CSV"),
        ("{file: [1], turn: 1 mm}", "found no name at file, expected {file: the name of a file, turn: a distance}"),
        ("{file: curve.csv, press: [[0, 0], [1, 1]]}", "found 'press' at file, expected {file: "),
        ("{file: curve.csv, turn: 1 mm}", "expected two columns of forces there: press and release"),
        ("5", "expected a list of 2 to 1000 points [m, N]"),
    ],
)
def test_what_names_no_curve_is_refused(scene_with: Callable[..., Scene], value: str, sentence: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with(rows(), value)
    assert sentence in str(caught.value)
    assert "scene.yaml:7:" in str(caught.value)


def test_all_faults_of_a_scene_are_reported_with_those_of_its_curve(scene_with: Callable[..., Scene]) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with("mm,N\n0,x\n", more=", delay: -1")
    first, second = str(caught.value).splitlines()
    assert "delay" in first
    assert "found 'x'" in second
    assert len(caught.value.files) == 1


def test_a_scene_that_is_sent_reads_no_file(scene_with: Callable[..., Scene], monkeypatch: pytest.MonkeyPatch) -> None:
    path = scene_with(rows()).path
    monkeypatch.chdir(Path(str(path)).parent)
    text = Path(str(path)).read_text("utf-8")
    with pytest.raises(SceneError, match=r"found the file 'curve\.csv', expected points: a scene that is"):
        parse_scene(text)
    assert curve_in(parse_scene(text, folder="")) == POINTS


def test_units_that_a_file_lacks_are_given(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_text("force,travel,judge\n0,0,OK\n98.0665,1,OK\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"hapsim curve .* --units UNITS"):
        read_curve(str(path))
    table = read_table(str(path), "gf,mm")
    np.testing.assert_allclose([*table.of("m"), *table.of("N")], [[0.0, 1e-3], [0.0, 0.980665 * 0.980665]], rtol=1e-3)
    for units, sentence in (("gf,x", "expected a unit for each column"), ("-,-,gf,mm", "no row with a number")):
        with pytest.raises(UsageError, match=sentence):
            read_table(str(path), units)
