"""Whatever takes a scene takes the path of its file as well."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

import hapsim
from hapsim.errors import SceneError
from hapsim.running.session_options import RunOptions

TEXT = """
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0, clock: lockstep}
mock: {initial: {velocity: 0.1}}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
  touch: {type: spring, between: [hand, wall], stiffness: 400}
"""


def test_a_path_runs_as_its_scene_does(tmp_path: Path) -> None:
    path = tmp_path / "touch.yaml"
    path.write_text(TEXT, encoding="utf-8")
    scene = hapsim.load_scene(path)
    of_path, of_scene = hapsim.predict(path), hapsim.predict(scene)
    assert (of_path.k, of_path.b, of_path.poles) == (of_scene.k, of_scene.b, of_scene.poles)
    assert (hapsim.run(path, duration=0.02).position == hapsim.run(scene, duration=0.02).position).all()
    with hapsim.start(str(path), duration=0.01) as session:
        assert session.scene == scene
        session.wait()


@pytest.mark.parametrize(
    "takes_scene",
    [hapsim.predict, hapsim.run, hapsim.start, hapsim.measure, hapsim.measure_impedance, hapsim.identify_device],
)
def test_a_path_without_a_file_is_a_scene_error(takes_scene: Callable[..., Any], tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"nowhere\.yaml: no such file"):
        takes_scene(tmp_path / "nowhere.yaml")


def test_start_declares_and_describes_every_option() -> None:
    names = [field.name for field in fields(RunOptions)]
    assert list(inspect.signature(hapsim.start).parameters) == ["scene", *names]
    assert all(f"`{name}`" in (hapsim.start.__doc__ or "") for name in names)
    with pytest.raises(TypeError, match="speed"):
        hapsim.start(TEXT, speed=2.0)  # type: ignore[call-arg]
