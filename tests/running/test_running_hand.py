"""`mock.hand` of a running scene: who may change it, what is refused, and what else it leaves alone."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

import hapsim
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.running.watch import WatchedFile
from hapsim.scene import Scene, load_scene, parse_scene

sys.path.insert(0, str(Path(__file__).parent))
from live_structures import BEGIN, running, scene_of

TEXT = """\
version: 1
rate: 1000
device: {mass: 0.2, clock: lockstep, friction: 1.0}
MOCK
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 2}
"""


def scene(mock: str = "") -> Scene:
    return parse_scene(TEXT.replace("MOCK", mock), "a scene")


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"force": [1.0, 2.0, 3.0]}, "mock.hand.force: found 3 numbers, expected 2: one for each channel"),
        ({"stiffness": [1.0, -2.0]}, r"mock.hand.stiffness\[1\]: found -2.0, expected a number >= 0"),
        ({"damping": "much"}, "mock.hand.damping: found 'much', expected"),
        ({"position": float("nan")}, "mock.hand.position: found nan, expected"),
        ({"mass": 1.0}, "mock.hand: found 'mass', but of a hand force and stiffness and damping and position can"),
    ],
)
def test_what_is_wrong_changes_nothing(monkeypatch: pytest.MonkeyPatch, fields: Any, sentence: str) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        before = runner.live.scene
        with pytest.raises(UsageError, match=sentence):
            runner.live.set({"nail": {"stiffness": 50.0}, "mock.hand": fields}, 0.02)
        runner.go()
        assert runner.live.scene is before
        assert runner.loop.changes == 0


def test_hand_and_modules_change_together_and_the_scene_is_moved_by_its_own_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        program = runner.loop.program
        runner.live.set({"mock.hand": {"force": [1.0, 2]}}, 0.02)
        runner.go()
        assert runner.loop.changes == 0
        runner.live.set({"nail": {"stiffness": 50.0}, "mock.hand": {"stiffness": 100}}, 0.02)
        runner.go()
        assert runner.loop.changes == 1
        assert runner.loop.program is program
        now = runner.live.scene
    assert now.mock is not None
    assert (now.mock.hand.force, now.mock.hand.stiffness) == ((1.0, 2.0), 100.0)
    assert now.mock.initial == scene_of(BEGIN).mock.initial  # type: ignore[union-attr]


def test_behind_a_port_no_hand_can_be_set() -> None:
    with serving(assemble_mock(scene())) as port:
        device = scene().device.model_copy(update={"port": port})
        with hapsim.start(scene().model_copy(update={"device": device})) as session:
            assert "mock.hand.force" not in session.parameters
            held = scene("mock: {hand: {force: 1}}").model_copy(update={"device": device})
            for change in (lambda: session.set({"mock.hand": {"force": 1.0}}), lambda: session.adopt(held)):
                with pytest.raises(UsageError, match=r"mock\.hand: the device is no mock of this process"):
                    change()


def test_what_is_predicted_knows_no_hand_of_the_mock() -> None:
    held = scene("mock: {hand: {force: 2, stiffness: 300, damping: 5, position: 0.01}}")
    one, other = predict(held), predict(scene())
    assert (one.felt, one.poles, one.margins) == (other.felt, other.poles, other.margins)


def test_an_edited_hand_is_applied_whether_the_file_had_one_or_not(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"

    def write(mock: str, at: int) -> None:
        path.write_text(TEXT.replace("MOCK", mock), encoding="utf-8")
        os.utime(path, ns=(at * 10**9, at * 10**9))

    write("", 1)
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path))
        for at, mock, changed in (
            (
                2,
                "mock: {hand: {stiffness: 300, position: 0.01}}",
                ("stiffness 0 N/m → 300 N/m", "position 0 m → 0.01 m"),
            ),
            (3, "mock: {hand: {stiffness: 300, position: [0.02]}}", ("position 0.01 m → [0.02]",)),
            (4, "", ("stiffness 300 N/m → 0 N/m", "position [0.02] → 0 m")),
        ):
            write(mock, at)
            news = file.check(session)
            assert news is not None
            assert news.changed == tuple(f"mock.hand.{one}" for one in changed)
        write("mock: {noise: 1.0e-6}", 5)
        news = file.check(session)
        assert news is not None
        assert "mock cannot change while the scene runs" in news.refused
