"""The verdict on a scene with gates is for every state of its inputs."""

from __future__ import annotations

from typing import Any

import pytest

from hapsim.cli.check import check_lines, prediction_document
from hapsim.errors import UsageError
from hapsim.prediction import predict, surely_shaken_by
from hapsim.prediction.predict import is_soon_stable
from hapsim.prediction.verdict_words import gate_sentences, verdict_words
from hapsim.running.requirements import refusal_to_arm, require_not_less_stable, require_runnable
from hapsim.running.session_options import RunOptions
from hapsim.scene import Scene

ENDS = {"between": ["hand", "post"]}
SPRING = ENDS | {"type": "spring", "stiffness": 1500.0}
DAMPER = ENDS | {"type": "damper", "damping": 5.0}
HALF = DAMPER | {"damping": 2.5}
STIFF = ENDS | {"type": "viscoelastic", "stiffness": 5000.0, "damping": 5.0}
STEEL = STIFF | {"stiffness": 9000.0}
OTHER = {"hand2": {"type": "device", "channel": 1}}


def scene_of(device: dict[str, Any] | None = None, **modules: Any) -> Scene:
    points = {"hand": {"type": "device", "channel": 0}, "post": {"type": "ground"}}
    document: dict[str, Any] = {"version": 1, "rate": 1000.0, "modules": points | modules}
    document["device"] = {"mass": 0.2, "friction": 1.0} | (device or {})
    document["inputs"] = {"touch": {"bit": 0}, "grip": {"bit": 1}, "pedal": {"bit": 2, "inverted": True}}
    return Scene.model_validate(document)


def when(name: str, link: dict[str, Any]) -> dict[str, Any]:
    return link | {"when": name}


#: Scenes, each with the states of its inputs in which it is unstable: those that are off, in words.
UNSTABLE: dict[str, tuple[dict[str, Any], set[str]]] = {
    "needs its damper": ({"soft": SPRING, "oil": when("touch", DAMPER)}, {"touch is off"}),
    "is too stiff": ({"wall": when("touch", STIFF)}, {""}),
    "is too stiff beside what is soft": ({"soft": SPRING, "oil": DAMPER, "wall": when("touch", STEEL)}, {""}),
    "needs one of two dampers": (
        {"soft": SPRING, "oil": when("touch", DAMPER), "wax": when("grip", DAMPER)},
        {"touch and grip are off"},
    ),
    "needs both": (
        {"soft": SPRING | {"stiffness": 3000.0}, "oil": when("touch", HALF), "wax": when("grip", HALF)},
        {"touch is off", "grip is off", "touch and grip are off"},
    ),
    "needs nothing": ({"soft": SPRING | {"stiffness": 300.0}, "oil": when("pedal", DAMPER)}, set()),
    "has another hand": (
        OTHER | {"soft": SPRING, "oil": when("touch", DAMPER), "far": SPRING | {"between": ["hand2", "post"],
         "stiffness": 300.0}},
        {"touch is off"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", UNSTABLE)
def test_the_verdict_is_that_of_the_worst_state_of_the_inputs(name: str) -> None:
    modules, unstable = UNSTABLE[name]
    scene = scene_of(**modules)
    prediction = predict(scene)
    states = {"": prediction.judge.is_stable} | {words: one.stable for words, one in prediction.with_inputs_off.items()}
    assert {words for words, stable in states.items() if not stable} == unstable
    assert prediction.stable is not bool(unstable)
    assert prediction.verdict == ("unstable" if unstable else "stable")
    assert (surely_shaken_by(scene) is None) is not bool(unstable)
    assert is_soon_stable(scene, 250) is not bool(unstable)
    if unstable:
        with pytest.raises(UsageError, match="predicted unstable"):
            require_runnable(scene, RunOptions(unstable=False))


@pytest.mark.parametrize("name", UNSTABLE)
def test_each_state_is_predicted_as_the_scene_without_its_gates(name: str) -> None:
    scene = scene_of(**UNSTABLE[name][0])
    for words, one in predict(scene).with_inputs_off.items():
        off = set(words.removesuffix(" is off").removesuffix(" are off").split(" and "))
        kept = {at: link for at, link in UNSTABLE[name][0].items() if link.get("when") not in off}
        bare = scene_of(**{at: {k: v for k, v in link.items() if k != "when"} for at, link in kept.items()})
        assert one.poles == pytest.approx(predict(bare).poles)


def test_the_state_that_is_unstable_is_named() -> None:
    scene = scene_of(soft=SPRING, oil=when("touch", DAMPER))
    prediction = predict(scene)
    verdict, note, words = verdict_words(prediction)
    assert (verdict, note) == ("unstable", "")
    assert words.startswith("while touch is off, spectral radius 1.0")
    assert [*gate_sentences(prediction)] == [f"While touch is off: unstable ({words.partition(', ')[2]})"]
    shaken = surely_shaken_by(scene)
    assert shaken is not None
    assert "while touch is off" in shaken.sentence(scene.units)
    assert "while touch is off" in refusal_to_arm("a.yaml", scene, prediction)
    lines = [str(one) for one in check_lines(scene, prediction, None, explain=False)]
    assert any("While touch is off: unstable" in one for one in lines)
    assert prediction_document(prediction)["with_inputs_off"]["touch is off"]["stable"] is False
    assert prediction_document(prediction)["stable"] is False


def test_a_change_that_makes_a_state_unstable_is_refused() -> None:
    before = scene_of(soft=SPRING | {"stiffness": 300.0}, oil=when("touch", DAMPER))
    require_not_less_stable(before, before.changed({"soft.stiffness": 400.0}))
    with pytest.raises(UsageError, match="while touch is off"):
        require_not_less_stable(before, before.changed({"soft.stiffness": 1500.0}))


def test_of_many_inputs_not_every_state_is_judged_and_check_names_the_rest() -> None:
    scene = scene_of(soft=SPRING | {"stiffness": 100.0})
    names = [f"in{i}" for i in range(5)]
    document = scene.document | {"inputs": {name: {"bit": i} for i, name in enumerate(names)}}
    document["modules"] |= {f"oil{name}": when(name, DAMPER) for name in names}
    lines = [*gate_sentences(predict(Scene.model_validate(document)))]
    assert len(lines) == 12
    assert lines[-1] == "Not judged: states in which, of 5 inputs, two or three are on"


def test_a_hand_whose_motor_is_off_is_free_and_what_it_moves_is_as_on_a_ground() -> None:
    ball = {"type": "mass", "mass": 0.001}
    tied = {"type": "spring", "between": ["hand", "ball"], "stiffness": 4500.0}
    scene = scene_of({"when": "touch"}, ball=ball, tied=tied)
    assert predict(scene.with_inputs(frozenset({"touch"}))).verdict == "unstable"
    assert predict(scene).with_inputs_off["touch is off"].verdict == "unstable"  # K T²/m > 4
    soft = scene.changed({"tied.stiffness": 300.0, "ball.mass": 0.1})
    assert predict(soft).with_inputs_off["touch is off"].judge.shaking is None


def test_a_scene_whose_hand_is_free_without_its_input_is_stable() -> None:
    """Without friction a free hand drifts: that decides nothing."""
    prediction = predict(scene_of({"friction": 0.0}, wall=when("touch", STIFF | {"stiffness": 500.0})))
    assert prediction.with_inputs_off["touch is off"].verdict == "at the limit"
    assert prediction.stable
    assert prediction.verdict == "stable"
