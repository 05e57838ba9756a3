"""Points of a sweep: what is asked for in words, and what a scene becomes with their values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapsim.errors import SceneError, UsageError
from hapsim.scene import load_scene
from hapsim.scene.varied import Varied
from hapsim.sweeping.sweep_points import METHODS, grid, in_si, listed, read_points, require_values, table


def test_words_make_a_grid_in_the_order_of_its_last_dimension() -> None:
    points = read_points(["touch.stiffness=log:100:10000:3", "device.correction=none,poles"], None, "lhs", 0)
    assert points.sizes == {"touch.stiffness": 3, "device.correction": 2}
    assert [points[i] for i in (0, 1, 5)] == [
        {"touch.stiffness": 100.0, "device.correction": "none"},
        {"touch.stiffness": 100.0, "device.correction": "poles"},
        {"touch.stiffness": 10000.0, "device.correction": "poles"},
    ]
    assert points.axis("touch.stiffness") == pytest.approx([100.0, 1000.0, 10000.0])
    assert points.axis("device.correction") == ["none", "poles"]


@given(st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_the_axes_of_a_grid_give_its_points_back(sizes: list[int]) -> None:
    points = grid({f"a{i}": [float(one) for one in range(size)] for i, size in enumerate(sizes)})
    shape = tuple(points.sizes.values())
    for number in range(len(points)):
        where = np.unravel_index(number, shape)
        assert [points.axis(path)[i] for path, i in zip(points.sizes, where, strict=True)] == [*points[number].values()]


@pytest.mark.parametrize("method", METHODS)
def test_samples_fill_their_ranges_and_are_the_same_for_a_seed(method: str) -> None:
    words = ["touch.stiffness=log:100:10000", "device.delay=lin:0:2"]
    one, again, other = (read_points(words, 64, method, seed) for seed in (1, 1, 2))
    assert one == again != other
    delay, stiffness = np.array(one.columns["device.delay"], float), np.array(one.columns["touch.stiffness"], float)
    assert 0.0 <= delay.min() < 0.2
    assert 1.8 < delay.max() <= 2.0
    assert 100.0 <= stiffness.min() < stiffness.max() <= 10000.0
    assert 0.3 < np.mean(stiffness < 1000.0) < 0.7  # half of them in each decade


def test_a_latin_hypercube_has_one_sample_in_each_row_and_column() -> None:
    points = read_points(["a.b=lin:0:10", "c.d=lin:0:10"], 10, "lhs", 3)
    for column in points.columns.values():
        assert sorted(math.floor(one) for one in column) == [*range(10)]  # type: ignore[arg-type]


def test_a_table_names_its_points(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("touch.stiffness, device.hold\n100,zoh\n2e3, impulse\n", encoding="utf-8")
    points = table(file)
    assert points.sizes == {"point": 2}
    assert points[1] == {"touch.stiffness": 2000.0, "device.hold": "impulse"}


@pytest.mark.parametrize(
    ("words", "samples", "said"),
    [
        (["touch.stiffness"], None, "expected PATH=VALUES"),
        (["touch.stiffness=log:0:10:5"], None, "above 0"),
        (["touch.stiffness=log:1:10:0"], None, "0 values"),
        (["touch.stiffness=log:1:ten:4"], None, "log:1:ten:4"),
        (["touch.stiffness=exp:1:10:4"], None, "exp:1:10:4"),
        (["touch.stiffness=1,nan"], None, "finite"),
        (["touch.stiffness=100..200"], None, "found '100..200', expected values such as"),
        (["touch.stiffness=1,1"], None, "twice"),
        (["touch.stiffness=1", "touch.stiffness=2"], None, "twice"),
        (["touch.stiffness=lin:1:10"], None, "--samples"),
        (["touch.stiffness=lin:1 N/mm:10:4"], None, "the same unit at both ends, such as lin:1 N/mm:5 N/mm:9"),
        (["touch.stiffness=lin:1 N/mm:10 N/mm:4 N/mm"], None, "expected values such as"),
        (["touch.stiffness=1,2"], 5, "range"),
        ([], None, "no parameter"),
        (["a.b=lin:0:1:10000", "c.d=lin:0:1:10000"], None, "100000000 points"),
    ],
)
def test_what_names_no_points_is_answered_with_a_sentence(words: list[str], samples: int | None, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        read_points(words, samples, "lhs", 0)
    assert said in str(caught.value)


def test_points_may_be_listed() -> None:
    points = listed([{"rate": 1000, "scheme": "rk4"}, {"rate": 500.0, "scheme": "exact"}])
    assert points.sizes == {"point": 2}
    assert points[1] == {"rate": 500.0, "scheme": "exact"}
    for wrong in ([], [{}], [{"rate": 1.0}, {"scheme": "rk4"}]):
        with pytest.raises(UsageError, match="the same paths"):
            listed(wrong)


@pytest.mark.parametrize(
    ("text", "said"), [("", "no rows"), ("a.b\n", "rows"), ("a.b,c.d\n1\n", "row 2"), ("a,a\n1,2", "names")]
)
def test_a_table_that_is_none_is_answered_with_a_sentence(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "points.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        table(file)
    assert said in str(caught.value)


def test_values_go_to_their_places_and_nothing_else_changes() -> None:
    scene = load_scene("first_touch")
    varied = Varied(scene)
    assert varied.scene({}) == scene
    values = {
        "touch.stiffness": 700.0,
        "device.delay": 0.5,
        "mock.initial.velocity": 0.2,
        "rate": 2000.0,
        "substeps": 4.0,
    }
    changed = varied.scene(values)
    assert changed.modules["touch"].stiffness == 700.0  # type: ignore[union-attr]
    assert (changed.device.delay, changed.rate, changed.substeps) == (0.5, 2000.0, 4)
    assert changed.mock is not None
    assert changed.mock.initial.velocity == 0.2
    assert varied.scene({"touch.stiffness": 2000.0}) == scene  # the values before left nothing behind


def test_every_path_of_the_shipped_scenes_can_be_set_to_its_value() -> None:
    for name in ("four_keys", "plucked_string", "knob_24"):
        scene = load_scene(name)
        varied = Varied(scene)
        document = varied.document
        for path in varied.known:
            part: object = document
            for key in varied._keys(path):
                part = part.get(key) if isinstance(part, dict) else None
            if isinstance(part, float | str):
                assert varied.scene({path: part}) == scene, path


def test_a_path_that_is_none_gets_a_suggestion_and_a_value_that_is_none_a_sentence() -> None:
    varied = Varied(load_scene("first_touch"))
    with pytest.raises(UsageError, match=r"did you mean 'touch\.stiffness'"):
        varied.require(["touch.stifness"])
    with pytest.raises(UsageError, match=r"did you mean 'touch\.stiffness'\?"):
        varied.require(["stiffness"])
    with pytest.raises(UsageError, match=r"did you mean 'device\.hold' or 'mock\.hold'\?"):
        varied.require(["hold"])
    for other in ("touch.type", "nothing.at.all", ""):
        with pytest.raises(UsageError):
            varied.require([other])
    with pytest.raises(SceneError, match=r"^touch\.stiffness: found -1"):
        varied.scene({"touch.stiffness": -1.0})


@pytest.mark.parametrize(
    ("path", "values", "said"),
    [
        ("touch.stiffness", [100.0, "abc"], "touch.stiffness: found 'abc', expected a number >= 0 (N/m); correct"),
        ("touch.stiffness", [-1.0, 5.0], "touch.stiffness: found -1, expected a number >= 0 (N/m)"),
        ("device.hold", [1.0, "zoh"], "device.hold: found 1, expected 'zoh'"),
        ("device.correction", ["none", "pole"], "found 'pole', expected 'none'"),
        ("substeps", [1.5], "substeps: found 1.5, expected a whole number"),
    ],
)
def test_a_value_that_its_parameter_never_takes_is_refused(path: str, values: list[Any], said: str) -> None:
    varied = Varied(load_scene("first_touch"))
    with pytest.raises(UsageError) as caught:
        require_values(grid({path: values}), varied)
    assert said in str(caught.value)


def test_a_refused_value_of_an_axis_has_the_units_of_the_axis_and_a_whole_number_passes() -> None:
    varied = Varied(load_scene("knob_24"))
    with pytest.raises(UsageError, match=r"device\.mass: found -1, expected a number > 0 \(kg·m²\)"):
        require_values(grid({"device.mass": [-1.0]}), varied)
    require_values(grid({"substeps": [2.0]}), varied)


def test_values_with_units_are_numbers_in_si_units() -> None:
    varied = Varied(load_scene("first_touch"))
    words = ["touch.stiffness=1 N/mm,2000,3 kN/m", "device.correction=none,poles", "touch.damping=500 mN·s/m"]
    points = in_si(read_points(words, None, "lhs", 0), varied)
    assert points.axis("touch.stiffness") == [1000.0, 2000.0, 3000.0]
    assert points[5] == {"touch.stiffness": 3000.0, "device.correction": "poles", "touch.damping": 0.5}
    assert in_si(listed([{"rate": "2 kHz"}]), varied).columns == {"rate": [2000.0]}
    with pytest.raises(UsageError, match="found a value twice"):
        in_si(grid({"touch.stiffness": ["1 N/mm", 1000.0]}), varied)
    for text, least, most in (("lin:1 N/mm:3 N/mm", 1e3, 3e3), ("log:1kN/m:1e2 kN/m", 1e3, 1e5)):
        axis = in_si(read_points([f"touch.stiffness={text}:3"], None, "lhs", 0), varied).axis("touch.stiffness")
        assert axis == pytest.approx([least, 2e3 if most == 3e3 else 1e4, most], rel=1e-12)
        drawn = in_si(read_points([f"touch.stiffness={text}"], 20, "lhs", 0), varied).columns["touch.stiffness"]
        assert all(least <= one <= most for one in drawn if isinstance(one, float))
        assert len(drawn) == 20
    knob = Varied(load_scene("knob_24"))
    assert in_si(grid({"detent.pitch": ["15 deg"]}), knob).axis("detent.pitch") == [math.radians(15.0)]
    for one, path, value, said in (
        (varied, "touch.stiffness", "2 N", "found 2 N, expected a stiffness (N/m), such as 2000 N/m or 2 N/mm"),
        (varied, "rate", "1 khz", "found 1 khz, with the unknown unit 'khz', expected a frequency (Hz)"),
        (knob, "detent.pitch", "5 mm", "found 5 mm, expected an angle (rad), such as 0.5 rad or 30 deg"),
    ):
        with pytest.raises(UsageError) as caught:
            in_si(grid({path: [value]}), one)
        assert f"{path}: {said}" in str(caught.value)


def test_parameters_have_the_units_of_the_scene() -> None:
    linear, rotary = Varied(load_scene("first_touch")), Varied(load_scene("knob_24"))
    assert [linear.unit(path) for path in ("touch.stiffness", "device.delay", "rate", "scheme")] == [
        "N/m",
        "sample periods",
        "Hz",
        "",
    ]
    assert rotary.unit("device.mass") == "kg·m²"
    assert rotary.unit("detent.sharpness") == ""
