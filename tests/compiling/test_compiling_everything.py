"""`hapsim compile`: what it promises to have compiled is all that a start would have."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest

from hapsim.cli import prepare as preparing
from hapsim.compiling.progress import on_compilation
from hapsim.cordis.program import compile_scene
from hapsim.cordis.registry import PART_TYPES
from hapsim.prediction.linear import linear_scene
from hapsim.running import run
from hapsim.running.compile_ahead import Prepared, prepare, scenes_with_every_module
from hapsim.scene import SchemeName, parse_scene, shipped
from hapsim.scene.modules import MODULE_TYPES

SCENE = "configs/first_touch.yaml"


@pytest.fixture(scope="module")
def everything() -> None:
    prepare()


@pytest.mark.parametrize("precision", ["single", "double"])
def test_every_type_of_module_and_every_scheme_is_in_it(precision: str) -> None:
    scenes = list(scenes_with_every_module(precision))
    assert {scene.scheme for scene in scenes} == set(get_args(SchemeName))
    assert {scene.precision for scene in scenes} == {precision}
    for scene in scenes:
        assert [part_type.name for part_type in PART_TYPES if not part_type.select(scene)] == []
        assert {module.type for module in scene.modules.values()} == set(MODULE_TYPES)
        selected = {name for part_type in PART_TYPES for name in part_type.select(scene)}
        assert selected == scene.modules.keys() - scene.device_points.keys()
        assert linear_scene(scene).links.keys() == scene.links.keys()


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize("precision", ["single", "double"])
def test_afterwards_no_shipped_scene_compiles_anything(precision: str) -> None:
    names: list[str] = []
    for path in sorted(Path("configs").glob("*.yaml")):
        scene = parse_scene(path.read_text(encoding="utf-8"), str(path)).model_copy(update={"precision": precision})
        for scheme in get_args(SchemeName):
            with on_compilation(names.append):
                compile_scene(scene.model_copy(update={"scheme": scheme}))
            assert names == [], (path, scheme)


@pytest.mark.usefixtures("everything")
@pytest.mark.parametrize("clock", ["lockstep", "host", "device"])
@pytest.mark.parametrize("transport", ["auto", "terminal"])
@pytest.mark.parametrize("portable", [False, True])
def test_afterwards_no_run_compiles_anything(clock: str, transport: Any, portable: bool) -> None:
    text = shipped.shipped_scene("first_touch.yaml")
    scene = parse_scene(text, SCENE)
    scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": clock})})
    names: list[str] = []
    with on_compilation(names.append):
        run(scene, duration=0.02, transport=transport, portable=portable)
    assert names == []


def test_a_start_after_it_says_nothing_of_compiling(tmp_path: Path) -> None:
    """From nothing, as on a new machine; one process after the other."""

    def call(*words: str) -> tuple[str, str]:
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
        command = [sys.executable, "-m", "hapsim", *words]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
        return done.stdout, done.stderr

    out, err = call("compile", SCENE)
    assert "compiling, once on this machine: " in err
    number = int(out.removeprefix("Compiled ").partition(" ")[0])
    assert 80 < number < 250
    assert out.endswith(f" s; kept in {tmp_path / 'hapsim'}\n")
    assert call("compile", SCENE) == (f"Nothing to compile: everything is kept in {tmp_path / 'hapsim'}\n", "")
    assert "compiling" not in call("run", SCENE, "--duration", "0.1")[1]


def test_what_came_of_it_is_said_in_json(hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    for directory in (Path("/var/kept"), None):
        prepared = Prepared(12, 3.5, directory)
        monkeypatch.setattr(preparing, "prepare", lambda *_, prepared=prepared: prepared)
        document = hapsim("compile", "--json").document
        assert document["directory"] == (None if directory is None else str(directory))
        assert (document["functions"], document["seconds"]) == (12, 3.5)
    assert "set XDG_CACHE_HOME to a directory that can be written to" in hapsim("compile").out


def test_a_wrong_scene_is_reported_before_anything_is_compiled(
    hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(preparing, "prepare", lambda *_: pytest.fail("compiled"))
    assert "no_such.yaml" in hapsim("compile", SCENE, "no_such.yaml").sentence
