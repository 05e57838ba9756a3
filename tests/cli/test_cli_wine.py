"""hapsim on a Windows Python under Wine, where `tools/wine` made one."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.scene import load_scene

PLACE = Path(os.environ.get("HAPSIM_WINE", Path.home() / ".cache" / "hapsim-wine"))
Windows = Callable[..., str]

pytestmark = pytest.mark.skipif(not (PLACE / "hapsim").exists(), reason="no Windows Python: `tools/wine` makes one")


@pytest.fixture(scope="module")
def windows() -> Windows:
    """Returns the output of `hapsim …` of this clone on Windows."""

    def call(*words: object) -> str:
        command = [PLACE / "hapsim", *map(str, words)]
        return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=True).stdout.decode()

    subprocess.run([Path(__file__).parents[2] / "tools" / "wine", PLACE], check=True)
    return call


def test_predictions_and_measurements_are_those_of_linux(
    windows: Windows, hapsim: Callable[..., Any], scene_file: Callable[..., Path], tmp_path: Path
) -> None:
    scene = scene_file("spring").rename(tmp_path / "ein Maß.yaml")
    for command, keys in (("check", ("spectral_radius",)), ("measure", ("measured", "k"))):
        there, here = json.loads(windows(command, scene, "--json")), hapsim(command, scene, "--json").document
        for key in keys:
            there, here = there[key], here[key]
        assert there == pytest.approx(here, rel=1e-9)
    assert "N·s/m" in windows("check", scene)


def test_a_device_at_a_com_port_runs_to_the_end(windows: Windows, scene_file: Callable[..., Path]) -> None:
    scene, link = scene_file("spring", clock="device", rate=100.0), PLACE / "prefix" / "dosdevices" / "com5"
    with serving(assemble_mock(load_scene(scene))) as port:
        link.unlink(missing_ok=True)
        link.symlink_to(port)
        report = json.loads(windows("run", scene, "--port", "COM5", "--duration", 0.5, "--unstable", "--json"))
        link.unlink()
    assert (report["ending"], report["released"]) == ("done", True)
