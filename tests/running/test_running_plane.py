"""Changes of a running scene in the plane: grounds by coordinate, links by name, structure by a crossfade."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import hapsim
from hapsim.errors import UsageError
from hapsim.running.changed_scene import changed, differs_in_live_parameters_alone
from hapsim.running.live_parameters import parameters_of
from hapsim.running.watch import WatchedFile
from hapsim.scene import load_scene, parse_scene

TEXT = """\
version: 1
rate: 1000
space: 2
device: {mass: 0.2, friction: 2.0, clock: lockstep}
mock: {hand: {force: [1.0, 0.0]}}
modules:
  hand: {type: device, channels: [0, 1]}
  ball: {type: mass, mass: 0.1, position: [0.1, 0.1]}
  post: {type: ground, position: [0.0, 0.02]}
  hold: {type: viscoelastic, between: [hand, post], length: 0.0, stiffness: 100, damping: 2}
  disc: {type: shape, between: [ball, post], form: {disc: 0.02}, stiffness: 200, damping: 1}
  lane: {type: guide, between: [hand, post], through: [[-0.1, 0], [0.1, 0]], stiffness: 100, damping: 1}
"""


def settled(session: hapsim.Session) -> np.ndarray:
    """Place where the hand comes to rest, m."""
    before, seen = np.full(2, np.inf), 0
    for _ in range(1000):
        session.wait(0.005)
        state = session.state()
        if state.sample < seen + 50:
            continue
        now, seen = np.array(state.position), state.sample
        if np.abs(now - before).max() < 1e-6:
            return now
        before = now
    raise AssertionError("no rest")


def test_a_ground_has_a_parameter_for_each_coordinate_in_place_of_its_own() -> None:
    found = parameters_of(parse_scene(TEXT), has_mock=True)
    assert [one for one in found if one.startswith(("post", "hand", "ball"))] == ["post.x.position", "post.y.position"]
    assert (found["post.y.position"].value, found["post.y.position"].unit) == (0.02, "m")
    assert found["disc.stiffness"].value == 200.0
    assert found["mock.hand.force"].value == (1.0, 0.0)


def test_a_coordinate_changes_alone_and_the_modules_keep_their_order() -> None:
    scene = parse_scene(TEXT)
    now = changed(scene, {"post.x": {"position": -0.01}, "hold": {"stiffness": 150.0}})
    assert now.modules["post"].position == (-0.01, 0.02)
    assert now.modules["hold"].stiffness == 150.0
    assert list(now.modules) == list(scene.modules)
    assert changed(now, {"mock.hand": {"force": (0.0, 0.0)}}).modules is now.modules
    for name, sentence in {"post": "did you mean 'post.", "post.z": "did you mean 'post."}.items():
        with pytest.raises(UsageError, match=sentence):
            changed(scene, {name: {"position": 0.0}})
    with pytest.raises(UsageError, match="found 'mass', but of a ground position can"):
        changed(scene, {"post.y": {"mass": 0.0}})


def test_places_and_stiffnesses_ramp_and_forms_and_paths_crossfade() -> None:
    scene = parse_scene(TEXT)
    for written, other, is_ramp in (
        ("[0.0, 0.02]", "[0.1, 0.02]", True),
        ("stiffness: 200", "stiffness: 300", True),
        ("{disc: 0.02}", "{disc: 0.03}", False),
        ("[-0.1, 0]", "[-0.2, 0]", False),
        ("length: 0.0", "length: 0.1", False),
    ):
        wanted = parse_scene(TEXT.replace(written, other))
        assert wanted != scene
        assert differs_in_live_parameters_alone(scene, wanted) is is_ramp, written


def test_a_hand_follows_a_ground_that_moves() -> None:
    with hapsim.start(parse_scene(TEXT)) as session:
        np.testing.assert_allclose(settled(session), [0.01, 0.02], atol=1e-5)
        session.set({"post.x": {"position": 0.005}, "post.y": {"position": -0.01}})
        np.testing.assert_allclose(settled(session), [0.015, -0.01], atol=1e-5)
        places = session.state().modules
        assert (places["post.x"], places["post.y"]) == (0.005, -0.01)
        found = [session.positions(["ball.x", "hand.y"])[1][0], places["hand.y"]]
        assert found == pytest.approx([0.1, session.state().position[1]], abs=1e-7)


def test_an_edit_of_the_file_moves_a_ground_and_changes_a_form_and_a_path(tmp_path: Path) -> None:
    file = tmp_path / "plane.yaml"
    file.write_text(TEXT)
    watched = WatchedFile(str(file))

    def edit(session: hapsim.Session, text: str) -> tuple[str, ...]:
        file.write_text(text)
        os.utime(file, ns=(0, os.stat(file).st_mtime_ns + 1_000_000))
        result = watched.check(session)
        assert result is not None
        assert not result.refused, result.refused
        return result.changed

    with hapsim.start(load_scene(str(file))) as session:
        settled(session)
        moved = TEXT.replace("[0.0, 0.02]", "[0.01, 0.03]")
        assert edit(session, moved) == ("post.position [0, 0.02] → [0.01, 0.03]",)
        np.testing.assert_allclose(settled(session), [0.02, 0.03], atol=1e-5)
        pushed = moved.replace("[ball, post], form: {disc: 0.02}", "[hand, post], form: {box: [0.08, 0.2]}")
        assert edit(session, pushed) == (
            "disc.between [ball, post] → [hand, post]",
            "disc.form disc 0.02 → box [0.08, 0.2]",
        )
        # About the post, the box and the push of 1 N against the spring: 100 x = 1 + 200 (0.04 - x).
        np.testing.assert_allclose(settled(session), [0.01 + 0.03, 0.03], atol=1e-5)
        assert session.state().modules["ball.x"] == 0.1
        led = pushed.replace("[[-0.1, 0], [0.1, 0]]", "[[-0.1, 0.02], [0.1, 0.02]]")
        assert edit(session, led) == ("lane.through [[-0.1, 0], [0.1, 0]] → [[-0.1, 0.02], [0.1, 0.02]]",)
        np.testing.assert_allclose(settled(session), [0.01 + 0.03, 0.03 + 0.01], atol=1e-5)
