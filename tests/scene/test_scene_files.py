"""Scenes are loaded from files, and the error of one that cannot be read has the name that the user gave."""

import os
from pathlib import Path

import pytest

from hapsim.errors import SceneError
from hapsim.scene import load_scene, parse_scene
from hapsim.scene.shipped import shipped_scene

UTF_16 = "it looks like UTF-16: save the file as UTF-8"


def refusal(path: str | os.PathLike[str]) -> str:
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    return str(caught.value)


def test_a_scene_knows_the_path_that_the_user_gave(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, good: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(good)
    assert load_scene("./s.yaml").path == "./s.yaml"
    assert load_scene(tmp_path / "s.yaml").path == str(tmp_path / "s.yaml")
    assert parse_scene(good, "s.yaml").path is None


def test_a_fault_in_a_file_is_reported_with_the_path_that_the_user_gave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, good: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("configs").mkdir()
    Path("configs/x.yaml").write_text(good.replace("2000", "-3"))
    assert refusal("configs/x.yaml") == ("configs/x.yaml:7:65: stiffness: found -3, expected a number >= 0 (N/m)")


@pytest.mark.parametrize("change", [lambda text: text.replace("\n", "\r\n"), lambda text: "\ufeff" + text])
def test_a_file_from_another_system_keeps_its_places(tmp_path: Path, change, good: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "s.yaml"
    path.write_bytes(change(good).encode())
    assert load_scene(path).rate == 1000.0
    path.write_bytes(change(good.replace("version: 1", "version: 3")).encode())
    assert refusal(path).startswith(f"{path}:1:10: version: found 3, ")
    path.write_bytes(change(good.replace("2000", "-3")).encode())
    assert refusal(path).startswith(f"{path}:7:65: stiffness: found -3, ")


def test_a_shipped_scene_is_loaded_by_its_name_where_no_file_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, good: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_scene("wall") == load_scene("wall.yaml") == parse_scene(shipped_scene("wall"))
    assert load_scene("wall").path is None  # so that nothing rewrites it
    assert refusal("wal") == "wal: no such file, expected a scene in YAML; did you mean 'wall'?"
    assert "no such file" in refusal(tmp_path / "wall.yaml")
    Path("wall.yaml").write_text(good)
    assert load_scene("wall.yaml").modules == parse_scene(good).modules


def test_a_missing_file_is_reported_with_the_nearest_name_next_to_it(tmp_path: Path) -> None:
    assert refusal(tmp_path / "s.yaml") == f"{tmp_path}/s.yaml: no such file, expected a scene in YAML"
    (tmp_path / "first_touch.yaml").write_text("")
    assert refusal(tmp_path / "first_tuch.yaml") == (
        f"{tmp_path}/first_tuch.yaml: no such file, expected a scene in YAML; did you mean 'first_touch.yaml'?"
    )
    assert refusal(tmp_path / "no" / "s.yaml") == (f"{tmp_path}/no/s.yaml: no such directory, expected a scene in YAML")


@pytest.mark.parametrize(
    ("wanted", "offered"),
    [
        ("nosuch.yaml", None),
        ("first_tuch.yaml", "first_touch.yaml"),
        ("first_touch", "first_touch.yaml"),
        ("first_touch.yml", "first_touch.yaml"),
        ("first_touch.pn", "first_touch.yaml"),
        ("first_touc.png", "first_touch.png"),
    ],
)
def test_a_name_is_offered_only_where_it_is_alike_but_for_its_ending(
    tmp_path: Path, wanted: str, offered: str | None
) -> None:
    for name in ("two.yaml", "first_touch.png", "first_touch.yaml"):
        (tmp_path / name).write_text("")
    hint = f"; did you mean '{offered}'?" if offered else ""
    assert refusal(tmp_path / wanted) == f"{tmp_path}/{wanted}: no such file, expected a scene in YAML{hint}"


def test_an_empty_name_is_reported_as_that() -> None:
    assert refusal("") == "'': the name of the file is empty, expected that of a file with a scene in YAML"


def test_a_directory_is_no_scene(tmp_path: Path) -> None:
    assert refusal(tmp_path) == f"{tmp_path}: found a directory, expected a file with a scene in YAML"


def test_a_file_that_may_not_be_read_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, good: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(good)
    if os.geteuid() == 0:  # the superuser may read everything

        def refuse(_path: Path, _mode: str) -> bytes:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(Path, "open", refuse)
    path.chmod(0)
    assert refusal(path) == f"{path}: this file may not be read, expected one that may; check its permissions"


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a\0b", "this is not the name of a file"),
        ("x" * 5000, "this file cannot be read: File name too long"),
        ("/dev/null/s.yaml", "this file cannot be read: Not a directory"),
    ],
)
def test_what_names_no_file_is_reported(name: str, told: str) -> None:
    assert refusal(name) == f"{name}: {told}"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"\xff\xfev\x00", f":1:1: found the byte 0xff, expected text in UTF-8; {UTF_16}"),
        (b"\xfe\xff\x00v", f":1:1: found the byte 0xfe, expected text in UTF-8; {UTF_16}"),
        (b"\xffv", ":1:1: found the byte 0xff, expected text in UTF-8; save the file as UTF-8"),
        (
            "# für\nrate: 1 # n\xfcr".encode("latin-1"),
            ":1:4: found the byte 0xfc, expected text in UTF-8; save the file as UTF-8",
        ),
        (
            "# für\nrate: ü".encode() + b"\xfc",
            ":2:8: found the byte 0xfc, expected text in UTF-8; save the file as UTF-8",
        ),
    ],
)
def test_a_file_that_is_not_utf_8_is_reported_where_it_breaks(tmp_path: Path, content: bytes, told: str) -> None:
    path = tmp_path / "s.yaml"
    path.write_bytes(content)
    assert refusal(path) == f"{path}{told}"
