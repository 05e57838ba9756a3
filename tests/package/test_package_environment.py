"""tools/environment, which the tools source: whose directory it replaces."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("marker", "stays"), [(None, True), ("made-from", False), ("made-by-tools", False)])
def test_an_environment_that_the_tools_did_not_make_stays(tmp_path: Path, marker: str | None, stays: bool) -> None:
    """Another's .venv is left alone; one of the tools', also an unfinished one, is made anew."""
    for name in ("tools/environment", "tools/requirements.lock", "pyproject.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (own := tmp_path / ".venv" / "mine.txt").parent.mkdir()
    own.write_text("", encoding="utf-8")
    if marker is not None:
        (tmp_path / ".venv" / marker).write_text("older", encoding="utf-8")
    python = tmp_path / "python"  # it takes the check of its version, and makes nothing
    python.write_text('#!/bin/sh\ntest "$1" = -c\n', encoding="utf-8")
    python.chmod(0o755)
    ended = subprocess.run(
        ["bash", "-c", "set -euo pipefail; source tools/environment"],
        cwd=tmp_path,
        env={"PATH": "/usr/bin:/bin", "HAPSIM_PYTHON": str(python)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 1
    assert "cannot make a virtual environment" in ended.stderr
    assert own.exists() == stays
    assert (".venv was not made by tools/environment, and stays as it is" in ended.stderr) == stays
    assert f"Making the environment in {'.venv-tools' if stays else '.venv'} " in ended.stderr
