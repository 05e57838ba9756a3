"""Live values are saved where they stand in the scene's file, and none is lost."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import hapsim
from hapsim.cli import before_arming, run_reporter
from hapsim.errors import UsageError
from hapsim.running.changed_scene import changed
from hapsim.running.live_parameters import Parameter, changes_from, parameters_of
from hapsim.running.saving import keep_unsaved, live_in_file, path_named, save, unsaved
from hapsim.running.watch import EditResult, WatchedFile
from hapsim.scene import Scene, load_scene, parse_scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
TEXT = """\
# A wall.
version: 1
rate: 1000
device: {mass: 200 g, clock: lockstep, friction: 1.0}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
  touch:
    type: viscoelastic
    between: [hand, wall]
    stiffness: 1 N/mm      # stiff
    damping: 2             # N·s/m
  slip:  {type: friction, between: [hand, wall], force: &f 0.5, stiffness: 1000, damping: &d 1}
  drag:  {type: damper, between: [hand, wall], damping: *d}   # as the slip
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "scene.yaml").write_text(TEXT, encoding="utf-8")
    return tmp_path / "scene.yaml"


def other_values(one: Parameter) -> Iterator[Any]:
    """Yields values that the parameter may have next."""
    value: Any = one.value
    if one.kind == "word":
        yield from (word for word in one.words if word != value)
    elif one.kind == "number":
        low, high = one.span
        yield from (float(f"{value * factor:.4g}") for factor in (1.25, 0.8) if value)
        yield from (float(f"{low + (high - low) * share:.4g}") for share in (0.55, 0.45, 0.3))
    elif one.kind == "numbers":
        yield [float(f"{x * 1.25 + 0.01:.4g}") for x in value]
    else:
        yield weaker(value)


def weaker(points: Any) -> Any:
    if isinstance(points, dict):
        return {key: weaker(one) if isinstance(one, tuple) else one for key, one in points.items()}
    return [[x, 0.9 * force] for x, force in points]


def with_other_values(scene: Scene) -> tuple[Scene, list[str]]:
    """Returns the scene with another value of every live parameter that may have one, and their names."""
    names = []
    for name, one in parameters_of(scene, has_mock=True).items():
        for value in other_values(one):
            try:
                scene = changed(scene, changes_from({name: value}, parameters_of(scene, has_mock=True)))
            except UsageError:
                continue
            names.append(name)
            break
    return scene, names


@pytest.mark.thorough(keep=12)
@pytest.mark.parametrize("shipped", sorted(CONFIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_live_value_of_a_shipped_scene_is_saved_in_its_place_and_read_back(shipped: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(shipped, tmp_path))
    live, names = with_other_values(load_scene(path))
    assert len(names) >= 6
    assert save(live).document == live_in_file(live).document == load_scene(path).document
    assert (load_scene(path).mock or live.mock) == live.mock
    before, after = (one.read_text(encoding="utf-8").splitlines() for one in (shipped, path))
    if len(after) > len(before):  # the hand of the mock is new
        after = [line for line in after if not re.match(r"(mock: \{|  )hand: \{(force|stiffness): ", line)]
    may_differ = {name for full in names for name in full.split(".")} | {"press", "release"}
    for old, new in zip(before, after, strict=True):
        assert old.partition("#")[2] == new.partition("#")[2]
        if old != new:
            had, has = keys_of(old), keys_of(new)
            assert [key for key in has if key in had] == had
            assert {*has} - {*had} <= may_differ
            assert {*had} & may_differ


def keys_of(line: str) -> list[str]:
    return re.findall(r"[\w-]+(?=:)", line.partition("#")[0])


def test_only_what_differs_is_written_with_its_unit_and_comment(path: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        assert session.save() == path
        assert path.read_text(encoding="utf-8") == TEXT
        session.set({"touch": {"stiffness": 1500.0}, "mock.hand": {"force": 0.25}}, over=0.0)
        assert unsaved(session.scene) == ["touch.stiffness"]
        session.save()
        assert unsaved(session.scene) == []
        session.set({"touch": {"stiffness": 1234.5}})
        session.save()
    expected = TEXT.replace("1 N/mm      # stiff", "1.2345 N/mm  # stiff")
    expected = expected.replace("1.0}\nmodules", "1.0}\nmock: {hand: {force: 0.25 N}}\nmodules")
    assert path.read_text(encoding="utf-8") == expected


def test_an_anchor_is_written_where_all_its_places_change_and_refused_in_words_elsewhere(path: Path) -> None:
    scene = load_scene(path)
    with pytest.raises(UsageError, match=r"nothing was written: .*by an anchor.*: modules\.slip\.damping: 3$"):
        save(changed(scene, {"slip": {"damping": 3.0}}))
    with pytest.raises(UsageError, match=r"by an anchor.*: modules\.drag\.damping: 3$"):
        save(changed(scene, {"drag": {"damping": 3.0}}))
    assert path.read_text(encoding="utf-8") == TEXT
    save(changed(scene, {"slip": {"damping": 3.0, "force": 0.6}, "drag": {"damping": 3.0}}))
    assert path.read_text(encoding="utf-8") == TEXT.replace("&d 1}", "&d 3}").replace("&f 0.5", "&f 0.6")


def test_a_file_that_changed_since_it_was_read_is_left_and_the_difference_shown(path: Path) -> None:
    live = changed(load_scene(path), {"touch": {"stiffness": 1500.0}})
    edited = TEXT.replace("damping: 2 ", "damping: 4 ")
    path.write_text(edited, encoding="utf-8")
    with pytest.raises(UsageError, match="changed since it was read") as refusal:
        save(live)
    assert "-    damping: 2             # N·s/m\n+    damping: 4             # N·s/m" in str(refusal.value)
    assert path.read_text(encoding="utf-8") == edited


def test_a_file_that_cannot_be_written_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # for root may write anything
    with pytest.raises(UsageError, match="cannot be written; check its permissions"):
        save(changed(load_scene(path), {"touch": {"stiffness": 1500.0}}))
    assert path.read_text(encoding="utf-8") == TEXT


def test_a_scene_without_a_file_needs_a_name_and_has_that_file_afterwards(tmp_path: Path) -> None:
    live, path = changed(load_scene("first_touch"), {"touch": {"stiffness": 1500.0}}), tmp_path / "mine.yaml"
    with pytest.raises(UsageError, match="name a file"):
        save(live)
    with pytest.raises(UsageError, match="no such directory"):
        save(live, tmp_path / "none" / "mine.yaml")
    saved = save(live, path)
    before, after = (one.read_text("utf-8").splitlines() for one in (CONFIGS / "first_touch.yaml", path))
    assert [new.partition("stiffness: ")[2] for old, new in zip(before, after, strict=True) if old != new] == [
        "1500, damping: 5}  # N/m, N·s/m"
    ]
    assert (saved.path, unsaved(saved)) == (str(path), [])
    with pytest.raises(UsageError, match="the file exists"):
        save(live, path)
    (tmp_path / "link.yaml").symlink_to(tmp_path / "elsewhere.yaml")
    with pytest.raises(UsageError, match="the file exists"):
        save(live, tmp_path / "link.yaml")


def test_nothing_is_written_into_the_package() -> None:
    package = Path(hapsim.__file__).parent
    with pytest.raises(UsageError, match="part of hapsim itself"):
        save(load_scene("wall"), package / "mine.yaml")


@pytest.mark.parametrize(
    "name", ["", "..", "../a", "a/b", "a\\b", "/a", ".a", "a\0", "con", "LPT1.x", "a" * 101, "a\n"]
)
def test_a_name_that_is_no_plain_one_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected a plain one"):
        path_named(name, tmp_path)


def test_a_plain_name_ends_as_a_scene(tmp_path: Path) -> None:
    assert [path_named(name, tmp_path).name for name in ("soft wall", "wall.yaml", "é-2.1")] == [
        "soft wall.yaml",
        "wall.yaml",
        "é-2.1.yaml",
    ]


def test_a_scene_in_another_directory_has_its_curve_with_it(path: Path, tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text("mm,N\n-9,-1\n9,1\n", encoding="utf-8")
    curve = "  curve: {type: nonlinear, between: [hand, wall], force_over_distance: curve.csv}  # measured\n"
    path.write_text(TEXT + curve, encoding="utf-8")
    live = changed(load_scene(path), {"touch": {"stiffness": 1500.0}})
    (tmp_path / "other").mkdir()
    beside, away = (save(live, tmp_path / name) for name in ("beside.yaml", "other/away.yaml"))
    assert "curve.csv}  # measured" in (tmp_path / "beside.yaml").read_text(encoding="utf-8")
    assert (tmp_path / "other" / "away.yaml").read_text(encoding="utf-8").startswith("# All values of ")
    assert beside.document == away.document == live.document


def test_a_module_that_was_added_is_saved_and_one_that_is_gone_is_refused(path: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        session.adopt(
            parse_scene(f"{TEXT}  stop: {{type: buffer, between: [hand, wall], stiffness: 99, damping: 0}}\n")
        )
        assert unsaved(session.scene) == ["stop"]
        session.save()
        assert load_scene(path).modules == session.scene.modules
        session.adopt(parse_scene(TEXT))
        with pytest.raises(UsageError, match=r"its modules\.stop is no part of the scene any more"):
            session.save()


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def test_an_edit_under_watch_changes_only_what_it_changed(path: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path))
        session.set({"touch": {"stiffness": 1500.0}, "slip": {"force": 0.7}}, over=0.0)
        edit(path, "damping: 2 ", "damping: 4.0 ")
        edit(path, "force: &f 0.5", "force: &f 0.75")
        news = file.check(session)
        assert news is not None
        assert set(news.changed) == {"touch.damping 0.002 N·s/mm → 0.004 N·s/mm", "slip.force 0.7 N → 0.75 N"}
        assert unsaved(session.scene) == ["touch.stiffness"]
        session.save()  # in the file as it is now, which is no news
        assert file.check(session) is None
        assert load_scene(path).modules == session.scene.modules
        edit(path, "  drag:  {type: damper, between: [hand, wall], damping: *d}   # as the slip\n", "")
        edit(path, "4.0 ", "4.5 ")
        assert set(file.check(session).changed) == {
            "touch.damping 0.004 N·s/mm → 0.0045 N·s/mm",
            "drag: removed (damper)",
        }


def test_after_saving_as_another_file_that_one_is_watched(path: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path))
        session.set({"touch.stiffness": "1.5 N/mm"}, over=0.0)
        other = session.save(path.with_name("other.yaml"))
        edit(path, "damping: 2 ", "damping: 4.0 ")
        assert file.check(session) is None
        edit(other, "damping: 2 ", "damping: 5.0 ")
        assert file.check(session).changed == ("touch.damping 0.002 N·s/mm → 0.005 N·s/mm",)
        assert session.scene.modules["touch"].stiffness == 1500.0


def test_an_edit_that_is_taken_back_names_the_values_that_stay_live(path: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path))
        session.set({"touch": {"stiffness": 1500.0}}, over=0.0)
        edit(path, "damping: 2 ", "damping: [ ")
        assert file.check(session).refused
        edit(path, "damping: [ ", "damping: 2 ")
        kept = "nothing: the file matches the running scene, but for the live values touch.stiffness"
        assert file.check(session).changed == (kept,)


def test_an_edit_that_does_not_go_with_live_values_is_refused(path: Path) -> None:
    with hapsim.start(load_scene(path)) as session:
        file = WatchedFile(str(path))
        session.adopt(
            parse_scene(TEXT + "  more: {type: damper, between: [hand, post], damping: 1}\n  post: {type: ground}\n")
        )
        edit(path, "wall", "post")
        assert session.scene.modules.keys() >= {"more", "post"}
        assert file.check(session).changed
        edit(path, "post", "wall")
        news = file.check(session)
        assert "post" in news.refused


def test_a_rejected_edit_reaches_the_views(capsys: pytest.CaptureFixture[str]) -> None:
    heard, looks = list[tuple[str, str]](), iter([False, True])
    file: Any = SimpleNamespace(check=lambda _: EditResult(refused="scene.yaml:7: stiffness: found -1"))
    session: Any = SimpleNamespace(wait=lambda _: next(looks))
    reporter = run_reporter.RunReporter(lambda _: None, "", None, file, publish=lambda *event: heard.append(event))
    reporter._follow(file, session)
    assert heard == [("rejected", "scene.yaml:7: stiffness: found -1")]
    assert "The scene runs on unchanged" in capsys.readouterr().err


def test_a_warning_is_printed_once(capsys: pytest.CaptureFixture[str]) -> None:
    scene = parse_scene(TEXT.replace("stiffness: 1 N/mm", "stiffness: 1e-5"))
    prediction = hapsim.predict(scene)
    printed = before_arming.print_warnings(scene, prediction)
    assert printed
    assert capsys.readouterr().err
    assert before_arming.print_warnings(scene, prediction, printed) == printed
    assert not capsys.readouterr().err


def test_unsaved_values_are_kept_with_the_command_that_writes_them(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    scene = load_scene(path)
    assert keep_unsaved(scene, "scene") is None
    assert keep_unsaved(changed(scene, {"mock.hand": {"position": 0.1}}), "scene") is None
    live = changed(scene, {"touch": {"stiffness": 1500.0}})
    kept = [keep_unsaved(live, "scene") for _ in range(23)]
    last = kept[-1]
    assert last is not None
    assert last.names == ["touch.stiffness"]
    assert len(list(last.path.parent.iterdir())) == 20
    command, source, target = last.command.split()
    assert (command, source) == ("cp", str(last.path))
    shutil.copy(source, target)
    assert path.read_text(encoding="utf-8") == TEXT.replace("1 N/mm      #", "1.5 N/mm    #")
    assert keep_unsaved(live, "scene").command.startswith("diff ")  # type: ignore[union-attr]
    shipped = keep_unsaved(changed(load_scene("first_touch"), {"touch": {"stiffness": 1500.0}}), "wall")
    assert shipped is not None
    assert shipped.command.endswith(" wall.yaml")


def test_a_run_reports_at_its_end_what_is_not_saved_and_how_to_write_it(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    reporter = run_reporter.RunReporter(lambda _: None, "", "auto", None)
    reporter.keep_unsaved("scene")  # nothing has run
    with hapsim.start(load_scene(path)) as session:
        reporter.observer.started(session)
        reporter.keep_unsaved("scene")
        assert capsys.readouterr().err == ""
        session.set({"touch": {"stiffness": 1500.0}})
    reporter.keep_unsaved("scene")
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("not saved: touch.stiffness. ")
    assert subprocess.run(told[1].strip(), shell=True, check=True).returncode == 0
    assert load_scene(path).modules == session.scene.modules
    (tmp_path / "state" / "hapsim" / "unsaved").rename(tmp_path / "moved")
    (tmp_path / "state" / "hapsim" / "unsaved").write_text("in the way", encoding="utf-8")
    reporter.keep_unsaved("scene")
    assert capsys.readouterr().err.startswith("the unsaved values could not be kept: ")
