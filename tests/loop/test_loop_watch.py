"""A scene's file is followed while the scene runs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from loop_rig import served

import hapsim
from hapsim.running import Session
from hapsim.running.watch import WatchedFile
from hapsim.scene import load_scene

TEXT = """\
version: 1
rate: 1000
device: {mass: 0.2, clock: lockstep, friction: 1.0}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground, position: 0.0}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 1000, damping: 2}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(TEXT, encoding="utf-8")
    return tmp_path / "scene.yaml"


@pytest.fixture
def session(path: Path) -> Iterator[Session]:
    with hapsim.start(load_scene(path)) as session:
        yield session


def edit(path: Path, old: str, new: str) -> None:
    """Saves like an editor: a new file under the old name, with a new time however fast the test is."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    before = path.stat().st_mtime_ns
    path.write_text(text.replace(old, new), encoding="utf-8")
    os.utime(path, ns=(before + 10**9, before + 10**9))


def test_an_untouched_file_is_no_news(path: Path, session: Session) -> None:
    file = WatchedFile(str(path))
    assert file.check(session) is None
    assert file.check(session) is None


def test_an_edit_of_the_sound_is_reported(path: Path) -> None:
    path.write_text(TEXT + "sound: {ear: {from: hand, of: velocity, gain: 1.0}}\n", encoding="utf-8")
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path))
        edit(path, "gain: 1.0", "gain: 0.5")
        news = file.check(session)
        assert news is not None
        assert news.changed == ("sound.ear.gain 1 → 0.5",)
        assert session.scene.sound["ear"].gain == 0.5


def test_what_is_edited_is_adopted_and_reported_once(path: Path, session: Session) -> None:
    file = WatchedFile(str(path))
    edit(path, "stiffness: 1000, damping: 2", "stiffness: 500, damping: 3")
    edit(path, "position: 0.0", "position: 0.01")
    news = file.check(session)
    assert news.changed == (
        "wall.position 0 m → 0.01 m",
        "touch.stiffness 1000 N/m → 500 N/m",
        "touch.damping 2 N·s/m → 3 N·s/m",
    )
    assert session.scene.links["touch"].stiffness == 500.0  # type: ignore[attr-defined]
    assert file.check(session) is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("stiffness: 1000", "stiffness: -1", "scene.yaml:7:65: stiffness: found -1, expected a number >= 0"),
        ("mass: 0.2", "mass: 0.3", "device.mass cannot change while the scene runs"),
        ("version: 1", "version: [", "scene.yaml:"),
    ],
)
def test_an_error_changes_nothing_and_is_reported_once(
    path: Path, session: Session, old: str, new: str, sentence: str
) -> None:
    file, before = WatchedFile(str(path)), session.scene
    edit(path, old, new)
    news = file.check(session)
    assert sentence in news.refused
    assert not news.changed
    assert session.scene == before
    assert file.check(session) is None
    edit(path, new, old)
    back = file.check(session)
    assert back.changed == ("nothing: the file matches the running scene",)


def test_a_file_that_is_gone_for_a_moment_is_waited_for(path: Path, session: Session) -> None:
    file = WatchedFile(str(path))
    text = path.read_text(encoding="utf-8")
    path.unlink()
    assert file.check(session) is None
    path.write_text(text.replace("1000, damping", "700, damping"), encoding="utf-8")
    news = file.check(session)
    assert news.changed == ("touch.stiffness 1000 N/m → 700 N/m",)


def test_a_file_that_stays_away_is_reported_once(path: Path, session: Session) -> None:
    file = WatchedFile(str(path))
    path.unlink()
    told = [news for _ in range(30) if (news := file.check(session)) is not None]
    assert len(told) == 1
    assert "the file is gone" in told[0].refused


def test_a_pipe_in_its_place_holds_nothing_up(path: Path, session: Session) -> None:
    file = WatchedFile(str(path))
    path.unlink()
    os.mkfifo(path)
    assert file.check(session) is None


def test_the_port_of_the_command_counts_more_than_the_files(path: Path) -> None:
    with served(load_scene(path)) as (scene, _), hapsim.start(scene) as session:
        file = WatchedFile(str(path))
        edit(path, "stiffness: 1000", "stiffness: 400")
        news = file.check(session)
        assert news.changed == ("touch.stiffness 1000 N/m → 400 N/m",)
        assert session.scene.device.port == scene.device.port


CURVE = "curve: {type: nonlinear, between: [hand, wall], force_over_distance: curve.csv}"


@pytest.fixture
def curve(path: Path) -> Path:
    """A scene with a curve in a file beside it."""
    file = path.with_name("curve.csv")
    file.write_text("mm,N\n-9,-1\n9,1\n", encoding="utf-8")
    path.write_text(f"{TEXT}  {CURVE}\n", encoding="utf-8")
    return file


def test_an_edit_of_a_curves_file_is_adopted(path: Path, curve: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path), session.scene)
        assert file.check(session) is None
        edit(curve, "9,1", "9,0.5")
        news = file.check(session)
        assert [one.split(" ")[0] for one in news.changed] == ["curve.force_over_distance"]
        assert session.scene.modules["curve"].force_over_distance[1] == (0.009, 0.5)  # type: ignore[attr-defined]
        edit(curve, "9,0.5", "9,nil")
        assert "curve.csv:3: found 'nil', expected a number in N" in file.check(session).refused
        assert session.scene.modules["curve"].force_over_distance[1] == (0.009, 0.5)  # type: ignore[attr-defined]
        assert file.check(session) is None


def test_a_curves_file_that_vanishes_is_reported_once_and_read_when_it_is_back(path: Path, curve: Path) -> None:
    text = curve.read_text(encoding="utf-8")
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path), session.scene)
        curve.unlink()
        told = [news.refused for _ in range(30) if (news := file.check(session)) is not None]
        assert told == [f"{curve}: the file is gone; the scene continues unchanged"]
        curve.write_text(text.replace("9,1", "9,2"), encoding="utf-8")
        assert file.check(session).changed
        assert session.scene.modules["curve"].force_over_distance[1] == (0.009, 2.0)  # type: ignore[attr-defined]


def test_a_curve_that_an_edit_names_is_watched_even_before_it_exists(path: Path, curve: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path), session.scene)
        other = curve.with_name("other.csv")
        edit(path, "curve.csv", "other.csv")
        assert "other.csv: no such file" in file.check(session).refused
        assert file.check(session) is None
        other.write_text("mm,N\n-9,-3\n9,3\n", encoding="utf-8")
        assert file.check(session).changed
        edit(path, "other.csv", "none.csv")
        assert "none.csv: no such file" in file.check(session).refused
        edit(path, "none.csv", "curve.csv")
        assert file.check(session).changed
