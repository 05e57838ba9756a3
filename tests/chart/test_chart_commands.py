"""`hapsim chart …`: pictures in every format, their numbers, the summary for scripts, and what is refused."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from hapsim.chart.felt_chart import DRAWN
from hapsim.chart.figure import figure_to, save_rows
from hapsim.cli.chart_hand import _band
from hapsim.errors import UsageError
from hapsim.prediction import predict, predict_impedance
from hapsim.prediction.felt_alone import Tolerance
from hapsim.scene import Scene, load_scene
from hapsim.theory import Configuration
from hapsim.whole_file import whole_file

Chart = Callable[..., Any]
SceneFile = Callable[..., Path]
RowsOf = Callable[[str], list[dict[str, str]]]
BEGINS = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF"}
CALLS = {
    "plane": ["plane", "spring", "--to-damping", "20"],
    "family": ["plane", "spring", "--mass", "0.1,0.4"],
    "paper": ["plane", "--hold", "impulse", "--normalised", "--friction", "0.5", "--total-damping"],
    "transparency": ["transparency", "spring"],
    "table1": ["table1", "spring"],
    "felt": ["felt", "spring"],
}


@pytest.mark.thorough(keep=2)
@pytest.mark.usefixtures("coarse_felt")
@pytest.mark.parametrize(
    "picture", ["plane.png", "transparency.pdf", "table1.svg", "family.svg", "paper.pdf", "felt.png"]
)
def test_every_picture_is_drawn_in_every_format_and_nothing_is_clipped(
    chart: Chart, scene_file: SceneFile, monkeypatch: pytest.MonkeyPatch, rows_of: RowsOf, picture: str
) -> None:
    save = Figure.savefig

    def save_what_fits(figure: Figure, *arguments: Any, **options: Any) -> None:
        save(figure, *arguments, **options)
        drawn, width, height = figure.get_tightbbox(), *figure.get_size_inches()
        assert -0.01 <= drawn.x0 < drawn.x1 <= width + 0.01
        assert -0.01 <= drawn.y0 < drawn.y1 <= height + 0.01

    monkeypatch.setattr(Figure, "savefig", save_what_fits)
    words = [scene_file("spring") if word == "spring" else word for word in CALLS[Path(picture).stem]]
    answer = chart(*words, "--picture", picture, "--data", "numbers.csv")
    assert answer.status == 0
    assert f"Picture: {picture}" in answer.out
    assert Path(picture).read_bytes().startswith(BEGINS[Path(picture).suffix])
    assert len(rows_of("numbers.csv")[0]) >= 5


def test_left_out_the_picture_has_the_name_of_the_command(chart: Chart, scene_file: SceneFile) -> None:
    assert "Picture: transparency.svg" in chart("transparency", scene_file("spring")).out
    assert Path("transparency.svg").read_bytes().startswith(BEGINS[".svg"])


def test_a_hand_that_feels_nothing_can_be_drawn(chart: Chart, scene_file: SceneFile, rows_of: RowsOf) -> None:
    answer = chart("transparency", scene_file("nothing", friction=0.0), "--picture", "of.svg", "--data", "of.csv")
    assert "At no frequency does the scene give energy" in answer.out
    assert Path("of.svg").read_bytes().startswith(BEGINS[".svg"])
    assert {float(row["rendered_Ns_per_m"]) for row in rows_of("of.csv")} == {0.0}


def test_a_hand_that_moves_masses_is_drawn_as_the_scene_has_it(
    chart: Chart, scene_file: SceneFile, rows_of: RowsOf
) -> None:
    answer = chart("transparency", scene_file("coupled"), "--picture", "of.svg", "--data", "of.csv", "--json")
    assert Path("of.svg").read_bytes().startswith(BEGINS[".svg"])
    rows, predicted = rows_of("of.csv"), predict(load_scene(scene_file("coupled")))
    at = np.array([float(row["frequency_Hz"]) for row in rows])
    impedance = predict_impedance(predicted.scene, at)
    for name, wanted in (("desired", impedance.desired), ("rendered", impedance.rendered)):
        k, b = (np.array([float(row[f"{name}_{one}"]) for row in rows]) for one in ("k_N_per_m", "b_Ns_per_m"))
        np.testing.assert_allclose(k / (2j * np.pi * at) + b, wanted[:, 0, 0], rtol=1e-9)
    own = predicted.parts[0].own_motion
    assert (answer.document["hand"]["k"], answer.document["hand"]["b"]) == ((own.k, own.b) if own else (None, None))
    for mode in predicted.modes:  # a sharp resonance is not missed
        assert mode.damping_ratio > 0.3 or min(abs(at - mode.frequency_hz)) < 1e-6


@pytest.mark.thorough
def test_where_what_is_desired_is_felt_within_a_tenth_alone_the_other_share_has_none(chart: Chart) -> None:
    out = chart("felt", "button", "--over", "device.friction", "--picture", "button.svg").out
    none = next(line.split("│")[1:-1] for line in out.splitlines() if "│ none" in line)
    assert [cell.strip() == "–" for cell in none] == [False, True, False]


def test_what_drifts_is_no_frequency(chart: Chart, tmp_path: Path, rows_of: RowsOf) -> None:
    path = tmp_path / "free.yaml"
    path.write_text(
        "version: 1\nrate: 1000\ndevice: {mass: 0.2, friction: 1, clock: lockstep}\nmodules:\n"
        "  hand: {type: device, channel: 0}\n  ball: {type: mass, mass: 0.02}\n"
        "  tie: {type: spring, between: [hand, ball], stiffness: 300}\n"
    )
    answer = chart("transparency", path, "--data", "of.csv", "--json")
    assert float(rows_of("of.csv")[0]["frequency_Hz"]) >= 0.01
    assert answer.document["hand"]["frequency_hz"] is None or answer.document["hand"]["frequency_hz"] < 1e-3
    assert len(answer.document["gives_energy_hz"]) <= 3


def test_an_end_of_the_picture_is_no_end_of_a_band() -> None:
    words = {(1.0, 500.0): "at every frequency drawn", (1.0, 20.0): "below 20 Hz", (20.0, 500.0): "above 20 Hz"}
    for band, expected in (words | {(20.0, 30.0): "from 20 to 30 Hz"}).items():
        assert _band(*band, 1.0, 500.0) == expected


@cache
def tolerance_of(scene: Scene) -> Tolerance:
    return predict(scene).parts[0].tolerances((0.05,))[0]


@pytest.mark.thorough
@pytest.mark.parametrize("over", ["device.mass", "device.friction", "device.delay"])
def test_how_well_the_device_has_to_be_known_is_drawn(
    chart: Chart, scene_file: SceneFile, rows_of: RowsOf, over: str
) -> None:
    words = ["--over", over, "--picture", "of.png", "--data", "of.csv", "--json"]
    found = chart("felt", scene_file("spring"), *words).document["within"]
    assert Path("of.png").read_bytes().startswith(BEGINS[".png"])
    declared = 0.2 if over == "device.mass" else 1.0
    for correction in ("poles", "predictor"):
        one = tolerance_of(load_scene(scene_file("spring", correction=correction)))
        assert found[correction][0] == list(getattr(one, over.removeprefix("device.")))
        for row in rows_of("of.csv"):
            true = float(row[over]) * (declared if over == "device.mass" else 1.0)
            errors = [abs(float(row[f"{correction}_{part}_error"])) for part in ("k", "b")]
            if found[correction][0][0] < true < found[correction][0][1]:
                assert max(errors) <= 0.05 + 1e-9
    assert found["none"] == [None, None]
    assert tuple(found) == DRAWN  # the law on the board is no correction


@pytest.mark.parametrize("only", [["--data", "numbers.csv"], ["--json"]])
def test_who_asks_for_numbers_only_gets_no_picture(chart: Chart, scene_file: SceneFile, only: list[str]) -> None:
    answer = chart("transparency", scene_file("spring"), *only)
    assert (answer.status, answer.err) == (0, "")
    assert not list(Path().glob("*.svg"))


def test_the_numbers_of_a_plane_are_those_of_the_theory_to_the_last_digit(chart: Chart, rows_of: RowsOf) -> None:
    assert chart("plane", "--normalised", "--hold", "impulse", "--delay", "1", "--data", "numbers.csv").status == 0
    curves = [row for row in rows_of("numbers.csv") if row["curve"] in ("iso_k", "iso_b", "stability_limit")]
    names = ("K_T2_per_m", "B_T_per_m", "k_T2_per_m", "b_T_per_m")
    K, B, k, b = (np.array([float(row[name]) for row in curves]) for name in names)
    expected = Configuration(mass=1.0, rate=1.0, hold="impulse", delay=1.0).simulated(k, b)
    drawn = np.isfinite(K)
    assert np.array_equal(K[drawn], expected[0][drawn])
    assert np.array_equal(B[drawn], expected[1][drawn])


def test_the_summary_of_a_plane_names_what_is_felt_and_what_is_stable(chart: Chart, scene_file: SceneFile) -> None:
    answer = chart("plane", scene_file("spring"), "--json", "--picture", "p.png")
    (hand,) = answer.document["hands"]
    device = Configuration(mass=0.2, rate=1000.0, friction=1.0)
    assert (hand["k"], hand["b"]) == pytest.approx(device.equivalent(2000.0, 5.0))
    assert hand["stable_stiffness"] == pytest.approx(device.stable_stiffness(5.0))
    assert hand["stable_damping"] == pytest.approx(device.stable_damping(2000.0))
    assert answer.document["picture"] == "p.png"
    assert Path("p.png").exists()


def test_a_family_states_what_each_mass_feels(chart: Chart, scene_file: SceneFile) -> None:
    """The chart has one family per mass, for a list or for the span of a scene; --mass replaces the span."""
    given = chart("plane", scene_file("spring"), "--mass", "0.4", "--mass", "0.1,0.2", "--json")
    span = scene_file("spring", mass={"from": 0.1, "to": 0.4})
    for hands in (given.document["hands"], chart("plane", span, "--data", "n.csv", "--json").document["hands"]):
        assert [hand["mass"] for hand in hands] == pytest.approx([0.1, 0.2, 0.4])
        for hand in hands:
            configuration = Configuration(mass=hand["mass"], rate=1000.0, friction=1.0)
            assert (hand["k"], hand["b"]) == pytest.approx(configuration.equivalent(2000.0, 5.0))
    (alone,) = chart("plane", span, "--mass", "0.3", "--data", "n.csv", "--json").document["hands"]
    assert alone["mass"] == 0.3


def test_the_options_replace_the_values_of_the_scene(chart: Chart, scene_file: SceneFile) -> None:
    words = ["--delay", "0", "--hold", "impulse", "--simulated-damping", "7", "--json"]
    (hand,) = chart("plane", scene_file("spring"), *words).document["hands"]
    configuration = Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=0.0, hold="impulse")
    assert (hand["k"], hand["b"]) == pytest.approx(configuration.equivalent(2000.0, 7.0))


def test_without_a_scene_a_hand_is_described_by_options(chart: Chart) -> None:
    words = ["--mass", "0.2", "--rate", "1000", "--simulated-stiffness", "300", "--json"]
    hand = chart("transparency", *words).document["hand"]
    assert (hand["stiffness"], hand["damping"]) == (300.0, 0.0)
    answer = chart("plane", "--mass", "0.2", "--rate", "1000", "--json")
    assert answer.document["hands"][0]["k"] is None


def test_hands_that_are_alike_share_a_plane_and_others_are_named(chart: Chart, scene_file: SceneFile) -> None:
    for words in ([], ["--mass", "0.3"]):
        together = chart("plane", scene_file("two_hands"), "--json", *words)
        assert [hand["name"] for hand in together.document["hands"]] == ["hand", "other"]
    apart = chart("plane", scene_file("two_hands", mass=[0.2, 0.3]), "--channel", "1", "--data", "d.csv")
    assert "hand has its own plane: --channel 0" in apart.out


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("words", "correction", "of_two"),
    [
        (["--correction", "predictor"], "predictor", 0.0),
        (["--as-scene"], "poles", 0.0),
        (["--as-scene", "--correction", "none"], "none", 0.02),
        ([], "none", 4e-4),
    ],
)
def test_table1_is_corrected_as_asked_for(
    chart: Chart, scene_file: SceneFile, words: list[str], correction: str, of_two: float
) -> None:
    """The scene's correction applies if the option is absent and the table uses the scene unchanged."""
    answer = chart("table1", scene_file("spring", correction="poles"), *words, "--json")
    assert answer.document["correction"] == correction
    couplings = {row["coupling"]: row for row in answer.document["couplings"]}
    assert list(couplings) == ["I", "II", "III", "IV", "V"]
    assert all(abs(row["measured_off_by"]) < 1e-6 for row in couplings.values())
    assert couplings["IV"]["beyond_real_springs"] == pytest.approx(of_two, rel=0.1, abs=1e-6)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["table1", "spring", "--correction", "pole"], "--correction: found 'pole', expected"),
        (["plane"], "--mass is missing"),
        (["plane", "--mass", "1"], "--rate is missing"),
        (["plane", "--mass", "-1", "--rate", "1000"], "--mass is -1, but it has to be greater than zero"),
        (["plane", "spring", "--hold", "magnet"], "--hold is 'magnet', but it has to be one of: zoh, impulse"),
        (["plane", "spring", "--damper", "filtered"], "cutoff"),
        (["plane", "spring", "--mass", "1,2", "--normalised"], "holds for one mass only"),
        (["plane", "spring", "--to-stiffness", "-1"], "--to-stiffness: found -1, expected a finite number above 0"),
        (["plane", "spring", "--to-damping", "nan"], "--to-damping: found nan"),
        (["plane", "spring", "--delay", "50"], "expected at most 40"),
        (["plane", "spring", "--picture", "p.bmp"], "expected .svg, .png, .pdf"),
        (["plane", "spring", "--data", "d.txt"], "expected .csv"),
        (["plane", "spring", "--channel", "7"], "--channel 7: no hand there"),
        (["plane", "coupled"], "but hand also moves a mass of the scene"),
        (["felt", "spring", "--over", "mass"], "--over: found mass, expected one of device.mass, device.friction"),
        (["transparency", "--mass", "1", "--rate", "1"], "--simulated-stiffness is missing"),
        (["table1", "coupled"], "but hand also moves a mass of the scene"),
        (["table1"], "SCENE"),
        (["felt", "--normalised", "--delay", "-1"], "--delay is -1"),
    ],
)
def test_what_cannot_be_drawn_is_a_sentence_and_status_2(
    chart: Chart, scene_file: SceneFile, words: list[str], told: str
) -> None:
    scenes = ("spring", "coupled")
    answer = chart(*(scene_file(word) if word in scenes else word for word in words))
    assert answer.status == 2
    assert told in answer.err
    assert answer.out == ""
    assert not list(Path().glob("*.svg"))


# --- files, whole or not at all ---


@pytest.fixture
def full_disk() -> Iterator[None]:
    """No file can grow beyond 512 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (512, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("name", ["numbers.csv", "picture.svg", "scene.yaml"])
def test_a_full_disk_leaves_no_file_and_the_older_one_as_it_was(tmp_path: Path, name: str, is_there: bool) -> None:
    file = tmp_path / name
    if is_there:
        file.write_text("older", encoding="utf-8")

    def write() -> None:
        if name == "numbers.csv":
            save_rows({"x": range(1000)}, file)
        elif name == "picture.svg":
            with figure_to(file, 2.0, 2.0):
                pass
        else:
            with whole_file(file) as beside:
                beside.write_text(1000 * "x", encoding="utf-8")

    with pytest.raises(UsageError, match=f"{name}: the file cannot be written: File too large"):
        write()
    assert [one.read_text(encoding="utf-8") for one in tmp_path.iterdir()] == ["older"] * is_there


def test_a_file_that_is_replaced_keeps_its_permissions_and_its_links(tmp_path: Path) -> None:
    file, link = tmp_path / "of.csv", tmp_path / "link.csv"
    file.write_text("older", encoding="utf-8")
    file.chmod(0o640)
    link.symlink_to(file)
    save_rows({"x": [1]}, link)
    assert file.read_text(encoding="utf-8") == "x\n1\n"
    assert file.stat().st_mode & 0o777 == 0o640
    assert link.is_symlink()


def test_what_is_no_file_is_written_in_its_place() -> None:
    with whole_file("/dev/null") as place:
        assert place == Path("/dev/null")
    assert Path("/dev/null").is_char_device()
