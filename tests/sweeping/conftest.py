"""A small scene to sweep."""

from __future__ import annotations

from pathlib import Path

import pytest

from hapsim.scene.shipped import shipped_scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "touch.yaml"
    file.write_text(shipped_scene("first_touch.yaml"), encoding="utf-8")
    return file
