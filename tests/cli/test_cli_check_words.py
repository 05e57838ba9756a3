"""Sentences of `hapsim check` are true of their scenes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cli.check_correction import correction_lines
from hapsim.cli.check_details import partials_sentences
from hapsim.prediction import predict, unlikely, warnings_about
from hapsim.prediction.verdict_words import margin_sentence
from hapsim.running.requirements import refusal_to_arm
from hapsim.scene import Scene, parse_scene
from hapsim.units import LINEAR

Hapsim = Callable[..., Any]
HAND: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}


def scene_of(links: dict[str, Any], mock: dict[str, Any] | None = None, **device: Any) -> dict[str, Any]:
    own = {"clock": "lockstep", "mass": 0.2, "friction": 1.0} | device
    return {"version": 1, "rate": 1000, "device": own, "mock": mock or {}, "modules": HAND | links}


def parsed(document: dict[str, Any]) -> Scene:
    return parse_scene(json.dumps(document))


def link(stiffness: float, damping: float, **more: Any) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": stiffness, "damping": damping} | more


@pytest.fixture
def printed(hapsim: Hapsim, tmp_path: Path) -> Callable[[dict[str, Any]], str]:
    def check(document: dict[str, Any]) -> str:
        path = tmp_path / "scene.yaml"
        path.write_text(json.dumps(document))
        return hapsim("check", path).words

    return check


def test_with_an_idle_port_only_the_unstable_hand_gets_advice(printed: Callable[..., str]) -> None:
    words = printed(scene_of({"touch": link(4000, 5), "other": {"type": "device", "channel": 1}}))
    assert "hand: It becomes stable where" in words
    assert "no stiffness to have a margin" not in words
    assert "e-" not in re.findall(r"other: k.*?N/m", words)[0]


@pytest.mark.parametrize("seed", range(12))
def test_the_advice_to_an_unstable_hand_makes_it_stable(printed: Callable[..., str], seed: int) -> None:
    draw = np.random.default_rng(seed)
    stiffness, damping = float(10.0 ** draw.uniform(1, 5)), float(10.0 ** draw.uniform(0, 3))
    words = printed(scene_of({"touch": link(stiffness if seed % 4 else 0.0, damping)}))
    assert "no stiffness is stable; or" not in words
    for low, high in re.findall(r"where the damping is between (\S+) and (\S+) N", words):
        for right in (float(low), float(high)):
            prediction = predict(parsed(scene_of({"touch": link(stiffness if seed % 4 else 0.0, right)})))
            assert prediction.spectral_radius <= 1.0 + 1e-9


def test_the_far_end_of_a_weight_is_no_mistake_and_a_wall_in_mm_is_one() -> None:
    far = {"far": {"type": "ground", "position": -10.0}}
    weight = {"type": "spring", "between": ["hand", "far"], "stiffness": 0.3}
    assert unlikely(parsed(scene_of(far | {"load": weight}))) == []
    for wall in (weight | {"stiffness": 300.0}, {"type": "buffer", "between": ["hand", "far"], "stiffness": 300.0}):
        assert any("write -0.01" in one for one in unlikely(parsed(scene_of(far | {"load": wall}))))


def test_a_level_of_a_table_is_not_taken_for_free_space(printed: Callable[..., str]) -> None:
    points = [[0.001 * i, float(i % 2)] for i in range(16)]
    table = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": points}
    words = printed(scene_of({"key": table}))
    assert "below 0 0 0 no spring" in words
    assert "above 15 0 0 no spring, 1 N" in words


@pytest.mark.parametrize("kind", ["friction", "detent", "nonlinear", "plectrum"])
@pytest.mark.parametrize("seed", range(5))
def test_no_link_pulls_by_more_than_its_stated_bound(kind: str, seed: int) -> None:
    draw = np.random.default_rng(seed)
    force, x = float(draw.uniform(0.5, 3.0)), float(draw.uniform(0.001, 0.01))
    links: dict[str, dict[str, Any]] = {
        "friction": {"force": force, "static": 1.2 * force, "stiffness": force / x},
        "detent": {"pitch": x, "depth": force, "shape": str(draw.choice(["sine", "snap", "notch"]))},
        "nonlinear": {"force_over_distance": [[-x, -force], [0.0, force], [x, 0.2 * force]]},
        "plectrum": {"stiffness": force / x, "release": x},
    }
    document = scene_of({"it": {"type": kind, "between": ["hand", "wall"]} | links[kind]}, force_limit=50.0)
    scene = parsed(document)
    law = scene.links["it"].law()
    bound = law.strongest(scene.rate)
    most = np.abs(law.tension(np.linspace(-3.0 * x, 3.0 * x, 4001))).max()
    assert bound == pytest.approx(1.2 * force if kind == "friction" else most, rel=1e-2)
    prediction = predict(scene)
    for warning in warnings_about(scene, prediction):
        if "oscillates" in warning:
            assert f"with up to the {bound:.6g} N of its links" in warning
    assert parsed(scene_of({"it": link(10, 1)})).links["it"].law().strongest(1000.0) == np.inf


def test_the_value_of_a_count_is_stated_where_it_matters(printed: Callable[..., str]) -> None:
    for damper, damping in (({}, "0.46"), ({"damper": "centred"}, "0.23"), ({"damper": "sensed"}, None)):
        wheel = scene_of(
            {"load": link(3, 0.3, **damper)}, {"quantum": 0.001534}, motion="rotary", force_limit=5, delay=0
        )
        words = printed(wheel)
        assert ("one count of 0.00153 rad is worth 0.0046 N·m of stiffness" in words) is (damping is not None)
        assert damping is None or f"and {damping} N·m of damping" in words
    assert "one count" not in printed(scene_of({"load": link(300, 1)}, {"quantum": 1e-6}))
    assert "mock.misses: 0.02" in printed(scene_of({"load": link(300, 1)}, {"misses": 0.02}))


def test_searched_margins_state_their_range_and_resolution(printed: Callable[..., str]) -> None:
    links = {"touch": link(500, 2, between=["hand", "m"]), "back": link(300, 1, between=["m", "wall"])}
    document = scene_of({"m": {"type": "mass", "mass": 0.01}} | links)
    how = "(searched up to 5e+09 times, in steps of 10 %, above 10 times of a factor 2)"
    assert how not in printed(document)
    assert how in printed(document | {"substeps": 4})


@pytest.mark.parametrize(("damping", "end"), [(5.0, "margin."), (1000.0, "N·s/m.")])
def test_the_stable_damping_of_an_unstable_drag_is_named(damping: float, end: str) -> None:
    drag = {"drag": {"type": "damper", "between": ["hand", "wall"], "damping": damping}}
    words = margin_sentence(predict(parsed(scene_of(drag))).felt[0], LINEAR)
    assert words.startswith("There is no stiffness to have a margin")
    assert words.endswith(end)
    assert ("; the scene is stable where the damping is between" in words) is (damping > 100.0)


def test_no_pole_has_digits_without_meaning(hapsim: Hapsim, tmp_path: Path) -> None:
    gut = {"type": "string", "masses": 5, "mass": 1e-5, "stiffness": 1e12}
    tie = {"type": "spring", "between": ["hand", "gut.2"], "stiffness": 100.0}
    path = tmp_path / "scene.yaml"
    path.write_text(json.dumps(scene_of({"gut": gut, "tie": tie})))
    said = hapsim("check", path, "--explain").out
    assert "e+11" in said
    assert not re.search(r"\d{9}", said)


def test_a_refusal_names_what_bounds_the_force() -> None:
    detent = {"it": {"type": "detent", "between": ["hand", "wall"], "pitch": 1e-5, "depth": 3.2, "damping": 0.0}}
    for links, most in ((detent, "the 3.2 N of its links"), ({"it": link(1e6, 0.0)}, "the force limit of 10 N")):
        scene = parsed(scene_of(links, force_limit=10.0))
        prediction = predict(scene)
        assert f"oscillates with up to {most}; " in refusal_to_arm("x.yaml", scene, prediction)
        assert any(f"oscillates with up to {most}; " in one for one in warnings_about(scene, prediction))


@pytest.mark.parametrize(("friction", "can_grow"), [(0.0, True), (49.2, True), (49.3, False)])
def test_bounces_are_reported_below_the_friction_that_passivity_needs(
    friction: float, can_grow: bool, hapsim: Hapsim, tmp_path: Path
) -> None:
    """K T/2 + B = 49.25 N·s/m without delay (Colgate and Schenkel); stable in touch and apart either way."""
    stop = {"type": "buffer", "between": ["hand", "wall"], "stiffness": 18500.0, "damping": 40.0}
    file = tmp_path / "stop.yaml"
    file.write_text(json.dumps(scene_of({"stop": stop}, friction=friction, delay=0)), encoding="utf-8")
    out = hapsim("check", str(file)).words
    assert ("Not passive: bounces can grow below 49.25 N·s/m of friction" in out) == can_grow
    assert ": stable" in out
    touched = json.loads(hapsim("check", str(file), "--json").out)["parts"][0]["regions"][0]
    assert touched["needed_friction"] == pytest.approx(49.25)


@pytest.mark.parametrize(
    ("damping", "words"),
    [
        (0.0, "It becomes stable where the stiffness is 0.6675 of the simulated one, or less; or where the"),
        (5.0, "Gain margin: the loop becomes unstable at 3.89 times this stiffness."),
        (500.0, "At this damping no stiffness is stable; this one is where the damping is between 0.5021 and 165 N"),
    ],
)
def test_a_margin_is_stated_on_either_side_of_the_stable_damping(damping: float, words: str) -> None:
    assert margin_sentence(predict(parsed(scene_of({"touch": link(1000, damping)}))).felt[0], LINEAR).startswith(words)


def test_of_many_pitches_some_are_printed_and_the_others_counted() -> None:
    six, eight = partials_sentences({"a": (1.0,) * 6, "b": (1.0,) * 8})
    assert six == "Sound: a, pitches when released: 1.0, 1.0, 1.0, 1.0, 1.0, 1.0 Hz."
    assert eight.endswith("1.0 Hz and 2 more.")


def test_a_sensed_correction_names_what_is_not_small() -> None:
    device = {"correction": "sensed", "sensors": ["velocity", "acceleration"], "delay": 2.0}
    prediction = predict(parsed(scene_of({"touch": link(20000, 20)}, **device)), with_margins=False)
    (words,) = correction_lines(prediction)
    assert "with τ = 2.5 ms ahead they are 0.62 and 0.25 here" in str(words)  # K τ²/m, B τ/m


def test_a_steady_push_on_tied_hands_is_stated_where_a_correction_misses_it() -> None:
    document = scene_of({"touch": link(500.0, 3.0)}, mass=0.2, friction=1.0, delay=2, correction="predictor")
    modules = document["modules"]
    hand = next(name for name, one in modules.items() if one["type"] == "device")
    modules["other"] = {"type": "device", "channel": 1}
    modules["tie"] = {"type": "viscoelastic", "between": [hand, "other"], "stiffness": 900.0, "damping": 3.0}
    prediction = predict(parsed(document))
    static = next(one.static_stiffness for part in prediction.parts for one in part.rows if one.hand == "other")
    told = [str(one) for one in correction_lines(prediction) if "only the motion is corrected" in str(one)]
    assert abs(static / 900.0 - 1.0) > 1e-3
    assert len(told) == 1
    assert f"a steady push on other meets {static:.6g} N/m, not 900" in told[0]


def test_no_list_of_changes_is_announced_that_is_not_there(printed: Callable[..., str], large: int) -> None:
    chain = {"type": "string", "masses": large, "mass": 0.001, "stiffness": 900.0, "damping": 0.001}
    document = scene_of({"touch": link(300.0, 0.1)}, mass=0.2, friction=0.1)
    document["modules"] |= {"gut": chain, "grip": link(90000.0, 0.0) | {"between": ["hand", "gut.3"]}}
    text = printed(document)
    assert "unstable" in text
    assert "--explain lists" not in text
    assert "Which change would make it stable was not worked out" in text


@pytest.mark.parametrize(
    ("correction", "changes", "sentences", "not_said"),
    [
        ("predictor", {}, ["Correction predictor: hand swings as desired."], ["A steady push", "does not reach"]),
        ("poles", {}, ["Correction poles: hand swings as desired. A steady push meets "], ["does not reach"]),
        (
            "poles",
            {"stiffness": 2e5, "damping": 300.0},
            ["Correction poles does not reach what is desired at hand", "It is reached by a rate of"],
            ["swings as desired"],
        ),
    ],
)
def test_the_reach_of_a_correction_is_stated(
    explained: Callable[[Path], Any],
    scene_file: Callable[..., Path],
    correction: str,
    changes: dict[str, float],
    sentences: list[str],
    not_said: list[str],
) -> None:
    said = explained(scene_file("spring", touch=changes, correction=correction)).words
    assert all(sentence in said for sentence in sentences)
    assert not any(sentence in said for sentence in not_said)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("scene", ["plucked_string", "paper_6_2_one_sample", "knob_24"])
def test_a_percent_sign_stands_behind_a_space(hapsim: Hapsim, scene: str) -> None:
    printed = hapsim("check", scene, "--explain").out
    assert " %" in printed
    assert not re.search(r"\d%", printed)
